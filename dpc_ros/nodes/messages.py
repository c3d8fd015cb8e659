"""Between arrays and messages, by block copies; what doesn't fit is rejected with the reason."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
from jaxtyping import Float
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from dpc_ros.bag.force_frame import ForceFrame, force_frame, read_force_frame
from dpc_ros.bag.topic import LATENT_PREFIX, NANOSECONDS
from dpc_ros.finite import all_finite, all_within

if TYPE_CHECKING:
    from dpc_ros.control import Controllers


class MessageError(ValueError):
    """A message that can't be used: what was expected and what came."""


def read_message(data: bytes, message_type: type[Any]) -> Any:
    """Return the message that some bytes are.

    Raises:
        MessageError: they are none of this type.
    """
    try:
        return deserialize_message(data, message_type)
    except RuntimeError as error:  # the base of what rclpy raises
        raise MessageError(f'expected a {message_type.__name__}, got other bytes') from error


def to_stamp(nanoseconds: int) -> Time:
    """Return a message stamp."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def from_stamp(stamp: Time) -> int:
    """Return nanoseconds."""
    return stamp.sec * NANOSECONDS + stamp.nanosec


def read_stamp(stamp: Time) -> int:
    """Return the nanoseconds of a stamp that came from elsewhere.

    Raises:
        MessageError: it is negative, or its nanoseconds make a second.
    """
    if stamp.sec < 0 or not 0 <= stamp.nanosec < NANOSECONDS:
        raise MessageError(
            'expected a stamp from 0 on with less than 1000000000 ns beside its seconds, got '
            f'{stamp.sec} s and {stamp.nanosec} ns'
        )
    return from_stamp(stamp)


def latent_names(latent_size: int) -> list[str]:
    """Return the names of latent coordinates, from `xi_0` on."""
    return [f'{LATENT_PREFIX}{i}' for i in range(latent_size)]


def read_state(
    message: JointState, frame_id: str, names: Sequence[str]
) -> tuple[Float[np.ndarray, ' k'], Float[np.ndarray, ' k']]:
    """Return positions and velocities of a JointState.

    Args:
        message: what came.
        frame_id: what its frame must be.
        names: what its names must be, where it has any; their number is the size.

    Raises:
        MessageError: frame, names or size differ, or a value is not finite.
    """
    if message.header.frame_id != frame_id:
        raise MessageError(f'expected the frame {frame_id!r}, got {message.header.frame_id!r}')
    if message.name and list(message.name) != list(names):
        raise MessageError(f'expected the names {brief(names)}, got {brief(message.name)}')
    size = len(names)
    return (
        finite(message.position, size, 'positions'),
        finite(message.velocity, size, 'velocities'),
    )


def force_message(
    stamp: Time,
    mass: int,
    force: Float[np.ndarray, ' 2'],
    identifier: str = '',
    is_release: bool = False,
) -> WrenchStamped:
    """Return a WrenchStamped of a planar force [N] on a mass, from the controller of that id."""
    message = WrenchStamped()
    message.header.stamp = stamp
    message.header.frame_id = force_frame(mass, identifier, is_release)
    message.wrench.force.x = float(force[0])
    message.wrench.force.y = float(force[1])
    return message


def read_force(message: WrenchStamped) -> tuple[ForceFrame, Float[np.ndarray, ' 2']]:
    """Return what the frame of a WrenchStamped says, and the planar force [N].

    Raises:
        MessageError: the frame names no mass, a value is not finite, or it leaves the plane.
    """
    try:
        frame = read_force_frame(message.header.frame_id)
    except ValueError as error:
        raise MessageError(str(error)) from error
    force, torque = message.wrench.force, message.wrench.torque
    if force.z != 0 or torque.x != 0 or torque.y != 0 or torque.z != 0:
        raise MessageError('expected a force in the plane: its z and the torque must be zero')
    return frame, finite(array('d', (force.x, force.y)), 2, 'force components')


def hear_controller(controllers: Controllers, frame: ForceFrame, now: float) -> None:
    """Note that a force of a controller has come at a time [s] of a steady clock.

    Raises:
        MessageError: there is another one: of two, neither is believed.
    """
    controllers.hear(frame.controller, now)
    conflict = controllers.conflict(now)
    if conflict:
        raise MessageError(f'{conflict}: stop one of them')


def is_latent(target: JointState) -> bool:
    """Return whether a target is a latent state: its names say so."""
    return bool(target.name) and target.name[0].startswith(LATENT_PREFIX)


def parameters_message(
    node: str, stamp: Time, before: Mapping[str, Any], after: Mapping[str, Any]
) -> ParameterEvent:
    """Return what changes from a stamp on.

    Args:
        node: full name of the node.
        stamp: of the first state that the parameters count for.
        before: those in force until then, by name; what is not among them is new.
        after: those in force from then on.
    """
    changed = {name: value for name, value in after.items() if before.get(name) != value}
    messages = {
        name: Parameter(name, value=value).to_parameter_msg() for name, value in changed.items()
    }
    return ParameterEvent(
        stamp=stamp,
        node=node,
        new_parameters=[each for name, each in messages.items() if name not in before],
        changed_parameters=[each for name, each in messages.items() if name in before],
    )


def finite(values: array, size: int, what: str) -> np.ndarray:
    """Return the values of a message.

    Raises:
        MessageError: there are not as many as expected, or one is not finite.
    """
    if len(values) != size:
        raise MessageError(f'expected {size} {what}, got {len(values)}')
    result = np.frombuffer(values) if size else np.empty(0)
    if not all_finite(result):
        bad = int(np.flatnonzero(~np.isfinite(result))[0])
        raise MessageError(f'expected finite {what}, but number {bad} is {result[bad]}')
    return result


def check_within(values: Float[np.ndarray, ' k'], largest: float, what: str, unit: str) -> None:
    """Make sure that no value is beyond a bound, or is no number.

    Raises:
        MessageError: one is.
    """
    if not all_within(values, largest):
        found = float(np.abs(values).max())
        raise MessageError(f'expected a {what} of at most {largest:g} {unit}, got {found:g}')


def brief(names: Sequence[str]) -> str:
    """Return the first of some names, and how many there are."""
    shown = ', '.join(names[:2])
    return f'{shown}, … ({len(names)})' if len(names) > 2 else f'{shown} ({len(names)})'
