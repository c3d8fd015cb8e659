"""Reading a run: the arrays of the closed loop out of the log of its topics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from dpc_ros.bag.force_frame import read_force_frame
from dpc_ros.bag.mcap_file import (
    Contents,
    Message,
    read_contents,
    read_messages,
)
from dpc_ros.bag.sequence import Sequence
from dpc_ros.bag.splits import BagError
from dpc_ros.bag.topic import LATENT_PREFIX, NANOSECONDS

_JOINT_STATE = 'sensor_msgs/msg/JointState'
_WRENCH = 'geometry_msgs/msg/WrenchStamped'
_PARAMETERS = 'rcl_interfaces/msg/ParameterEvent'
_TYPES = {
    'configuration': _JOINT_STATE,
    'latent_state': _JOINT_STATE,
    'target': _JOINT_STATE,
    'target_in_force': _JOINT_STATE,
    'parameters_in_force': _PARAMETERS,
    'control_force': _WRENCH,
    'external_force': _WRENCH,
}
_LATEST = np.iinfo(np.int64).max  # ns; a file may hold any 64 bits


@dataclass(frozen=True, eq=False)
class Target:
    """Where the body was told to go.

    Attributes:
        stamp_ns: from when on it is in force [ns]; 0 means from the beginning.
        configuration: q̄ [m], or None where the target is a latent one.
        latent: ξ̄, or None where the target is a configuration.
        frame_id: of the message.
    """

    stamp_ns: int
    configuration: Float[np.ndarray, ' n'] | None
    latent: Float[np.ndarray, ' m'] | None
    frame_id: str


@dataclass(frozen=True, eq=False)
class Arrivals:
    """When the messages of a topic came: of the first of each stamp, in the order of the stamps.

    Attributes:
        published_ns: when it was sent [ns since the epoch].
        received_ns: when it was recorded [ns since the epoch].
        lost: messages of the topic that were known to be missing by then.
    """

    published_ns: Int[np.ndarray, ' stamps']
    received_ns: Int[np.ndarray, ' stamps']
    lost: Int[np.ndarray, ' stamps']


@dataclass(frozen=True, eq=False)
class Run:
    """The log of a closed loop, each signal in the order of its stamps, each stamp once.

    Attributes:
        path: folder of the bag, or its MCAP file.
        namespace: of the topics, empty or `/body_2`.
        configuration_stamp: of each state of the body [ns].
        configuration: q [m].
        velocity: q̇ [m/s].
        latent_stamp: of each latent state [ns].
        latent: ξ.
        latent_velocity: ξ̇ [1/s].
        force_stamp: of each force of the controller [ns].
        force: u [N].
        external_force_stamp: of each external force [ns].
        external_force: [N].
        targets: in the order of their stamps, of equal stamps the last received last: those that
            the controller announced as in force, from when on each counted; where it announced
            none, those that were published.
        network_identifier: `<network>@<digest>`.
        autoencoder_identifier: `<checkpoint>@<digest>`, empty where no latent state is logged.
        messages: number of messages of each topic of the bag.
        repeats: of each topic of the loop, messages whose stamp had been there before.
        losses: of each topic of the loop with one publisher, messages that its sequence numbers
            miss between the first and the last one logged.
        setbacks: of each topic of the loop, how often a stamp was lower than the one before; a
            simulator that starts anew sets its clock back.
        metadata: the bag's records of keys and values, by name.
        actuated_mass: number of the mass that the first force names, None without.
        arrivals: of each topic of the loop with messages, by its name without the namespace.
    """

    path: Path
    namespace: str
    configuration_stamp: Int[np.ndarray, ' frames']
    configuration: Float[np.ndarray, 'frames n']
    velocity: Float[np.ndarray, 'frames n']
    latent_stamp: Int[np.ndarray, ' latents']
    latent: Float[np.ndarray, 'latents m']
    latent_velocity: Float[np.ndarray, 'latents m']
    force_stamp: Int[np.ndarray, ' forces']
    force: Float[np.ndarray, 'forces 2']
    external_force_stamp: Int[np.ndarray, ' pushes']
    external_force: Float[np.ndarray, 'pushes 2']
    targets: tuple[Target, ...]
    network_identifier: str
    autoencoder_identifier: str
    messages: dict[str, int] = field(default_factory=dict)
    repeats: dict[str, int] = field(default_factory=dict)
    losses: dict[str, int] = field(default_factory=dict)
    setbacks: dict[str, int] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    actuated_mass: int | None = None
    arrivals: dict[str, Arrivals] = field(default_factory=dict)


def read_run(path: str | Path, namespace: str | None = None, progress: bool = False) -> Run:
    """Read the log of a run.

    Args:
        path: folder of the bag, or an MCAP file.
        namespace: of the topics, `body_2` or `/body_2`; `/` is none. Left out, the only one in
            which a configuration occurs.
        progress: show a bar.

    Raises:
        BagError: the path is no bag, the file is damaged, there is no configuration message, no
            or more than one namespace fits, or a topic holds what a loop can't have published.
    """
    file = Path(path)
    contents = read_contents(file)
    namespace = choose_namespace(file, contents, namespace)
    signals = {f'{namespace}/{name}': _Signal(kind) for name, kind in _READERS.items()}
    targets: dict[str, list[Target]] = {
        f'{namespace}/{name}': [] for name in ('target_in_force', 'target')
    }
    check_types(file, contents, namespace)
    topics = [*signals, *targets]
    total = sum(contents.messages.get(topic, 0) for topic in topics)
    messages = read_messages(file, topics)
    for message in tqdm(
        messages, desc='reading', total=total, delay=2, disable=not progress, leave=False
    ):
        if message.topic in targets:
            targets[message.topic].append(read_target(message.content))
        else:
            signals[message.topic].add(message)
    body, latent, force, push = signals.values()
    for topic, signal in signals.items():
        signal.check(file, topic)
    announced, published = targets.values()
    present = {topic: signal for topic, signal in signals.items() if contents.messages.get(topic)}
    return Run(
        path=file,
        namespace=namespace,
        configuration_stamp=body.stamps(),
        configuration=body.column(0),
        velocity=body.column(1),
        latent_stamp=latent.stamps(),
        latent=latent.column(0),
        latent_velocity=latent.column(1),
        force_stamp=force.stamps(),
        force=force.column(0).reshape(-1, 2),
        external_force_stamp=push.stamps(),
        external_force=push.column(0).reshape(-1, 2),
        targets=tuple(sorted(announced or published, key=lambda target: target.stamp_ns)),
        network_identifier=body.frame_id,
        autoencoder_identifier=latent.frame_id,
        messages=contents.messages,
        repeats={topic: signal.repeats for topic, signal in present.items()},
        losses={topic: signal.lost for topic, signal in present.items() if signal is not push},
        setbacks={topic: signal.setbacks for topic, signal in present.items()},
        metadata=contents.metadata,
        actuated_mass=_mass(force.frame_id),
        arrivals={topic.rpartition('/')[2]: signal.arrivals() for topic, signal in present.items()},
    )


def _mass(frame_id: str) -> int | None:
    try:
        return read_force_frame(frame_id).mass
    except ValueError:
        return None


def _joint_state(content: Any) -> tuple[np.ndarray, ...]:
    return np.array(content.position, dtype=float), np.array(content.velocity, dtype=float)


def _planar_force(content: Any) -> tuple[np.ndarray, ...]:
    return (np.array([content.wrench.force.x, content.wrench.force.y]),)


_READERS: dict[str, Callable[[Any], tuple[np.ndarray, ...]]] = {
    'configuration': _joint_state,
    'latent_state': _joint_state,
    'control_force': _planar_force,
    'external_force': _planar_force,
}


class _Signal:
    """The messages of one topic as they come in, the first of each stamp kept."""

    def __init__(self, read: Callable[[Any], tuple[np.ndarray, ...]]) -> None:
        self._read = read
        self._rows: dict[int, tuple[np.ndarray, ...]] = {}
        self._arrivals: dict[int, tuple[int, int, int]] = {}
        self._frame_ids: dict[str, int] = {}
        self._last_stamp = 0
        self._sequence = Sequence()
        self.repeats = self.setbacks = 0

    def add(self, message: Message) -> None:
        stamp = stamp_of(message.content)
        self.setbacks += stamp < self._last_stamp
        self._last_stamp = stamp
        self._sequence.add(message.sequence, message.publish_time_ns)
        if stamp in self._rows:
            self.repeats += 1
            return
        self._rows[stamp] = self._read(message.content)
        sent, received = message.publish_time_ns, message.log_time_ns
        self._arrivals[stamp] = min(sent, _LATEST), min(received, _LATEST), self._sequence.lost
        self._frame_ids.setdefault(message.content.header.frame_id, stamp)

    @property
    def lost(self) -> int:
        return self._sequence.lost

    @property
    def frame_id(self) -> str:
        return next(iter(self._frame_ids), '')

    def check(self, file: Path, topic: str) -> None:
        sizes = {tuple(part.size for part in row) for row in self._rows.values()}
        if len(sizes) > 1 or any(len(set(size)) > 1 for size in sizes):
            raise BagError(
                f'{file}: expected positions and velocities of one size on {topic}, '
                f'got sizes {sorted(sizes)}'
            )
        if self._read is _joint_state and len(self._frame_ids) > 1:
            raise BagError(
                f'{file}: expected one frame_id on {topic}, got {sorted(self._frame_ids)}: '
                'record runs with other models into bags of their own'
            )

    def stamps(self) -> np.ndarray:
        return np.array(sorted(self._rows), dtype=np.int64)

    def arrivals(self) -> Arrivals:
        rows = [self._arrivals[stamp] for stamp in sorted(self._arrivals)]
        return Arrivals(*np.array(rows, dtype=np.int64).T)

    def column(self, part: int) -> np.ndarray:
        if not self._rows:
            return np.zeros((0, 0))
        return np.array([self._rows[stamp][part] for stamp in sorted(self._rows)])


def read_target(content: Any) -> Target:
    """Return the target of a decoded message."""
    position = np.array(content.position, dtype=float)
    is_latent = bool(content.name) and content.name[0].startswith(LATENT_PREFIX)
    return Target(
        stamp_ns=stamp_of(content),
        configuration=None if is_latent else position,
        latent=position if is_latent else None,
        frame_id=content.header.frame_id,
    )


def stamp_of(content: Any) -> int:
    """Return the stamp of a decoded message [ns]."""
    return content.header.stamp.sec * NANOSECONDS + content.header.stamp.nanosec


def choose_namespace(file: Path, contents: Contents, wanted: str | None) -> str:
    """Return the namespace of a log's topics: the wanted one, or the only one there is.

    Raises:
        BagError: none or more than one fits.
    """
    found = sorted(
        topic.removesuffix('/configuration')
        for topic, count in contents.messages.items()
        if count and topic.endswith('/configuration') and contents.types[topic] == _JOINT_STATE
    )
    if not found:
        raise BagError(
            f'{file}: expected messages on a topic `configuration` of type {_JOINT_STATE}, got '
            f'{contents.messages or "no topic"}: record while the simulator runs'
        )
    shown = [namespace or '/' for namespace in found]
    if wanted is None:
        if len(found) > 1:
            raise BagError(
                f'{file}: expected the configurations of one body, got those of the namespaces '
                f'{shown}: name one'
            )
        return found[0]
    stripped = wanted.strip('/')
    namespace = f'/{stripped}' if stripped else ''
    if namespace not in found:
        raise BagError(f'{file}: no configuration in the namespace {wanted!r}: the bag has {shown}')
    return namespace


def check_types(file: Path, contents: Contents, namespace: str) -> None:
    """Make sure that the topics of a loop have the types of a loop.

    Raises:
        BagError: one has another.
    """
    for name, expected in _TYPES.items():
        topic = f'{namespace}/{name}'
        if contents.messages.get(topic) and contents.types[topic] != expected:
            raise BagError(
                f'{file}: expected {expected} on {topic}, got {contents.types[topic] or "no type"}'
            )
