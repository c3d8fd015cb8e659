"""What the numbers of one publisher's messages leave out."""

from __future__ import annotations


class Sequence:
    """Counts lost messages, in whatever order the others were recorded.

    Numbers that start anew are those of a restarted publisher: nothing is known to be lost. A
    message that was published before the one recorded last has come late, and is not lost.

    Attributes:
        lost: messages that are missing between those that were recorded.
        is_numbered: whether the publisher numbers its messages.
    """

    def __init__(self) -> None:
        self.lost = 0
        self.is_numbered = False
        self._last = 0
        self._published_ns = 0
        self._missing: list[range] = []

    def add(self, number: int, published_ns: int) -> None:
        """Take the number of the next message recorded, 0 for none, and when it was published."""
        if published_ns < self._published_ns and self._found(number):
            return
        if 0 < self._last < number - 1:
            self._missing.append(range(self._last + 1, number))
            self.lost += number - self._last - 1
        self._last, self._published_ns = number, published_ns
        self.is_numbered = number > 0

    def _found(self, number: int) -> bool:
        for place, gap in enumerate(self._missing):
            if number in gap:
                parts = range(gap.start, number), range(number + 1, gap.stop)
                self._missing[place : place + 1] = [part for part in parts if part]
                self.lost -= 1
                return True
        return False
