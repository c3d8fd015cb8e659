"""The player publishes a log's bytes again: all of them, in order, when and where it is told."""

import time

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from state_messages import state_message
from std_srvs.srv import SetBool, Trigger

from dpc_ros.control import Target
from dpc_ros.nodes.messages import (
    force_message,
    from_stamp,
    to_stamp,
)
from dpc_ros.nodes.target_messages import target_message
from dpc_ros.nodes.topics import LOOP_QOS, TARGET_QOS

START = 10**18  # ns, log time
STEP = 5_000_000  # ns
COUNT = 40
FOREVER = QosTime(2**31 - 1, 0)
LOGGED = {
    '/configuration': (JointState, QosDurability.VOLATILE),
    '/control_force': (WrenchStamped, QosDurability.VOLATILE),
    '/target': (JointState, QosDurability.TRANSIENT_LOCAL),
}


def offered(durability):
    return Qos(
        QosHistory.UNKNOWN,
        0,
        QosReliability.RELIABLE,
        durability,
        FOREVER,
        FOREVER,
        QosLiveliness.AUTOMATIC,
        FOREVER,
        False,
    )


def full_name(message_type):
    package, folder, _ = message_type.__module__.split('.')
    return f'{package}/{folder}/{message_type.__name__}'


@pytest.fixture(scope='module')
def log(tmp_path_factory):
    """A bag that an independent writer of rosbag2's format made, and its bytes by topic."""
    folder = tmp_path_factory.mktemp('logs') / 'log'
    draw = np.random.default_rng(0)
    store = get_typestore(Stores.ROS2_JAZZY)
    target = Target(configuration=draw.normal(size=4))
    rows = [('/target', START, target_message(target, 'net@1'))]
    for k in range(COUNT):
        stamp = to_stamp(k * STEP)
        time = START + k // 2 * 2 * STEP  # two of each time
        state = state_message(stamp, 'net@1', draw.normal(size=4), draw.normal(size=4))
        rows.append(('/configuration', time, state))
        rows.append(('/control_force', time, force_message(stamp, 3, draw.normal(size=2))))
    expected = {topic: [] for topic in LOGGED}
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(
                topic,
                full_name(kind),
                typestore=store,
                offered_qos_profiles=[offered(durability)],
            )
            for topic, (kind, durability) in LOGGED.items()
        }
        for topic, time, message in rows:
            expected[topic].append(serialize_message(message))
            writer.write(connections[topic], time, expected[topic][-1])
    return folder, expected


def listen(observer, topics):
    """Return what comes on topics, as bytes, from now on."""
    heard = {topic: [] for topic in topics}
    for topic, messages in heard.items():
        kind, durability = LOGGED.get(topic, LOGGED['/configuration'])
        quality = LOOP_QOS if durability == QosDurability.VOLATILE else TARGET_QOS
        observer.node.create_subscription(kind, topic, messages.append, quality, raw=True)
    return heard


def play(domain, log, topics, *parameters, remappings=()):
    names = ', '.join(f'observer@{topic}' for topic in topics)
    given = (f'bag:={log}', f'expected_subscribers:=[{names}]', *parameters)
    arguments = [part for item in given for part in ('-p', item)]
    arguments += [part for item in remappings for part in ('-r', item)]
    return domain.start('player_node', '--ros-args', *arguments)


@pytest.mark.parametrize('rate', [0.0, 4.0])
def test_every_message_comes_again_byte_by_byte(domain, observer, log, rate):
    folder, expected = log
    heard = listen(observer, LOGGED)
    clock = []
    observer.node.create_subscription(Clock, '/clock', clock.append, QoSProfile(depth=1))
    process = play(domain, folder, LOGGED, f'rate:={rate}', 'publish_clock:=true')
    observer.wait(lambda: process.poll() is not None, 'the end of the log')
    assert process.returncode == 0, process.stdout.read()
    observer.wait(
        lambda: [len(each) for each in heard.values()] == [len(each) for each in expected.values()],
        'what was acknowledged',
    )
    assert heard == expected
    # A clock is kept by its newest tick alone: some may be passed over.
    ticks = [from_stamp(tick.clock) for tick in clock]
    assert set(ticks) <= {k * STEP for k in range(COUNT)}
    assert ticks == sorted(ticks)


