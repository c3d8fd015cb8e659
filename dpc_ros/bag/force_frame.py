"""The frame of a force: the mass that it acts on, and the controller that commands it."""

from __future__ import annotations

import re
from typing import NamedTuple

# Bounded: Python makes no number of thousands of digits, and an id is shown in every report.
_FRAME = re.compile(r'mass_([0-9]{1,7})(?:@([0-9A-Za-z_]{1,32})(:released)?)?')


class ForceFrame(NamedTuple):
    """What the frame of a force says.

    Attributes:
        mass: number of the mass that it acts on.
        controller: id of the controller that it comes from, '' where it names none.
        is_release: whether that controller lets go of the body, and answers no state.
    """

    mass: int
    controller: str = ''
    is_release: bool = False


def force_frame(mass: int, controller: str = '', is_release: bool = False) -> str:
    """Return the `frame_id` of forces on a mass: `mass_162`, `mass_162@1f3a9c02` with an id.

    With `:released` behind the id the controller lets go of the body.
    """
    if not controller:
        return f'mass_{mass}'
    return f'mass_{mass}@{controller}{":released" if is_release else ""}'


def read_force_frame(frame_id: str) -> ForceFrame:
    """Return what a frame says.

    Raises:
        ValueError: it is no frame of a force.
    """
    found = _FRAME.fullmatch(frame_id)
    if found is None:
        raise ValueError(
            f'expected a frame like {force_frame(162)!r} or {force_frame(162, "1f3a9c02")!r}, '
            f'got {frame_id[:64]!r}'
        )
    return ForceFrame(int(found[1]), found[2] or '', bool(found[3]))


def without_controller(frame_id: str) -> str:
    """Return the frame of a force without its controller, which is another in each run."""
    found = _FRAME.fullmatch(frame_id)
    return frame_id if found is None else force_frame(int(found[1]))
