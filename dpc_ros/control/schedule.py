"""Which target is in force at which time."""

from __future__ import annotations

from dpc_ros.control.targets import Target


class TargetSchedule:
    """Targets by the stamp from which they count; of those due, the newest is in force.

    A stamp of zero means at once. Of two targets with the same stamp the later given one wins.
    """

    def __init__(self) -> None:
        self._pending: list[tuple[int, Target]] = []
        self._in_force: tuple[int, Target] | None = None

    def add(self, stamp: int, target: Target) -> None:
        """Take a target that counts from a stamp [ns] on."""
        self._pending.append((stamp, target))

    def in_force(self, stamp: int) -> Target | None:
        """Return the target in force at a stamp [ns], none before the first."""
        for entry in [entry for entry in self._pending if entry[0] <= stamp]:
            self._pending.remove(entry)
            if self._in_force is None or entry[0] == 0 or entry[0] >= self._in_force[0]:
                self._in_force = (entry[0] or stamp, entry[1])
        return None if self._in_force is None else self._in_force[1]

    def restart(self) -> None:
        """Begin a new epoch of stamps: the target in force stays so, from the beginning."""
        if self._in_force is not None:
            self._in_force = (0, self._in_force[1])
