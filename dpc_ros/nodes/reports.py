"""What the nodes have reported on /diagnostics, and which of them have gone silent."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticStatus

from dpc_ros.nodes.health import HOST_READING, PROCESS_READING, identity

LONGEST_SILENCE = 3.0  # s after which a node that reports once a second is taken for dead
# By which a report of ours is known.
_KEYS = {'state', HOST_READING, PROCESS_READING, 'rate [Hz]', 'watchdog'}
_MOST_NODES = 100


@dataclass(frozen=True)
class Report:
    """The last report of a node.

    Attributes:
        node: its name with the namespace.
        time: when it came [s]; of a node that has said nothing so far, when it was first seen.
        values: what it said, by name and unit; empty where it has said nothing so far.
        problem: what it warned of, or why it failed; empty where all was well.
    """

    node: str
    time: float
    values: Mapping[str, str] = field(default_factory=dict)
    problem: str = ''

    def is_silent(self, now: float) -> bool:
        """Return whether it came so long ago [s] that the node hangs or is gone."""
        return now - self.time > LONGEST_SILENCE


class Reports:
    """The last report of every node, by name and process: two nodes may have one name.

    Args:
        namespace: of the nodes that count; all do in `/`.
    """

    def __init__(self, namespace: str = '/') -> None:
        self._prefix = f'/{namespace.strip("/")}/'.replace('//', '/')
        self._reports: dict[tuple[str, str], Report] = {}
        self._seen: dict[str, Report] = {}  # nodes that publish on the topic
        self._strangers: set[str] = set()  # those that report in another way

    def take(self, status: DiagnosticStatus, now: float) -> Report | None:
        """Keep a status that came at a time [s]; return the report that it is, if it counts."""
        values = {pair.key: pair.value for pair in status.values}
        if not values.keys() >= _KEYS:
            if len(self._strangers) < _MOST_NODES:
                self._strangers.add(status.name.partition(':')[0])  # as diagnostic_updater has it
            return None
        node = status.hardware_id
        if not node.startswith(self._prefix):
            return None
        problem = '' if status.level == DiagnosticStatus.OK else status.message
        process = identity(values[PROCESS_READING], values[HOST_READING])
        report = Report(node, now, values, problem)
        self._reports[node, process] = report
        if len(self._reports) > _MOST_NODES:
            del self._reports[min(self._reports, key=lambda key: self._reports[key].time)]
        return report

    def see(self, publishers: Iterable[str], now: float) -> None:
        """Note which nodes publish on the topic, heard or not.

        Args:
            publishers: their names with namespaces.
            now: time [s].
        """
        self._seen = {
            node: self._seen.get(node, Report(node, now))
            for node in publishers
            if node.startswith(self._prefix) and node.rpartition('/')[2] not in self._strangers
        }

    def newest(self, now: float) -> list[Report]:
        """Return the last reports by name, without processes that others have replaced.

        Args:
            now: time [s].
        """
        heard = self._reports.values()
        speaking = {report.node for report in heard if not report.is_silent(now)}
        known = {report.node for report in heard}
        reports = [
            *(each for each in heard if each.node not in speaking or not each.is_silent(now)),
            *(report for node, report in self._seen.items() if node not in known),
        ]
        return sorted(reports, key=lambda each: each.node)
