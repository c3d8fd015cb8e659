"""The signals of a log by epoch and stamp, and how far those of two logs are apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dpc_ros.bag.mcap_file import Message, read_contents, read_messages
from dpc_ros.bag.reader import Target, check_types, choose_namespace, read_target, stamp_of

_PARAMETERS_TOPIC = 'parameters_in_force'
_EMPTY = np.zeros(0)

Key = tuple[int, int]  # epoch, stamp [ns]


@dataclass(frozen=True, eq=False)
class Sample:
    """One message of a topic of the loop.

    Attributes:
        values: q and q̇, ξ and ξ̇, or u alone.
        publish_ns: when it was sent [ns since the epoch].
        from_restarted: whether its publisher has begun anew since the sample before.
    """

    values: tuple[np.ndarray, ...]
    publish_ns: int
    from_restarted: bool


@dataclass(eq=False)
class Signal:
    """The messages of one topic in recorded order, each stamp once within an epoch.

    An epoch ends where a stamp falls back: a simulator has begun anew.

    Attributes:
        samples: by epoch and stamp.
        frame_id: of the first message.
        epochs: their number.
    """

    samples: dict[Key, Sample] = field(default_factory=dict)
    frame_id: str = ''
    epochs: int = 1
    _stamp: int = -1
    _sequence: int = 0
    _restarted: bool = False

    def add(self, message: Message, values: tuple[np.ndarray, ...]) -> None:
        """Take the next message."""
        stamp = stamp_of(message.content)
        self.epochs += stamp < self._stamp
        self._stamp = stamp
        self._restarted |= message.sequence < self._sequence
        self._sequence = message.sequence
        key = (self.epochs - 1, stamp)
        if key in self.samples:
            return
        if not self.samples:
            self.frame_id = message.content.header.frame_id
        self.samples[key] = Sample(values, message.publish_time_ns, self._restarted)
        self._restarted = False


@dataclass(frozen=True, eq=False)
class Announcement:
    """A target of a log.

    Attributes:
        target: with its stamp.
        publish_ns: when it was sent [ns since the epoch].
    """

    target: Target
    publish_ns: int


@dataclass(frozen=True, eq=False)
class ParameterChange:
    """Parameters of the controller that came in force.

    Attributes:
        values: by name.
        publish_ns: when the controller said so [ns since the epoch].
    """

    values: Mapping[str, Any]
    publish_ns: int


@dataclass(frozen=True, eq=False)
class Signals:
    """What a log holds of a loop.

    Attributes:
        path: folder of the bag, or its MCAP file.
        namespace: of the topics, empty or `/body_2`.
        configuration: (q, q̇).
        latent: (ξ, ξ̇).
        force: (u,).
        targets: in the order in which they were sent.
        in_force: those that the controller announced as in force, likewise.
        parameters: what the controller announced as in force, likewise.
        metadata: the bag's records of keys and values, by name.
    """

    path: Path
    namespace: str
    configuration: Signal
    latent: Signal
    force: Signal
    targets: tuple[Announcement, ...]
    in_force: tuple[Announcement, ...]
    parameters: tuple[ParameterChange, ...]
    metadata: Mapping[str, Mapping[str, str]]

    def columns(self) -> dict[str, dict[Key, np.ndarray]]:
        """Return what is compared: latent states, their velocities and forces by name."""
        return {
            'latent': {key: sample.values[0] for key, sample in self.latent.samples.items()},
            'latent_velocity': {
                key: sample.values[1] for key, sample in self.latent.samples.items()
            },
            'force': {key: sample.values[0] for key, sample in self.force.samples.items()},
        }


@dataclass(frozen=True)
class Deviation:
    """How far a signal that was computed again is from the recorded one.

    Attributes:
        signal: its name.
        stamps: how many the log has.
        missing: of these, how many have no counterpart.
        differing: of the others, how many differ in any bit.
        first_stamp_ns: the first that is missing or differs; None where all are the same.
        absolute: largest difference of any component.
        relative: the same over the largest magnitude of any recorded component.
    """

    signal: str
    stamps: int
    missing: int
    differing: int
    first_stamp_ns: int | None
    absolute: float
    relative: float

    @property
    def is_identical(self) -> bool:
        """Whether all is there and the same, bit for bit."""
        return self.first_stamp_ns is None

    def is_within(self, tolerance: float) -> bool:
        """Whether all is there, and no farther off than a relative tolerance."""
        return not self.missing and (self.is_identical or self.relative <= tolerance)


def read_signals(path: str | Path, namespace: str | None = None) -> Signals:
    """Read the loop's topics of a log.

    Args:
        path: folder of the bag, or an MCAP file.
        namespace: of the topics; left out, the only one in which a configuration occurs.

    Raises:
        BagError: the path is no bag, a file is damaged, or it holds no run of one loop.
    """
    path = Path(path)
    contents = read_contents(path)
    namespace = choose_namespace(path, contents, namespace)
    check_types(path, contents, namespace)
    signals = {name: Signal() for name in _VALUES}
    targets: dict[str, list[Announcement]] = {'target': [], 'target_in_force': []}
    parameters: list[ParameterChange] = []
    names = (*signals, *targets, _PARAMETERS_TOPIC)
    topics = [f'{namespace}/{name}' for name in names]
    for message in read_messages(path, topics):
        name = message.topic.rpartition('/')[2]
        if name in signals:
            signals[name].add(message, _VALUES[name](message.content))
        elif name == _PARAMETERS_TOPIC:
            change = ParameterChange(_parameters(message.content), message.publish_time_ns)
            parameters.append(change)
        else:
            target = read_target(message.content)
            targets[name].append(Announcement(target, message.publish_time_ns))
    sent = {name: sorted(each, key=lambda one: one.publish_ns) for name, each in targets.items()}
    return Signals(
        path=path,
        namespace=namespace,
        configuration=signals['configuration'],
        latent=signals['latent_state'],
        force=signals['control_force'],
        targets=tuple(sent['target']),
        in_force=tuple(sent['target_in_force']),
        parameters=tuple(sorted(parameters, key=lambda one: one.publish_ns)),
        metadata=contents.metadata,
    )


def deviation(
    name: str, recorded: Mapping[Key, np.ndarray], repeated: Mapping[Key, np.ndarray]
) -> Deviation:
    """Compare a signal with the recorded one, stamp by stamp."""
    missing = differing = 0
    first: int | None = None
    absolute = magnitude = 0.0
    for key, expected in recorded.items():
        found = repeated.get(key, _EMPTY)
        fits = found.shape == expected.shape
        if fits and found.tobytes() == expected.tobytes():
            difference = 0.0
        elif fits:
            differing += 1
            difference = _largest(found - expected)
        else:
            missing += 1
            difference = 0.0
        if first is None and missing + differing:
            first = key[1]
        absolute = max(absolute, difference)
        magnitude = max(magnitude, _largest(expected))
    relative = absolute / magnitude if magnitude else (np.inf if absolute else 0.0)
    return Deviation(name, len(recorded), missing, differing, first, absolute, float(relative))


def _largest(values: np.ndarray) -> float:
    """Return the largest magnitude, infinite where one is no number."""
    return float(np.nan_to_num(np.abs(values), nan=np.inf, posinf=np.inf).max(initial=0.0))


def _state(content: Any) -> tuple[np.ndarray, ...]:
    return np.array(content.position, dtype=float), np.array(content.velocity, dtype=float)


def _force(content: Any) -> tuple[np.ndarray, ...]:
    return (np.array([content.wrench.force.x, content.wrench.force.y]),)


def _parameters(content: Any) -> dict[str, Any]:
    """Return the values of a decoded rcl_interfaces/msg/ParameterEvent by name."""
    given = (*content.new_parameters, *content.changed_parameters)
    return {each.name: getattr(each.value, _FIELDS[each.value.type]) for each in given}


# Where a rcl_interfaces/msg/ParameterValue keeps a value, by its type.
_FIELDS = {1: 'bool_value', 2: 'integer_value', 3: 'double_value', 4: 'string_value'}

_VALUES: dict[str, Callable[[Any], tuple[np.ndarray, ...]]] = {
    'configuration': _state,
    'latent_state': _state,
    'control_force': _force,
}
