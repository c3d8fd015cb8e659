"""What the publishers of a topic offer, and the subscription that takes the most of it."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from dpc_ros.bag import QosProfile
from dpc_ros.bag.topic import INFINITE_NS


def fitting_profile(publishers: Sequence[TopicEndpointInfo], depth: int) -> QoSProfile:
    """Return the strictest profile that matches every publisher.

    Reliable only if all are, transient local only if all are: one that offers less would not be
    heard at all.

    Args:
        publishers: at least one.
        depth: messages that the subscription keeps.
    """
    offered = [each.qos_profile for each in publishers]
    all_reliable = all(each.reliability != ReliabilityPolicy.BEST_EFFORT for each in offered)
    all_latched = all(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=(ReliabilityPolicy.RELIABLE if all_reliable else ReliabilityPolicy.BEST_EFFORT),
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if all_latched else DurabilityPolicy.VOLATILE),
    )


def hears_any(requested: QoSProfile, publishers: Sequence[TopicEndpointInfo]) -> bool:
    """Return whether a subscription matches at least one of the publishers."""
    return any(
        (
            requested.reliability != ReliabilityPolicy.RELIABLE
            or each.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT
        )
        and (
            requested.durability != DurabilityPolicy.TRANSIENT_LOCAL
            or each.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        )
        for each in publishers
    )


def offered_profiles(publishers: Sequence[TopicEndpointInfo]) -> tuple[QosProfile, ...]:
    """Return what each publisher offers, in the words of a bag."""
    return tuple(
        QosProfile(
            history=each.qos_profile.history.short_key,
            depth=each.qos_profile.depth,
            reliability=each.qos_profile.reliability.short_key,
            durability=each.qos_profile.durability.short_key,
            deadline_ns=_nanoseconds(each.qos_profile.deadline),
            lifespan_ns=_nanoseconds(each.qos_profile.lifespan),
            liveliness=each.qos_profile.liveliness.short_key,
            liveliness_lease_duration_ns=_nanoseconds(each.qos_profile.liveliness_lease_duration),
        )
        for each in publishers
    )


def type_hash(publishers: Sequence[TopicEndpointInfo]) -> str:
    """Return the hash of the type of a topic, empty where it is not known."""
    text = str(publishers[0].topic_type_hash) if publishers else ''
    return text if text.startswith('RIHS01_') else ''  # rclpy says INVALID where it has none


def _nanoseconds(duration: Duration) -> int:
    """Return a duration as a bag has it: none given, and any beyond the largest, is without end."""
    return min(duration.nanoseconds or INFINITE_NS, INFINITE_NS)
