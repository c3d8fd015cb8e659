"""What a node knows of its own health, and its report on /diagnostics."""

from __future__ import annotations

import math
import os
import socket
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, ItemsView
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from dpc_ros.bag.topic import NANOSECONDS
from dpc_ros.nodes.window import RoundTrips, Window, jitter, percentiles

DIAGNOSTICS = '/diagnostics'  # topic
REPORT_DEPTH = 100  # messages; of so many nodes one may come at the same time
ADDRESS_READING = 'address'  # of the page that a node serves
PAUSED_READING = 'paused'  # whether a node was told to hold what it moves
HOST_READING = 'host'
PROCESS_READING = 'process id'
REJECTED_READING = 'rejected: '  # begins each reason
NO_WATCHDOG = 'none'
WATCHDOG_OK = 'ok'
_MOST_REASONS = 20
_LONGEST_REASON = 200  # characters
_RECENT = 5  # reports for which a rejected or lost message is a warning


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


class Reasons:
    """Counts by reason that any sender may make up: those that came last, of the others the sum.

    Args:
        most: reasons that are told apart.
    """

    def __init__(self, most: int = _MOST_REASONS) -> None:
        self.others = 0
        self._most = most
        self._counts: OrderedDict[str, int] = OrderedDict()  # the one silent for longest first

    def __getitem__(self, reason: str) -> int:
        return self._counts.get(reason[:_LONGEST_REASON], 0)

    def __setitem__(self, reason: str, count: int) -> None:
        reason = reason[:_LONGEST_REASON]
        self._counts[reason] = count
        self._counts.move_to_end(reason)
        if len(self._counts) > self._most:
            _, forgotten = self._counts.popitem(last=False)
            self.others += forgotten

    def items(self) -> ItemsView[str, int]:
        """Return the reasons that are told apart, with their counts."""
        return self._counts.items()

    def total(self) -> int:
        """Return the sum over all reasons there ever were."""
        return self.others + sum(self._counts.values())


class Health:
    """Counts since start; rates and durations since the last report.

    Attributes:
        received: messages that came.
        published: messages on the outputs; of a recorder, those in the bag.
        repeated: messages that were there before.
        saturated: answers of a controller that the bound on the force has shortened.
        rejected: messages that could not be used, by reason.
        lost: messages that never came, by topic.
        warning: what is wrong at the moment, empty while nothing is.
        watchdog: `NO_WATCHDOG`, `WATCHDOG_OK`, or what is stale.
        readings: what else a node says of itself, by name and unit.
        round_trips: of the stamps that it sends and others answer.
    """

    def __init__(self) -> None:
        self.received = 0
        self.published = 0
        self.repeated = 0
        self.saturated = 0
        self.rejected = Reasons()
        self.lost: Counter[str] = Counter()
        self.warning = ''
        self.watchdog = NO_WATCHDOG
        self.readings: dict[str, Any] = {}
        self.round_trips = RoundTrips()
        self._periods = Window()
        self._processing = Window()
        self._ages = Window()
        self._waits = Window()
        self._sent_at = math.nan
        self._started = time.monotonic()
        self._reported = (self._started, 0)
        self._troubles = deque([0] * _RECENT, maxlen=_RECENT)  # at the last reports

    def restart(self) -> None:
        """Let nothing be measured across a pause."""
        self._sent_at = math.nan
        self.round_trips.restart()

    def arrived(self, info: dict[str, int]) -> None:
        """Count a message; note how old it came, and how long it waited for this node."""
        self.received += 1
        received = info['received_timestamp']
        self._ages.add((received - info['source_timestamp']) / NANOSECONDS)
        self._waits.add((time.time_ns() - received) / NANOSECONDS)

    def sent(self) -> None:
        """Count a message of an output; note how long the one before is ago."""
        self.published += 1
        now = time.perf_counter()
        if self._sent_at <= now:
            self._periods.add(now - self._sent_at)
        self._sent_at = now

    def processed(self, seconds: float) -> None:
        """Note how long an answer took [s]."""
        self._processing.add(seconds)

    def report(
        self, name: str, hardware_id: str, state: str, failure: str = ''
    ) -> DiagnosticStatus:
        """Return the status since the last report.

        Args:
            name: of the node.
            hardware_id: its name with the namespace.
            state: of its lifecycle.
            failure: why it gives up, empty while it doesn't.
        """
        values = {
            'state': state,
            HOST_READING: socket.gethostname(),
            PROCESS_READING: os.getpid(),
            'uptime [s]': f'{time.monotonic() - self._started:.1f}',
            'peak memory [MiB]': f'{_peak_memory():.1f}',
            'watchdog': self.watchdog,
            'rate [Hz]': f'{self._rate():.1f}',
            **self._durations(),
            'received': self.received,
            'published': self.published,
            'repeated': self.repeated,
            'saturated': self.saturated,
            'lost': self.lost.total(),
            'rejected': self.rejected.total(),
            **self.readings,
            **{f'lost: {topic}': count for topic, count in self.lost.items()},
            **{f'{REJECTED_READING}{reason}': count for reason, count in self.rejected.items()},
        }
        if self.rejected.others:
            values[f'{REJECTED_READING}other reasons'] = self.rejected.others
        problem = self._problem()
        level = DiagnosticStatus.WARN if problem else DiagnosticStatus.OK
        return DiagnosticStatus(
            level=DiagnosticStatus.ERROR if failure else level,
            name=name,
            message=failure or problem or state,
            hardware_id=hardware_id,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )

    def _rate(self) -> float:
        now = time.monotonic()
        since, published = self._reported
        self._reported = (now, self.published)
        return (self.published - published) / max(now - since, 1e-9)

    def _durations(self) -> dict[str, str]:
        measured = {
            'jitter': jitter(self._periods.take()),
            'processing': percentiles(self._processing.take()),
            'age': percentiles(self._ages.take()),
            'waiting': percentiles(self._waits.take()),
            'round trip': percentiles(self.round_trips.window.take()),
        }
        return {
            f'{what} {which} [ms]': f'{1e3 * seconds:.3f}'
            for what, values in measured.items()
            for which, seconds in zip(('p50', 'p99', 'max'), values, strict=True)
        }

    def _problem(self) -> str:
        troubles = self.rejected.total() + self.lost.total()
        recent = troubles - self._troubles[0]
        self._troubles.append(troubles)
        if self.warning:
            return self.warning
        if self.watchdog not in (NO_WATCHDOG, WATCHDOG_OK):
            return self.watchdog
        return f'{recent} messages were rejected or lost of late' if recent else ''


def _peak_memory() -> float:
    """Return the largest resident memory of this process so far [MiB]."""
    # Not getrusage: its maximum begins with that of the process that started this one.
    try:
        lines = Path('/proc/self/status').read_text().splitlines()
    except OSError:
        return math.nan
    sizes = (line.split()[1] for line in lines if line.startswith('VmHWM:'))  # [KiB]
    return float(next(sizes, math.nan)) / 1024


def identity(process: int | str, host: str = '') -> str:
    """Return what tells a process from all others: its number on a host, this one by default."""
    return f'{host or socket.gethostname()}/{process}'


def diagnostic_array(stamp: Any, status: DiagnosticStatus) -> DiagnosticArray:
    """Return the message of one status."""
    message = DiagnosticArray(status=[status])
    message.header.stamp = stamp
    return message
