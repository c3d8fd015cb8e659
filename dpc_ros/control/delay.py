"""How long it takes from a state of the body to the use of its force, measured between the two."""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from statistics import median

from dpc_ros.control.law import NANOSECOND

LONGEST_DELAY = 1.0  # s; what is longer is a difference of clocks
_WINDOW = 100  # messages
_ENOUGH = 20  # of them, before their median counts


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
        self._sent: deque[tuple[int, int, int]] = deque(maxlen=_WINDOW)
        self._delays: deque[int] = deque(maxlen=_WINDOW)
        self._newest = -1  # stamp of the forces so far

    def configuration(self, stamp: int, sent: int, received: int) -> None:
        """Note when the configuration of a stamp was sent and came; all in [ns]."""
        if self._sent and self._sent[-1][0] == stamp:
            self._sent.pop()  # sent again: the answer is to this one
        self._sent.append((stamp, sent, received - sent))

    def force(self, stamp: int, received: int) -> None:
        """Note when the first force of a stamp came; both in [ns]."""
        if stamp <= self._newest:
            return
        self._newest = stamp
        for its_stamp, sent, way_out in self._sent:
            if its_stamp == stamp:
                self._delays.append(received - sent + way_out)

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
        ticks = list(pairwise(self._sent))
        step = median(later[0] - earlier[0] for earlier, later in ticks)
        period = median(later[1] - earlier[1] for earlier, later in ticks) * NANOSECOND
        return delay // period * step * NANOSECOND if period > 0 else 0.0
