"""Messages of the loop as CDR bytes, made by rosbags, and logs of runs made of them."""

import json
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.typesys import Stores, get_typestore

from dpc_ros.autoencoder import Autoencoder
from dpc_ros.bag import BagWriter, QosProfile, Topic

JOINT_STATE = 'sensor_msgs/msg/JointState'
WRENCH = 'geometry_msgs/msg/WrenchStamped'
STEP = 5_000_000  # ns
NOTHING = np.zeros(0)
RELIABLE = (QosProfile(depth=200),)


class Messages:
    """Serialised messages and topics."""

    def __init__(self):
        self.store = get_typestore(Stores.ROS2_JAZZY)

    def topic(self, name, type_name, profiles=RELIABLE):
        return Topic(
            name=name,
            type_name=type_name,
            definition=self.store.generate_msgdef(type_name, ros_version=2)[0],
            offered_qos_profiles=profiles,
            type_hash=self.store.hash_rihs01(type_name),
        )

    def joint_state(self, stamp, position, velocity=NOTHING, frame_id='', names=()):
        message = self.store.types[JOINT_STATE](
            header=self._header(stamp, frame_id),
            name=list(names),
            position=np.asarray(position, dtype=float),
            velocity=np.asarray(velocity, dtype=float),
            effort=NOTHING,
        )
        return bytes(self.store.serialize_cdr(message, JOINT_STATE))

    def wrench(self, stamp, force, frame_id='mass_0'):
        types = self.store.types
        zero = types['geometry_msgs/msg/Vector3'](x=0.0, y=0.0, z=0.0)
        vector = types['geometry_msgs/msg/Vector3'](x=float(force[0]), y=float(force[1]), z=0.0)
        wrench = types['geometry_msgs/msg/Wrench'](force=vector, torque=zero)
        message = types[WRENCH](header=self._header(stamp, frame_id), wrench=wrench)
        return bytes(self.store.serialize_cdr(message, WRENCH))

    def _header(self, stamp, frame_id):
        seconds, rest = divmod(int(stamp), 10**9)
        time = self.store.types['builtin_interfaces/msg/Time'](sec=seconds, nanosec=rest)
        return self.store.types['std_msgs/msg/Header'](stamp=time, frame_id=frame_id)


@dataclass
class Log:
    """A run to be written: rows of (stamp [ns], arrays …) for each topic."""

    configuration: list
    latent: list = field(default_factory=list)
    force: list = field(default_factory=list)
    external_force: list = field(default_factory=list)
    targets: list = field(default_factory=list)  # (stamp, values, is_latent)
    metadata: dict = field(default_factory=dict)
    namespace: str = ''
    network: str = 'net@0123456789ab'
    checkpoint: str = 'flat@ba9876543210'
    force_frames: tuple = ('mass_0',)  # one after the other, and again from the first
    sequences: dict = field(default_factory=dict)  # topic name: list of numbers

    def write_to(self, bag, messages):
        for topic in self.topics(messages):
            bag.add_topic(topic)
        for name, content in self.metadata.items():
            bag.add_metadata(name, content)
        for row in self.rows(messages):
            bag.write(*row)

    def topics(self, messages):
        return [
            messages.topic(f'{self.namespace}/{name}', type_name)
            for name, type_name, _ in self._topics(messages)
        ]

    def rows(self, messages):
        """Return topic, CDR, log time, publish time and number of each message."""
        rows = []
        for name, _, cdrs in self._topics(messages):
            numbers = self.sequences.get(name, range(1, len(cdrs) + 1))
            pairs = zip(cdrs, numbers, strict=True)
            rows += [(k, f'{self.namespace}/{name}', cdr, n) for k, (cdr, n) in enumerate(pairs)]
        return [
            (topic, cdr, 10**18 + 1000 * k, 10**18 + 999 * k, number)
            for k, topic, cdr, number in sorted(rows, key=lambda row: row[:2])
        ]

    def _topics(self, messages):
        state, wrench = messages.joint_state, messages.wrench
        yield (
            'configuration',
            JOINT_STATE,
            [state(t, q, v, self.network) for t, q, v in self.configuration],
        )
        yield (
            'latent_state',
            JOINT_STATE,
            [state(t, x, v, self.checkpoint, _xi(x)) for t, x, v in self.latent],
        )
        frames = cycle(self.force_frames)
        forces = [wrench(t, u, frame) for (t, u), frame in zip(self.force, frames, strict=False)]
        yield 'control_force', WRENCH, forces
        yield 'external_force', WRENCH, [wrench(t, u) for t, u in self.external_force]
        yield (
            'target',
            JOINT_STATE,
            [state(t, x, names=_xi(x) if latent else ()) for t, x, latent in self.targets],
        )


