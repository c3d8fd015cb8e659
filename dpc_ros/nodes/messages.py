"""Between arrays and messages, by block copies; what doesn't fit is rejected with the reason."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
from jaxtyping import Float
from sensor_msgs.msg import JointState

from dpc_ros.bag.reader import LATENT_PREFIX
from dpc_ros.bag.topic import NANOSECONDS
from dpc_ros.control import Target, TargetError


class MessageError(ValueError):
    """A message that can't be used: what was expected and what came."""


def to_stamp(nanoseconds: int) -> Time:
    """Return a message stamp."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def from_stamp(stamp: Time) -> int:
    """Return nanoseconds."""
    return stamp.sec * NANOSECONDS + stamp.nanosec


def latent_names(latent_size: int) -> list[str]:
    """Return the names of latent coordinates, from `xi_0` on."""
    return [f'{LATENT_PREFIX}{i}' for i in range(latent_size)]


def mass_frame(mass: int) -> str:
    """Return the `frame_id` of forces on a mass, `mass_162`."""
    return f'mass_{mass}'


def state_message(
    stamp: Time,
    frame_id: str,
    position: Float[np.ndarray, ' k'],
    velocity: Float[np.ndarray, ' k'],
    names: Sequence[str] = (),
) -> JointState:
    """Return a JointState of positions and velocities."""
    message = JointState()
    message.header.stamp = stamp
    message.header.frame_id = frame_id
    message.name = list(names)
    message.position = array('d', position.tobytes())
    message.velocity = array('d', velocity.tobytes())
    return message


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
        raise MessageError(f'expected the names {_brief(names)}, got {_brief(message.name)}')
    size = len(names)
    return (
        _finite(message.position, size, 'positions'),
        _finite(message.velocity, size, 'velocities'),
    )


def force_message(stamp: Time, mass: int, force: Float[np.ndarray, ' 2']) -> WrenchStamped:
    """Return a WrenchStamped of a planar force [N] on a mass."""
    message = WrenchStamped()
    message.header.stamp = stamp
    message.header.frame_id = mass_frame(mass)
    message.wrench.force.x = float(force[0])
    message.wrench.force.y = float(force[1])
    return message


def read_force(message: WrenchStamped) -> tuple[int, Float[np.ndarray, ' 2']]:
    """Return the mass that a WrenchStamped names and the planar force [N].

    Raises:
        MessageError: the frame names no mass, a value is not finite, or it leaves the plane.
    """
    prefix, _, number = message.header.frame_id.partition('_')
    if prefix != 'mass' or not number.isdecimal():
        raise MessageError(
            f'expected a frame like {mass_frame(162)!r}, got {message.header.frame_id!r}'
        )
    force, torque = message.wrench.force, message.wrench.torque
    if force.z != 0 or torque.x != 0 or torque.y != 0 or torque.z != 0:
        raise MessageError('expected a force in the plane: its z and the torque must be zero')
    return int(number), _finite(array('d', (force.x, force.y)), 2, 'force components')


def target_message(target: Target, frame_id: str, stamp: int = 0) -> JointState:
    """Return the message of a target that counts from a stamp [ns] on, zero is at once."""
    message = JointState()
    message.header.stamp = to_stamp(stamp)
    message.header.frame_id = frame_id
    message.position = array('d', target.value.tobytes())
    if target.is_latent:
        message.name = latent_names(len(target.value))
    return message


def is_latent(target: JointState) -> bool:
    """Return whether a target is a latent state: its names say so."""
    return bool(target.name) and target.name[0].startswith(LATENT_PREFIX)


def read_target(
    message: JointState, frame_id: str, coordinate_names: Sequence[str], latent_size: int
) -> Target:
    """Return the target of a message: a latent state where it is named so, else a configuration.

    Args:
        message: what came.
        frame_id: what the frame of a configuration must be, where it has one.
        coordinate_names: names of the coordinates; their number is the size.
        latent_size: m.

    Raises:
        MessageError: frame, names or size differ, or a value is not finite.
    """
    latent = is_latent(message)
    names = latent_names(latent_size) if latent else coordinate_names
    if message.name and list(message.name) != list(names):
        raise MessageError(f'expected the names {_brief(names)}, got {_brief(message.name)}')
    if not latent and message.header.frame_id not in ('', frame_id):
        raise MessageError(f'expected the frame {frame_id!r}, got {message.header.frame_id!r}')
    value = _finite(message.position, len(names), 'positions')
    try:
        return Target(latent=value) if latent else Target(configuration=value)
    except TargetError as error:
        raise MessageError(str(error)) from error


def _finite(values: array, size: int, what: str) -> np.ndarray:
    if len(values) != size:
        raise MessageError(f'expected {size} {what}, got {len(values)}')
    result = np.frombuffer(values) if size else np.empty(0)
    if not np.isfinite(result).all():
        bad = int(np.flatnonzero(~np.isfinite(result))[0])
        raise MessageError(f'expected finite {what}, but number {bad} is {result[bad]}')
    return result


def _brief(names: Sequence[str]) -> str:
    shown = ', '.join(names[:2])
    return f'{shown}, … ({len(names)})' if len(names) > 2 else f'{shown} ({len(names)})'
