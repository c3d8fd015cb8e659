"""Between targets and messages: apart, as not every node has to do with control."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

from sensor_msgs.msg import JointState

from dpc_ros.control import Target, TargetError
from dpc_ros.nodes.messages import MessageError, brief, finite, is_latent, latent_names, to_stamp


def target_message(target: Target, frame_id: str, stamp: int = 0) -> JointState:
    """Return the message of a target that counts from a stamp [ns] on, zero is at once."""
    message = JointState()
    message.header.stamp = to_stamp(stamp)
    message.header.frame_id = frame_id
    message.position = array('d', target.value.tobytes())
    if target.is_latent:
        message.name = latent_names(len(target.value))
    return message


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
        raise MessageError(f'expected the names {brief(names)}, got {brief(message.name)}')
    if not latent and message.header.frame_id not in ('', frame_id):
        raise MessageError(f'expected the frame {frame_id!r}, got {message.header.frame_id!r}')
    value = finite(message.position, len(names), 'positions')
    try:
        return Target(latent=value) if latent else Target(configuration=value)
    except TargetError as error:
        raise MessageError(str(error)) from error
