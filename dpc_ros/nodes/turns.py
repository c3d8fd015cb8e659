"""States and forces of one loop in their turn, though they come on two topics without an order."""

from __future__ import annotations

from typing import Any


class Turns:
    """Keeps a state back until the force that answers the one before has come.

    In lockstep that force is on its way whenever the next state is. By the wall clock it may be
    late: when a newer state comes while one waits, both go on without it, and so do all others
    until a force is in time again.
    """

    def __init__(self) -> None:
        self._unanswered: int | None = None  # stamp of the newest state that went on, [ns]
        self._waiting: tuple[int, Any] | None = None
        self._late = False

    def waits(self, stamp: int) -> bool:
        """Return whether it is the state of this stamp [ns] that waits."""
        return self._waiting is not None and self._waiting[0] == stamp

    def come(self, stamp: int, state: Any) -> list[Any]:
        """Take a new state; return those, in order, that are to go on now."""
        if self._waiting is not None:
            before, self._waiting = self._waiting[1], None
            self._late = True
            self._unanswered = stamp
            return [before, state]
        if self._unanswered is not None and not self._late:
            self._waiting = (stamp, state)
            return []
        self._unanswered = stamp
        return [state]

    def answered(self, stamp: int) -> list[Any]:
        """Take the force for the state of a stamp [ns]; return the states that are to go on now."""
        if stamp != self._unanswered:
            return []
        self._unanswered, self._late = None, False
        if self._waiting is None:
            return []
        (self._unanswered, state), self._waiting = self._waiting, None
        return [state]
