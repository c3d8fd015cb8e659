"""Which controllers command one body: while there are two of them, neither may."""

from __future__ import annotations

_MOST = 8  # controllers that are remembered; whoever makes up ids can't fill the memory


class Controllers:
    """Knows the controllers that were heard last. Times [s] are the caller's, of a steady clock.

    A controller lives for a time after its last force. Two that live contradict each other, and
    nobody knows which one is right. One that has been killed is over after that time, so that
    another, or the same one started again, takes its place by itself.

    Args:
        timeout: how long a controller lives after its last force [s]; may be set at any time.
    """

    def __init__(self, timeout: float) -> None:
        self.timeout = timeout
        self._heard: dict[str, float] = {}  # when [s]; the one silent for longest first

    def hear(self, identifier: str, now: float) -> None:
        """Note that a force of a controller has come."""
        self._heard.pop(identifier, None)
        self._heard[identifier] = now
        if len(self._heard) > _MOST:
            del self._heard[next(iter(self._heard))]

    def rivals(self, now: float) -> tuple[str, ...]:
        """Return the ids of two controllers that live, in order; none while at most one does."""
        living = [each for each, heard in self._heard.items() if now - heard <= self.timeout]
        return tuple(sorted(living[-2:])) if len(living) > 1 else ()

    def conflict(self, now: float) -> str:
        """Return what is wrong with two controllers that live, empty while at most one does."""
        rivals = self.rivals(now)
        if not rivals:
            return ''
        first, second = (each or 'one without an id' for each in rivals)
        return f'expected the forces of one controller, got those of {first} and {second}'
