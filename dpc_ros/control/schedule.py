"""Which target is in force at which time."""

from __future__ import annotations

from dpc_ros.control.targets import Target, TargetError

_MOST = 100  # targets that may wait for their time


class TargetSchedule:
    """Targets by the stamp from which they count; of those due, the newest is in force.

    A stamp of zero means at once. Of two targets with the same stamp the later given one wins.
    """

    def __init__(self) -> None:
        self._pending: dict[int, Target] = {}
        self._in_force: tuple[int, Target] | None = None

    def add(self, stamp: int, target: Target) -> None:
        """Take a target that counts from a stamp [ns] on.

        Raises:
            TargetError: too many wait already.
        """
        if len(self._pending) >= _MOST and stamp not in self._pending:
            raise TargetError(
                f'expected at most {_MOST} targets that wait for their stamp, got one more for '
                f'{stamp / 1e9:g} s: is that the time of the simulation?'
            )
        self._pending.pop(stamp, None)  # of equal stamps the later one wins: keep one, in its turn
        self._pending[stamp] = target

    def in_force(self, stamp: int) -> Target | None:
        """Return the target in force at a stamp [ns], none before the first."""
        for begin in [begin for begin in self._pending if begin <= stamp]:
            target = self._pending.pop(begin)
            if self._in_force is None or begin == 0 or begin >= self._in_force[0]:
                self._in_force = (begin or stamp, target)
        return None if self._in_force is None else self._in_force[1]

    def restart(self) -> None:
        """Begin a new epoch of stamps: the target in force stays so, from the beginning."""
        if self._in_force is not None:
            self._in_force = (0, self._in_force[1])