def _xi(values):
    return [f'xi_{i}' for i in range(len(values))]


class LinearAutoencoder(Autoencoder):
    """ξ = A⁺q and q = Aξ, for a matrix A with independent columns."""

    def __init__(self, matrix):
        self.matrix = np.asarray(matrix, dtype=float)
        self.inverse = np.linalg.pinv(self.matrix)

    @property
    def configuration_size(self):
        return self.matrix.shape[0]

    @property
    def latent_size(self):
        return self.matrix.shape[1]

    def encode(self, configuration):
        return configuration @ self.inverse.T

    def decode(self, latent):
        return latent @ self.matrix.T

    def encoder_jacobian_vector_product(self, configuration, velocity, guess=None):
        return self.encode(configuration), self.encode(velocity)

    def decode_with_jacobian(self, latent):
        return self.decode(latent), np.broadcast_to(
            self.matrix, (*latent.shape[:-1], *self.matrix.shape)
        )

    def decode_with_derivatives(self, latent, latent_velocity):
        decoded, jacobian = self.decode_with_jacobian(latent)
        return decoded, jacobian, np.zeros_like(decoded)

    def decoder_curvature(self, latent, weight):
        return np.zeros((self.latent_size, self.latent_size))


@pytest.fixture(scope='session')
def messages():
    return Messages()


@pytest.fixture(scope='session')
def log_type():
    return Log


@pytest.fixture(scope='session')
def linear_autoencoder():
    return LinearAutoencoder


@pytest.fixture(scope='session')
def record(messages, tmp_path_factory):
    """Write logs into one bag and return its folder."""

    def write(*logs):
        folder = tmp_path_factory.mktemp('runs') / 'bag'
        with BagWriter(folder) as bag:
            for log in logs:
                log.write_to(bag, messages)
        return folder

    return write


@pytest.fixture(scope='session')
def split_bag(messages, tmp_path_factory):
    """Write a log into a bag of several files, as a recorder that splits leaves it."""

    def write(log, parts, log_times=None):
        folder = tmp_path_factory.mktemp('runs') / 'bag'
        folder.mkdir()
        rows = log.rows(messages)
        if log_times is not None:
            rows = [(*row[:2], t, t, row[4]) for row, t in zip(rows, log_times, strict=True)]
        contents = []
        for k, part in enumerate(np.array_split(np.arange(len(rows)), parts)):
            with BagWriter(tmp_path_factory.mktemp('part') / 'bag') as bag:
                for topic in log.topics(messages):
                    bag.add_topic(topic)
                for name, content in log.metadata.items():
                    bag.add_metadata(name, content)
                for place in part:
                    bag.write(*rows[place])
            (bag.folder / 'bag_0.mcap').rename(folder / f'bag_{k}.mcap')
            text = (bag.folder / 'metadata.yaml').read_text().replace('bag_0.mcap', f'bag_{k}.mcap')
            contents.append(yaml.safe_load(text)['rosbag2_bagfile_information'])
        together = contents[0]
        for key in ('relative_file_paths', 'files'):
            together[key] = [item for content in contents for item in content[key]]
        together['message_count'] = len(rows)
        text = yaml.safe_dump({'rosbag2_bagfile_information': together})
        (folder / 'metadata.yaml').write_text(text)
        return folder

    return write


@pytest.fixture(scope='session')
def small_log(log_type):
    stamps = [7 + STEP * k for k in range(20)]
    return log_type(
        configuration=[(t, [k, -k, 0.5, 1e-300], [k / 7, 0, 0, 1]) for k, t in enumerate(stamps)],
        latent=[(t, [k / 3, 1.0], [0.1, k]) for k, t in enumerate(stamps)],
        force=[(t, (k, 2.0 * k)) for k, t in enumerate(stamps[:-1])],
        external_force=[(stamps[3], (0.5, 0.25))],
        targets=[(0, [1.0, 2.0, 3.0, 4.0], False)],
        metadata={'run': {'seed': '7', 'law': 'energy shaping'}, 'launch': {'rate': '200'}},
    )


@pytest.fixture(scope='session')
def square_network(tmp_path_factory):
    """Four masses on a square, the lower two fixed: n = 4."""
    from dpc_ros.network import load_network

    path = Path(tmp_path_factory.mktemp('networks')) / 'square.json'
    content = {
        'name': 'square',
        'mass': 0.5,
        'fixed': [0, 1],
        'rest_position': [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]],
        'springs': [[0, 2], [1, 3], [2, 3], [0, 3]],
        'stiffness': [50.0, 50.0, 50.0, 100.0],
        'rest_length': [1.0, 1.0, 1.0, 2.0**0.5],
        'damping': [0.1, 0.1, 0.1, 0.1],
    }
    path.write_text(json.dumps(content))
    return load_network(path)
