"""The frame of a force: the mass that it acts on, and the controller that commands it."""

from __future__ import annotations

import re

# Bounded: Python makes no number of thousands of digits, and an id is shown in every report.
_FRAME = re.compile(r'mass_([0-9]{1,7})(?:@([0-9A-Za-z_]{1,32}))?')


def force_frame(mass: int, controller: str = '') -> str:
    """Return the `frame_id` of forces on a mass, `mass_162`, or `mass_162@1f3a9c02` with an id."""
    return f'mass_{mass}@{controller}' if controller else f'mass_{mass}'


def read_force_frame(frame_id: str) -> tuple[int, str]:
    """Return the mass that a frame names, and the id of the controller, '' where it names none.

    Raises:
        ValueError: it is no frame of a force.
    """
    found = _FRAME.fullmatch(frame_id)
    if found is None:
        raise ValueError(
            f'expected a frame like {force_frame(162)!r} or {force_frame(162, "1f3a9c02")!r}, '
            f'got {frame_id[:64]!r}'
        )
    return int(found[1]), found[2] or ''


def without_controller(frame_id: str) -> str:
    """Return the frame of a force without its controller, which is another in each run."""
    found = _FRAME.fullmatch(frame_id)
    return frame_id if found is None else force_frame(int(found[1]))
