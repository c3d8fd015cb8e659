"""How long it takes from a state of the body to the use of its force, measured between the two."""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from statistics import median
from typing import NamedTuple

from dpc_ros.control.stamps import NANOSECOND

LONGEST_DELAY = 1.0  # s; what is longer is a difference of clocks
_WINDOW = 100  # messages
_ENOUGH = 20  # of them, before their median counts


class _Sent(NamedTuple):
    """A configuration that was sent: stamp [ns], number, time of sending and way to here [ns]."""

    stamp: int
    number: int
    time: int
    way_out: int


class DelayMeter:
    """The delay of a loop in wall time, as the encoder sees it: a median over its last messages.

    The encoder sees when a configuration was sent and when it came, and when the force that answers
    it was on its way. The way of a force back to the body is taken as long as that of the
    configuration out, as clocks are compared over a network (RFC 5905, section 8). The clocks of
    the hosts must be synchronised.
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Forget everything."""
        self._sent: deque[_Sent] = deque(maxlen=_WINDOW)
        self._delays: deque[int] = deque(maxlen=_WINDOW)
        self._newest = -1  # stamp of the forces so far

    def configuration(self, stamp: int, number: int, sent: int, received: int) -> None:
        """Note when the configuration of a stamp was sent and came.

        Args:
            stamp: of the configuration [ns].
            number: the publisher's, which tells how many were left out since the one before.
            sent: when it was, by the clock of the body's host [ns].
            received: when it came, by the clock here [ns].
        """
        if self._sent and self._sent[-1].stamp == stamp:
            self._sent.pop()  # sent again: the answer is to this one
        self._sent.append(_Sent(stamp, number, sent, received - sent))

    def force(self, stamp: int, received: int) -> None:
        """Note when the first force of a stamp came; both in [ns]."""
        if stamp <= self._newest:
            return
        self._newest = stamp
        for each in self._sent:
            if each.stamp == stamp:
                self._delays.append(received - each.time + each.way_out)

    @property
    def delay(self) -> float | None:
        """From a configuration to the use of its force, wall time [s]; none before it is known."""
        return median(self._delays) * NANOSECOND if len(self._delays) >= _ENOUGH else None

    @property
    def is_believable(self) -> bool:
        """Whether the delay is one that a loop with synchronised clocks can have."""
        return self.delay is None or 0 <= self.delay <= LONGEST_DELAY

    @property
    def acting_delay(self) -> float:
        """Simulated time from a state to the one from which its force acts [s].

        A force acts from the next tick on, which is in time where it comes within a control step:
        whole steps count, rounded down. Zero while the delay is not known, or not believable.
        """
        delay = self.delay
        if delay is None or not self.is_believable:
            return 0.0
        ticks = [(a, b) for a, b in pairwise(self._sent) if b.number > a.number]
        if not ticks:
            return 0.0
        step = median((b.stamp - a.stamp) / (b.number - a.number) for a, b in ticks)
        period = median((b.time - a.time) / (b.number - a.number) for a, b in ticks) * NANOSECOND
        return delay // period * step * NANOSECOND if period > 0 else 0.0
