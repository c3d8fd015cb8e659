"""The messages of the loop as the bytes that DDS carries (CDR), by block copies.

To make an object of a message, with an object for each of its parts, costs several times what its
content does. All messages of one publisher differ in stamp and numbers only: where these stand is
known, and a message counts as one of these if it has the same bytes everywhere else. Whatever else
comes, rclpy takes apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from struct import Struct
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped
from jaxtyping import Float
from sensor_msgs.msg import JointState

from dpc_ros.bag.force_frame import ForceFrame
from dpc_ros.bag.topic import NANOSECONDS
from dpc_ros.finite import all_finite
from dpc_ros.nodes.messages import read_force, read_message, read_stamp, read_state

_ENCODING = b'\x00\x01\x00\x00'  # plain CDR, little-endian; alignment counts from behind it
_STAMP = Struct('<iI')
_COUNT = Struct('<I')  # of characters, of elements
_NUMBER = 8  # bytes


class StateMessage(NamedTuple):
    """What a JointState says.

    Attributes:
        stamp: [ns].
        position: (k,).
        velocity: (k,).
    """

    stamp: int
    position: Float[np.ndarray, ' k']
    velocity: Float[np.ndarray, ' k']

    @property
    def content(self) -> tuple[bytes, bytes]:
        """Its numbers, to be compared: the bytes of a message may differ in what aligns them."""
        return self.position.tobytes(), self.velocity.tobytes()


class ForceMessage(NamedTuple):
    """What a WrenchStamped says.

    Attributes:
        stamp: [ns].
        frame: the mass, and who commands it.
        force: in the plane [N].
    """

    stamp: int
    frame: ForceFrame
    force: Float[np.ndarray, ' 2']


class Pattern:
    """Messages that are alike but for their stamp and some arrays of numbers.

    Args:
        message: one of them.
        begin: where its numbers do, in bytes.
        arrays: where the arrays lie, counted in numbers from there on.
    """

    def __init__(self, message: bytes, begin: int, *arrays: slice) -> None:
        self._message = bytearray(message)
        self._begin = begin
        self._count = arrays[-1].stop
        self._arrays = arrays
        self._views = [self._numbers_of(self._message)[place] for place in arrays]
        free = [slice(len(_ENCODING), len(_ENCODING) + _STAMP.size)]
        free += [
            slice(begin + _NUMBER * each.start, begin + _NUMBER * each.stop) for each in arrays
        ]
        ends = [0, *(place.stop for place in free)]
        begins = [*(place.start for place in free), len(message)]
        same = [slice(*place) for place in zip(ends, begins, strict=True)]
        self._same = [(place, message[place]) for place in same]

    def write(self, stamp: int, *arrays: Float[np.ndarray, ' k']) -> bytes:
        """Return the message of a stamp [ns]."""
        _STAMP.pack_into(self._message, len(_ENCODING), *divmod(stamp, NANOSECONDS))
        for view, array in zip(self._views, arrays, strict=True):
            view[:] = array
        return bytes(self._message)

    def read(self, data: bytes) -> tuple[Any, ...] | None:
        """Return stamp [ns] and arrays of a message, None unless it is a sound one of these."""
        if len(data) != len(self._message):
            return None
        for place, content in self._same:
            if data[place] != content:
                return None
        seconds, rest = _STAMP.unpack_from(data, len(_ENCODING))
        numbers = self._numbers_of(data).copy()  # in the data they are not aligned
        if seconds < 0 or rest >= NANOSECONDS or not all_finite(numbers):
            return None
        stamp = seconds * NANOSECONDS + rest
        return (stamp, *[numbers[place] for place in self._arrays])

    def _numbers_of(self, data: bytes | bytearray) -> np.ndarray:
        return np.frombuffer(data, count=self._count, offset=self._begin)


def state_pattern(frame_id: str, size: int, names: Sequence[str] = ()) -> Pattern:
    """Return the JointStates of a frame: with so many positions and velocities, at least one."""
    head = _with_text(_ENCODING + bytes(_STAMP.size), frame_id)
    head = _aligned(head, _COUNT.size) + _COUNT.pack(len(names))
    for name in names:
        head = _with_text(head, name)
    count, numbers = _COUNT.pack(size), bytes(_NUMBER * size)
    positions = _aligned(_aligned(head, _COUNT.size) + count, _NUMBER)
    velocities = _aligned(positions + numbers + count, _NUMBER)  # the count fills up one number
    no_efforts = _COUNT.pack(0)
    return Pattern(
        velocities + numbers + no_efforts,
        len(positions),
        slice(0, size),
        slice(size + 1, 2 * size + 1),
    )


def force_pattern(frame_id: str) -> Pattern:
    """Return the WrenchStampeds of a frame whose forces are in the plane."""
    head = _aligned(_with_text(_ENCODING + bytes(_STAMP.size), frame_id), _NUMBER)
    force_and_torque = bytes(_NUMBER * (3 + 3))
    return Pattern(head + force_and_torque, len(head), slice(0, 2))


def _with_text(data: bytes, text: str) -> bytes:
    encoded = text.encode() + b'\0'
    return _aligned(data, _COUNT.size) + _COUNT.pack(len(encoded)) + encoded


def _aligned(data: bytes, size: int) -> bytes:
    """Return data with zeros behind it up to the next place that is aligned to a size."""
    return data + bytes((len(_ENCODING) - len(data)) % size)


class StateReader:
    """Reads the JointStates of a topic; see `read_state`.

    Args:
        frame_id: what their frame must be.
        names: what their names must be, where they have any; their number is the size.
    """

    def __init__(self, frame_id: str, names: list[str]) -> None:
        self._frame_id = frame_id
        self._names = names
        self._sent_names: list[str] = []
        self._pattern = state_pattern(frame_id, len(names))

    def read(self, data: bytes) -> StateMessage:
        """Return what a message says.

        Raises:
            MessageError: the bytes are no JointState; stamp, frame, names or size are wrong, or a
                value is not finite.
        """
        found = self._pattern.read(data)
        return self._read_any(data) if found is None else StateMessage(*found)

    def _read_any(self, data: bytes) -> StateMessage:
        message = read_message(data, JointState)
        stamp = read_stamp(message.header.stamp)
        state = read_state(message, self._frame_id, self._names)
        if message.name != self._sent_names:
            self._sent_names = message.name
            self._pattern = state_pattern(self._frame_id, len(self._names), message.name)
        return StateMessage(stamp, *state)


class ForceReader:
    """Reads the WrenchStampeds of a topic; see `read_force`."""

    def __init__(self) -> None:
        self._frame = ForceFrame(-1)
        self._pattern: Pattern | None = None  # until one has come

    def read(self, data: bytes) -> ForceMessage:
        """Return what a message says.

        Raises:
            MessageError: the bytes are no WrenchStamped, its stamp is wrong, its frame names no
                mass, a value is not finite, or it leaves the plane.
        """
        found = self._pattern.read(data) if self._pattern is not None else None
        if found is None:
            return self._read_any(data)
        stamp, force = found
        return ForceMessage(stamp, self._frame, force)

    def _read_any(self, data: bytes) -> ForceMessage:
        message = read_message(data, WrenchStamped)
        stamp = read_stamp(message.header.stamp)
        frame, force = read_force(message)
        self._frame, self._pattern = frame, force_pattern(message.header.frame_id)
        return ForceMessage(stamp, frame, force)