def test_a_paused_player_steps_from_a_start_time_on_a_remapped_topic(domain, observer, log):
    folder, expected = log
    heard = listen(observer, ['/other', '/configuration', '/control_force', '/target'])
    process = play(
        domain,
        folder,
        ['configuration', 'target'],  # which is then /other
        'topics:=[configuration, target]',
        'start_paused:=true',
        'start_time:=0.1',
        'duration:=0.05',
        'rate:=0.0',
        remappings=['configuration:=other'],
    )
    node = observer.node
    step = node.create_client(Trigger, '/player/step')
    pause = node.create_client(SetBool, '/player/pause')
    observer.wait(lambda: step.service_is_ready() and pause.service_is_ready(), 'its services')

    def call(client, request):
        future = client.call_async(request)
        observer.wait(future.done, 'an answer')
        return future.result()

    def stepped():
        return call(step, Trigger.Request()).success

    observer.wait(stepped, 'a first step')  # refused until the observer is matched
    assert stepped()
    states = [k for k in range(COUNT) if 100 <= k // 2 * 2 * 5 < 150]
    following = [expected['/configuration'][k] for k in states]
    # First the target, though it came before the start: who is late hears it, too.
    observer.wait(lambda: len(heard['/target']) + len(heard['/other']) == 2, 'two messages')
    assert heard['/target'] == expected['/target']
    assert heard['/other'] == following[:1]
    assert call(pause, SetBool.Request(data=False)).success
    observer.wait(lambda: process.poll() is not None, 'the end of the log')
    assert process.returncode == 0, process.stdout.read()
    observer.wait(lambda: len(heard['/other']) == len(following), 'what was acknowledged')
    assert heard['/other'] == following
    assert not heard['/configuration']
    assert not heard['/control_force']


def test_a_player_that_was_inactive_goes_on_where_it_was_without_a_burst(domain, observer, log):
    folder, expected = log
    rate = 0.1
    heard = listen(observer, ['/configuration'])['/configuration']
    process = play(domain, folder, ['configuration'], 'topics:=[configuration]', f'rate:={rate}')
    client = observer.node.create_client(ChangeState, '/player/change_state')
    observer.wait(lambda: heard, 'a first message')

    def change(transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        future = client.call_async(request)
        observer.wait(future.done, 'an answer')
        assert future.result().success

    change(Transition.TRANSITION_DEACTIVATE)
    inactive_since = time.monotonic()
    observer.wait(lambda: time.monotonic() - inactive_since > 1.0, 'a while to pass')
    count = len(heard)
    activated_at = time.monotonic()
    change(Transition.TRANSITION_ACTIVATE)
    observer.wait(lambda: len(heard) == COUNT, 'the last message')
    recorded = (COUNT // 2 - 1 - count // 2) * 2 * STEP / 1e9  # from the next message to the last
    assert time.monotonic() - activated_at >= recorded / rate
    code, output = domain.stop(process)
    assert code == 0, output
    assert heard == expected['/configuration']


@pytest.mark.parametrize(
    ('parameters', 'words'),
    [
        (('topics:=[colour]',), ('/colour', '/configuration')),
        (('time_mode:=lockstep', 'topics:=[configuration, control_force]'), ('control_force',)),
    ],
)
def test_what_can_not_be_replayed_is_said(domain, log, parameters, words):
    folder, _ = log
    given = [part for item in (f'bag:={folder}', *parameters) for part in ('-p', item)]
    code, output = domain.run('player_node', '--ros-args', *given)
    assert code == 1, output
    (error,) = (line for line in output.splitlines() if line.startswith('error:'))
    for word in words:
        assert word in error
