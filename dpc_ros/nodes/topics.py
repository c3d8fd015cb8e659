"""The topics of the loop: their types and their quality of service (docs/interface.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import ParameterEvent
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

# Messages of more than one second at 1 kHz: a slow recorder loses nothing.
_LOOP_DEPTH = 2000
# Who acts on states and was held up takes only these, the newest: answers to old ones do harm.
MOST_STATES = 20

LOOP_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=_LOOP_DEPTH,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
TARGET_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
# Who comes late learns what was in force before, too.
IN_FORCE_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


@dataclass(frozen=True)
class Topic:
    """A topic's type and quality of service; who subscribes may keep more messages, or fewer."""

    message_type: type[Any]
    qos: QoSProfile


TOPICS = {
    'configuration': Topic(JointState, LOOP_QOS),
    'latent_state': Topic(JointState, LOOP_QOS),
    'target': Topic(JointState, TARGET_QOS),
    'target_in_force': Topic(JointState, IN_FORCE_QOS),
    'parameters': Topic(ParameterEvent, IN_FORCE_QOS),
    'parameters_in_force': Topic(ParameterEvent, IN_FORCE_QOS),
    'control_force': Topic(WrenchStamped, LOOP_QOS),
    'external_force': Topic(WrenchStamped, LOOP_QOS),
}
