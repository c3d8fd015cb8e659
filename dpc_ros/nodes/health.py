"""What a node knows of its own health, and its report on /diagnostics."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

PROCESS_READING = 'process'  # number of the process that reports
_LATENCY_WINDOW = 1000  # messages


class SequenceCounter:
    """Sees by the numbers that publishers give their messages how many never came.

    A message does not say who of several publishers sent it: its number goes on with the series
    that it fits. So none is invented while nothing is lost; how many were lost is exact for one
    publisher, an estimate for several. Numbers start anew when another takes over the topic.
    """

    def __init__(self) -> None:
        self._last: list[int] = []  # number of each series, the one silent for longest first

    def gap(self, number: int, publishers: Callable[[], int] = lambda: 1) -> int:
        """Return how many messages a number leaves out.

        Args:
            number: publication sequence number of a message.
            publishers: gives how many of them the topic has.
        """
        last = self._last
        if number - 1 in last:
            last.remove(number - 1)
            last.append(number)
            return 0
        behind = max((known for known in last if known < number), default=None)
        is_crowded = len(last) >= max(publishers(), 1)
        if behind is not None and is_crowded:
            last.remove(behind)
        elif is_crowded:
            del last[0]
        last.append(number)
        return number - behind - 1 if behind is not None and is_crowded else 0


class Health:
    """Counts since start, and rates since the last report."""

    def __init__(self) -> None:
        self.received = 0
        self.published = 0
        self.repeated = 0
        self.saturated = 0  # answers of a controller that the bound on the force has shortened
        self.rejected: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()  # messages by topic
        self.warning = ''
        self.readings: dict[str, str] = {}  # what else a node measures, by name and unit
        self._processing: list[float] = []
        self._reported = (time.monotonic(), 0)

    def processed(self, seconds: float) -> None:
        """Note how long an answer took [s]."""
        self._processing.append(seconds)
        del self._processing[:-_LATENCY_WINDOW]

    def report(self, name: str, hardware_id: str, state: str) -> DiagnosticStatus:
        """Return the status since the last report."""
        now = time.monotonic()
        since, published = self._reported
        rate = (self.published - published) / max(now - since, 1e-9)
        self._reported = (now, self.published)
        values: dict[str, Any] = {
            'state': state,
            'rate [Hz]': f'{rate:.1f}',
            'received': self.received,
            'published': self.published,
            'repeated': self.repeated,
            'lost': self.lost.total(),
            **{f'lost: {topic}': count for topic, count in self.lost.items()},
            'saturated': self.saturated,
            **self.readings,
            **{f'rejected: {reason}': count for reason, count in self.rejected.items()},
        }
        if self._processing:
            ordered = sorted(self._processing)
            values['processing p50 [ms]'] = f'{1e3 * ordered[len(ordered) // 2]:.3f}'
            values['processing max [ms]'] = f'{1e3 * ordered[-1]:.3f}'
        level, message = DiagnosticStatus.OK, state
        if self.rejected or self.lost.total() or self.warning:
            level = DiagnosticStatus.WARN
            message = self.warning or 'messages were rejected or lost'
        return DiagnosticStatus(
            level=level,
            name=name,
            message=message,
            hardware_id=hardware_id,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )


def diagnostic_array(stamp: Any, status: DiagnosticStatus) -> DiagnosticArray:
    """Return the message of one status."""
    message = DiagnosticArray(status=[status])
    message.header.stamp = stamp
    return message
