"""Durations of the loop: noted in memory that is there already, and sorted once a second."""

from __future__ import annotations

import math
import time
from array import array
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

_CAPACITY = 4096  # durations; more than the loop makes in the second between two reports
_MOST_UNANSWERED = 1000  # stamps


class Percentiles(NamedTuple):
    """Median, 99th percentile and maximum; NaN where nothing was measured."""

    p50: float
    p99: float
    largest: float


class Window:
    """The newest durations since it was last emptied; noting one takes no memory.

    Args:
        capacity: durations that it holds at most.
    """

    def __init__(self, capacity: int = _CAPACITY) -> None:
        self._durations = array('d', bytes(8 * capacity))
        self._capacity = capacity
        self._count = 0

    def add(self, seconds: float) -> None:
        """Note a duration [s]."""
        self._durations[self._count % self._capacity] = seconds
        self._count += 1

    def take(self) -> Float[np.ndarray, ' k']:
        """Return the durations [s] in no order, and forget them."""
        count, self._count = min(self._count, self._capacity), 0
        return np.array(self._durations[:count])


class RoundTrips:
    """Times from the sending of a stamp to its answer, by the clock of one process.

    A stamp that was sent again is not measured, as nobody knows which of the two was answered
    (Karn's algorithm; RFC 6298, section 3).
    """

    def __init__(self) -> None:
        self.window = Window()
        self._sent: dict[int, float] = {}  # time [s] by stamp; NaN where it was sent again

    def sent(self, stamp: int) -> None:
        """Note that what carries a stamp [ns] is about to be sent."""
        self._sent[stamp] = math.nan if stamp in self._sent else time.perf_counter()
        if len(self._sent) > _MOST_UNANSWERED:
            del self._sent[next(iter(self._sent))]

    def answered(self, stamp: int) -> None:
        """Note that the answer to a stamp [ns] has come; a second one counts for nothing."""
        duration = time.perf_counter() - self._sent.pop(stamp, math.nan)
        if duration >= 0:
            self.window.add(duration)

    def restart(self) -> None:
        """Forget what has not been answered."""
        self._sent.clear()


def percentiles(durations: Float[np.ndarray, ' k']) -> Percentiles:
    """Return the percentiles of durations [s] by nearest rank: each is one that was measured."""
    count = len(durations)
    if not count:
        return Percentiles(math.nan, math.nan, math.nan)
    ordered = np.sort(durations)
    return Percentiles(*(float(ordered[-(-k * count // 100) - 1]) for k in (50, 99, 100)))


def jitter(periods: Float[np.ndarray, ' k']) -> Percentiles:
    """Return the percentiles of |period − median period| [s]."""
    return percentiles(np.abs(periods - percentiles(periods).p50))
