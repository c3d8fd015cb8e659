"""How long an answer has been waited for."""

from __future__ import annotations


class Patience:
    """Counts the time in which somebody looked for an answer, in [s] of the caller's steady clock.

    A process that was stopped and goes on finds that much time has passed, while the answer lies
    in its queue: a look that comes late counts as one in time.

    Args:
        interval: time between two looks [s].
    """

    def __init__(self, interval: float) -> None:
        self._longest = 2 * interval
        self._waited = 0.0
        self._looked = 0.0

    def begin(self, now: float) -> None:
        """Wait anew from now on."""
        self._waited, self._looked = 0.0, now

    def look(self, now: float) -> float:
        """Return how long the answer has been waited for [s]."""
        self._waited += min(now - self._looked, self._longest)
        self._looked = now
        return self._waited
