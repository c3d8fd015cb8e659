"""What a node begins to reject, as its reports tell."""

from __future__ import annotations

from dpc_ros.nodes.health import HOST_READING, PROCESS_READING, REJECTED_READING, identity
from dpc_ros.nodes.reports import Report

_LONGEST = 300  # characters


class Refusals:
    """Finds the reasons that are new in the reports of a node.

    One that comes again in each report is new once; after a report without it, again. What was
    rejected before the first report is not.

    Args:
        topics: those whose messages count.
    """

    def __init__(self, *topics: str) -> None:
        self._beginnings = tuple(f'{REJECTED_READING}{topic}: ' for topic in topics)
        self._counts: dict[str, tuple[str, str]] | None = None  # process and number by reason
        self._rising: set[str] = set()

    def newest(self, report: Report) -> str:
        """Return the first reason that is new in the next report, empty where none is."""
        process = identity(report.values[PROCESS_READING], report.values[HOST_READING])
        counts = {
            key: (process, count)
            for key, count in report.values.items()
            if key.startswith(self._beginnings)
        }
        before, self._counts = self._counts, counts
        was_rising, self._rising = self._rising, set()
        if before is None:
            return ''
        self._rising = {key for key, count in counts.items() if before.get(key) != count}
        new = (key for key in counts if key in self._rising - was_rising)
        return next(new, '').removeprefix(REJECTED_READING)[:_LONGEST]
