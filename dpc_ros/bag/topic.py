"""What a bag says of a topic: its name, its type and the quality of service it was offered with."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import yaml

LATENT_PREFIX = 'xi_'  # how the names of latent coordinates start
NANOSECONDS = 1_000_000_000  # per second
INFINITE_NS = 2**63 - 1  # ns, what ROS 2 writes for a duration without end

_POLICIES = {
    'history': ('system_default', 'keep_last', 'keep_all', 'unknown'),
    'reliability': ('system_default', 'reliable', 'best_effort', 'unknown', 'best_available'),
    'durability': ('system_default', 'transient_local', 'volatile', 'unknown', 'best_available'),
    'liveliness': ('system_default', 'automatic', 'manual_by_topic', 'unknown', 'best_available'),
}
_DURATIONS = ('deadline_ns', 'lifespan_ns', 'liveliness_lease_duration_ns')
_TYPE_NAME = re.compile(r'[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*')


@dataclass(frozen=True)
class QosProfile:
    """The quality of service that one publisher offers, in the words of rosbag2.

    Attributes:
        history: `keep_last`, `keep_all`, `system_default` or `unknown`.
        depth: messages kept by `keep_last`.
        reliability: `reliable`, `best_effort`, …
        durability: `transient_local`, `volatile`, …
        deadline_ns: longest time between two messages [ns].
        lifespan_ns: time after which a message is stale [ns].
        liveliness: `automatic`, `manual_by_topic`, …
        liveliness_lease_duration_ns: time after which a silent publisher counts as dead [ns].
        avoid_ros_namespace_conventions: whether the topic has the same name on DDS.

    Raises:
        ValueError: an unknown policy, or a depth or duration out of range.
    """

    history: str = 'keep_last'
    depth: int = 10
    reliability: str = 'reliable'
    durability: str = 'volatile'
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: str = 'automatic'
    liveliness_lease_duration_ns: int = INFINITE_NS
    avoid_ros_namespace_conventions: bool = False

    def __post_init__(self) -> None:
        for policy, words in _POLICIES.items():
            if getattr(self, policy) not in words:
                raise ValueError(
                    f'{policy}: expected one of {words}, got {getattr(self, policy)!r}'
                )
        if self.depth < 0:
            raise ValueError(f'depth: expected a number of messages ≥ 0, got {self.depth}')
        for duration in _DURATIONS:
            if not 0 <= getattr(self, duration) <= INFINITE_NS:
                raise ValueError(
                    f'{duration}: expected 0 to {INFINITE_NS} ns, got {getattr(self, duration)}'
                )


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        name: absolute name, `/configuration`.
        type_name: `<package>/msg/<Name>`.
        definition: the text of the message definition and, behind lines of `=`, of every type it
            needs (MCAP's `ros2msg`).
        offered_qos_profiles: one profile for each publisher seen; may be empty.
        type_hash: `RIHS01_…`, or empty where it is not known.

    Raises:
        ValueError: the name is not absolute, the type is none, or the definition is empty.
    """

    name: str
    type_name: str
    definition: str
    offered_qos_profiles: tuple[QosProfile, ...] = ()
    type_hash: str = ''

    def __post_init__(self) -> None:
        object.__setattr__(self, 'offered_qos_profiles', tuple(self.offered_qos_profiles))
        if not self.name.startswith('/') or self.name.endswith('/'):
            raise ValueError(
                f'topic: expected an absolute name as /configuration, got {self.name!r}'
            )
        if not _TYPE_NAME.fullmatch(self.type_name):
            raise ValueError(
                f'{self.name}: expected a type as std_msgs/msg/Header, got {self.type_name!r}'
            )
        if not self.definition.strip():
            raise ValueError(f'{self.name}: the definition of {self.type_name} is empty')


def qos_content(profile: QosProfile) -> dict[str, Any]:
    """Return a profile as rosbag2 (format version 9) writes it."""
    return {
        'history': profile.history,
        'depth': profile.depth,
        'reliability': profile.reliability,
        'durability': profile.durability,
        'deadline': _duration(profile.deadline_ns),
        'lifespan': _duration(profile.lifespan_ns),
        'liveliness': profile.liveliness,
        'liveliness_lease_duration': _duration(profile.liveliness_lease_duration_ns),
        'avoid_ros_namespace_conventions': profile.avoid_ros_namespace_conventions,
    }


def qos_text(profiles: tuple[QosProfile, ...]) -> str:
    """Return the YAML that rosbag2 keeps with the channel of an MCAP file."""
    return yaml.safe_dump([qos_content(profile) for profile in profiles], sort_keys=False).strip()


def offered_profiles(channel_metadata: Mapping[str, str]) -> tuple[QosProfile, ...]:
    """Return the profiles that the channel of an MCAP file names.

    They are empty where there are none that rosbag2 wrote since its format version 9.
    """
    return _profiles(channel_metadata.get('offered_qos_profiles', ''))


@lru_cache(maxsize=256)  # every file of a log says the same of its topics
def _profiles(text: str) -> tuple[QosProfile, ...]:
    try:
        return tuple(_profile(content) for content in yaml.safe_load(text) or ())
    except (yaml.YAMLError, RecursionError, LookupError, TypeError, ValueError):
        return ()


def _profile(content: dict[str, Any]) -> QosProfile:
    durations = {
        f'{key}_ns': content[key]['sec'] * NANOSECONDS + content[key]['nsec']
        for key in ('deadline', 'lifespan', 'liveliness_lease_duration')
    }
    words = {key: content[key] for key in (*_POLICIES, 'depth', 'avoid_ros_namespace_conventions')}
    return QosProfile(**words, **durations)


def _duration(nanoseconds: int) -> dict[str, int]:
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return {'sec': seconds, 'nsec': rest}
