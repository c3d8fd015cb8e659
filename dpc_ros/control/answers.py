"""The last answer of a node: a stamp is answered the same way however often it comes."""

from __future__ import annotations

from typing import Any

from dpc_ros.control.stamps import LONGEST_GAP, NANOSECOND

_LONGEST_GAP_NS = round(LONGEST_GAP / NANOSECOND)


class Answers:
    """Remembers the newest question with its stamp and answer; sees when stamps begin anew.

    Stamps of one simulator rise for ever, and a reliable connection keeps their order. A stamp that
    falls back therefore means that another simulator has begun: a new epoch. None is too old.
    """

    def __init__(self) -> None:
        self._stamp = -1
        self._former = -1
        self._question: Any = None
        self._answer: Any = None

    @property
    def newest(self) -> tuple[int, Any]:
        """Stamp [ns] and content of the last answer; −1 and none before the first."""
        return self._stamp, self._answer

    def is_of_former_epoch(self, stamp: int) -> bool:
        """Return whether a stamp [ns] is of no question so far but may be of the epoch before."""
        return self._stamp < stamp <= self._former

    def repeated(self, stamp: int, question: Any) -> Any:
        """Return the answer already given to the same question at the same stamp [ns], or none."""
        return self._answer if stamp == self._stamp and question == self._question else None

    def starts_epoch(self, stamp: int) -> bool:
        """Return whether a stamp [ns] lies before the newest one."""
        return stamp < self._stamp

    def begins_anew(self, stamp: int) -> bool:
        """Return whether a motion begins at a stamp [ns]: an epoch, or after a leap of the stamps.

        A simulator that sets its body back leaps ahead by more than any gap within a motion.
        """
        return self.starts_epoch(stamp) or stamp - self._stamp > _LONGEST_GAP_NS

    def remember(self, stamp: int, question: Any, answer: Any) -> None:
        """Keep the answer to a question at a stamp [ns] as the newest."""
        if self.starts_epoch(stamp):
            self._former = self._stamp
        self._stamp = stamp
        self._question = question
        self._answer = answer
