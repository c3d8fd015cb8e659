"""What the recorder takes, says and keeps, whatever happens to it."""

import os
import shutil
import signal
import subprocess
from array import array

import numpy as np
import psutil
import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from mcap.reader import make_reader
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA, Empty, Int64MultiArray, String

from dpc_ros import __version__
from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.bag import (
    COMMAND_RECORD,
    LOSSES_RECORD,
    MODELS_RECORD,
    NODE_PARAMETERS_RECORD,
    VERSIONS_RECORD,
    read_topics,
)
from dpc_ros.bag.mcap_file import read_contents, read_messages
from dpc_ros.network import load_network
from dpc_ros.nodes.discovery import prompt_dds
from dpc_ros.nodes.executor import KeptWaitSetExecutor
from dpc_ros.nodes.node_parameters import NodeParameters
from dpc_ros.nodes.player_node import offered_quality
from dpc_ros.nodes.recorder_node import RecorderNode
from dpc_ros.nodes.topics import LOOP_QOS, TARGET_QOS
from dpc_ros.resources import config_path

LOOP = ('simulator', 'encoder', 'controller')
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
CLOCK_AN_HOUR_BEHIND = r"""
#define _GNU_SOURCE
#include <time.h>
#include <sys/syscall.h>
#include <unistd.h>
int clock_gettime(clockid_t clock, struct timespec *time) {
    int result = syscall(SYS_clock_gettime, clock, time);
    if (clock == CLOCK_REALTIME) time->tv_sec -= 3600;
    return result;
}
"""
ENDLESS_PUBLISHER = """
import time, rclpy
from dpc_ros.nodes.discovery import prompt_dds
from std_msgs.msg import String
with prompt_dds():
    rclpy.init()
publisher = rclpy.create_node('talker').create_publisher(String, '/lab/chat', 10)
while True:
    publisher.publish(String(data='on and on'))
    time.sleep(0.01)
"""

WORKER = """
import sys, rclpy
from dpc_ros.nodes.discovery import prompt_dds
with prompt_dds():
    rclpy.init()
node = rclpy.create_node('worker', namespace='/lab')
node.declare_parameter('number', int(sys.argv[1]))
rclpy.spin(node)
"""


class Recording:
    """A recorder in a process, and what the test publishes to it."""

    def __init__(self, domain, observer, complete_messages, folder, *parameters):
        self.domain, self.observer, self.folder = domain, observer, folder
        self._complete_messages = complete_messages
        given = [part for item in (f'bag:={folder}', *parameters) for part in ('-p', item)]
        self.process = domain.start('recorder_node', '--ros-args', *given)
        observer.wait_for_node('recorder')

    @property
    def file(self):
        return self.folder / f'{self.folder.name}_0.mcap'

    @property
    def numbers(self):
        """Of the messages that are in complete chunks now."""
        if not self.file.is_file():
            return []
        return [message.sequence for message in self._complete_messages(self.file)]

    def publisher(self, message_type, topic, qos, node=None):
        """Return a publisher that the recorder is matched with."""
        publisher = (node or self.observer.node).create_publisher(message_type, topic, qos)
        self.observer.wait(publisher.get_subscription_count, f'the recorder on {topic}')
        return publisher

    def wait_for(self, count):
        """Wait until a number of messages is on the disk."""
        self.observer.wait(
            lambda: len(self.numbers) >= count, f'{count} messages in complete chunks'
        )

    def stop(self):
        code, output = self.domain.stop(self.process)
        assert code == 0, output
        return read_contents(self.file)


@pytest.fixture
def recording(domain, observer, tmp_path, complete_messages):
    def start(*parameters, folder=tmp_path / 'bag'):
        return Recording(domain, observer, complete_messages, folder, *parameters)

    return start


def force(number):
    message = WrenchStamped()
    message.header.stamp.sec = number
    message.wrench.force.x = number / 7
    return message


def test_topics_by_pattern_of_any_type_and_quality_from_whenever_they_come(recording, observer):
    made = recording("topics:=['/lab/*', named, only_listened_to]", "exclude:=['*/noise']")
    messages = [
        ('/lab/color', BEST_EFFORT, ColorRGBA(r=0.1, a=1.0)),
        ('/lab/deep/latched', LATCHED, String(data='ξ')),
        ('/lab/nothing', LOOP_QOS, Empty()),
        ('/named', LOOP_QOS, Int64MultiArray(data=[2**62, -1])),
    ]
    observer.node.create_publisher(String, '/lab/noise', LATCHED).publish(String())
    observer.node.create_publisher(String, '/lab/_hidden', LATCHED).publish(String())
    observer.node.create_subscription(ColorRGBA, '/only_listened_to', print, 10)
    for topic, qos, message in messages:
        made.publisher(type(message), topic, qos).publish(message)
    # Nobody has published there yet: the recorder listens already.
    made.publisher(ColorRGBA, '/only_listened_to', LOOP_QOS).publish(ColorRGBA(b=0.5))
    made.wait_for(len(messages) + 1)
    contents = made.stop()
    assert contents.messages == {
        '/lab/color': 1,
        '/lab/deep/latched': 1,
        '/lab/nothing': 1,
        '/named': 1,
        '/only_listened_to': 1,
    }
    decoded = {each.topic: each.content for each in read_messages(made.file, contents.types)}
    assert decoded['/lab/deep/latched'].data == 'ξ'
    assert list(decoded['/named'].data) == [2**62, -1]
    assert decoded['/lab/color'].a == 1.0


def test_what_was_latched_before_is_recorded(recording, observer):
    for topic, message in (('target', JointState(position=[1.0])), ('/lab/map', String(data='a'))):
        observer.node.create_publisher(type(message), topic, TARGET_QOS).publish(message)
    made = recording("topics:=[target, '/lab/*']")
    made.wait_for(2)
    assert made.stop().messages == {'/target': 1, '/lab/map': 1}


@pytest.mark.parametrize('offered', [BEST_EFFORT, LATCHED], ids=['best_effort', 'latched'])
def test_the_first_publisher_may_come_after_the_subscription(recording, observer, offered):
    observer.node.create_subscription(String, '/lab/late', print, offered)
    made = recording("topics:=['/lab/*']")

    def listeners():
        return observer.node.get_subscriptions_info_by_topic('/lab/late')

    observer.wait(lambda: len(listeners()) == 2, 'the recorder to listen')
    publisher = observer.node.create_publisher(String, '/lab/late', offered)

    def is_heard():
        return (
            all(
                each.qos_profile.reliability == offered.reliability
                and each.qos_profile.durability == offered.durability
                for each in listeners()
            )
            and publisher.get_subscription_count() == 2
        )

    observer.wait(is_heard, 'the recorder to ask for what is offered')
    publisher.publish(String(data='a'))
    made.wait_for(1)
    assert made.stop().messages == {'/lab/late': 1}


def test_what_is_latched_is_recorded_once_though_a_later_message_came_first(recording, observer):
    observer.node.create_subscription(String, '/lab/late', print, LATCHED)
    made = recording("topics:=['/lab/*']", 'discovery_interval:=1.0')
    count = observer.node.count_subscribers
    observer.wait(lambda: count('/lab/late') == 2, 'the recorder to listen')
    publisher = observer.node.create_publisher(String, '/lab/late', LATCHED)
    publisher.publish(String(data='kept'))
    observer.wait(lambda: publisher.get_subscription_count() == 2, 'the recorder to be matched')
    publisher.publish(String(data='heard'))
    made.wait_for(2)
    made.stop()
    found = {message.content.data for message in read_messages(made.file, ['/lab/late'])}
    assert found == {'kept', 'heard'}
    assert sorted(made.numbers) == [1, 2]


def test_what_is_latched_is_recorded_where_a_recorder_is_activated_later(recording, observer):
    observer.node.create_publisher(JointState, 'target', TARGET_QOS).publish(JointState())
    made = recording('topics:=[target]', 'autostart:=false')
    client = observer.node.create_client(ChangeState, 'recorder/change_state')
    observer.wait(client.service_is_ready, 'its services')
    for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
        request = ChangeState.Request(transition=Transition(id=transition))
        answer = client.call_async(request)
        observer.wait(answer.done, 'an answer')
        assert answer.result().success
    made.wait_for(1)
    assert made.stop().messages == {'/target': 1}


def test_the_log_keeps_the_times_that_a_publisher_offers_and_the_player_offers_them_again(
    recording,
):
    offered = QoSProfile(
        depth=10,
        deadline=Duration(seconds=1),
        lifespan=Duration(seconds=5),
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(seconds=7),
    )
    made = recording("topics:=['/lab/*']")
    for topic, qos in (('/lab/strict', offered), ('/lab/lax', LOOP_QOS)):
        made.publisher(String, topic, qos).publish(String())
    made.wait_for(2)
    made.stop()
    with AnyReader([made.folder]) as reader:
        logged = {each.topic: each.ext.offered_qos_profiles[0] for each in reader.connections}
    times = ('deadline', 'lifespan', 'liveliness_lease_duration')
    for topic, seconds in (('/lab/strict', [1, 5, 7]), ('/lab/lax', [9223372036] * 3)):
        assert [getattr(logged[topic], name).sec for name in times] == seconds
    again = {
        name: offered_quality(topic.offered_qos_profiles)
        for name, topic in read_topics(made.folder).items()
    }
    for name in (*times, 'liveliness'):
        assert getattr(again['/lab/strict'], name) == getattr(offered, name)
        assert getattr(again['/lab/lax'], name) == getattr(QoSProfile(depth=1), name)


def test_a_node_that_was_killed_and_started_anew_is_asked_anew(domain, observer):
    answers = []
    questions = NodeParameters(observer.node, lambda *answer: answers.append(answer))

    def has_answered(number):
        questions.look()
        given = [values['number'] for name, values in answers if name == '/lab/worker']
        return given and given[-1] == number

    worker = domain.start_script(WORKER, '1')
    observer.wait(lambda: has_answered(1), 'the first answer')
    domain.kill(worker)
    worker = domain.start_script(WORKER, '2')
    observer.wait(lambda: has_answered(2), 'the answer of the second')
    given = [values['number'] for name, values in answers if name == '/lab/worker']
    assert given == [1, 2]
    assert '/observer' in dict(answers)
    questions.close()
    domain.kill(worker)  # rclpy's own spin does not always end by a signal


def test_a_split_log_is_still_one_log(recording):
    made = recording("topics:=['/body_2/*']", 'split_size:=20000')
    publisher = made.publisher(JointState, '/body_2/configuration', LOOP_QOS)
    rng = np.random.default_rng(0)
    for _ in range(30):
        publisher.publish(JointState(position=array('d', rng.normal(size=400).tobytes())))
    code, output = made.domain.stop(made.process)
    assert code == 0, output
    with AnyReader([made.folder]) as reader:
        assert reader.message_count == 30
        assert [connection.topic for connection in reader.connections] == ['/body_2/configuration']
    for file in made.folder.glob('*.mcap'):
        metadata = read_contents(file).metadata
        assert metadata[VERSIONS_RECORD]['dpc_ros'] == __version__
        assert metadata[LOSSES_RECORD] == {'/body_2/configuration': '0'}


def test_the_log_says_what_was_running(domain, observer, tmp_path):
    observer.node.declare_parameter('lengths', [0.25, 1e-300])
    command = ('--output', str(tmp_path / 'run'), '--realtime', '--duration', '1')
    chosen = ('recorder.attach=[network, checkpoint]', 'controller.solve_in_background=false')
    launcher = domain.start('launcher', *command, *(f'--set={each}' for each in chosen))
    observer.wait(lambda: launcher.poll() is not None, 'the end of the run')
    assert launcher.returncode == 0, launcher.stdout.read()
    bag = tmp_path / 'run' / 'bag'
    metadata = read_contents(bag).metadata
    nodes = {
        name: yaml.safe_load(text)[name]['ros__parameters']
        for name, text in metadata[NODE_PARAMETERS_RECORD].items()
    }
    assert {'/simulator', '/encoder', '/controller', '/recorder', '/observer'} <= nodes.keys()
    assert nodes['/observer']['lengths'] == [0.25, 1e-300]
    assert nodes['/simulator']['duration'] == 1.0
    assert nodes['/recorder']['attach'] == ['network', 'checkpoint']
    network, checkpoint = load_network('paper_2'), load_checkpoint('paper_2_extended_m5')
    assert metadata[MODELS_RECORD] == {
        '/configuration': network.identifier,
        '/latent_state': checkpoint.identifier,
    }
    assert metadata[VERSIONS_RECORD]['dpc_ros'] == __version__
    assert metadata[VERSIONS_RECORD]['numpy'] == np.__version__
    (content,) = yaml.safe_load((bag / 'metadata.yaml').read_text()).values()
    assert content['ros_distro'] == metadata[VERSIONS_RECORD]['ros_distribution']
    assert 'launcher' in metadata[COMMAND_RECORD]['launcher']
    assert ' '.join(command) in metadata[COMMAND_RECORD]['launcher']
    assert '--params-file' in metadata[COMMAND_RECORD]['process']
    with (bag / 'bag_0.mcap').open('rb') as stream:
        attached = {each.name: each.data for each in make_reader(stream).iter_attachments()}
    assert attached == {
        f'{kind}/{name}': config_path(folder, name).read_bytes()
        for kind, folder, name in (
            ('network', 'systems', 'paper_2.json'),
            ('checkpoint', 'checkpoints', 'paper_2_extended_m5.json'),
            ('checkpoint', 'checkpoints', 'paper_2_extended_m5.safetensors'),
        )
    }


def test_five_seconds_at_a_kilohertz_are_recorded_with_nothing_lost(
    domain, observer, plan, assert_nothing_lost
):
    made = plan(simulator={'time_mode': 'realtime', 'rate': 1000.0, 'duration': 5.0})
    nodes = {kind: domain.start_node(kind, made) for kind in ('recorder', *LOOP)}
    observer.wait(lambda: nodes['simulator'].poll() is not None, 'the end of the run')
    for kind in ('simulator', 'encoder', 'controller', 'recorder'):
        code, output = domain.stop(nodes[kind])
        assert code == 0, output
    run = assert_nothing_lost(made.bag)
    np.testing.assert_array_equal(run.configuration_stamp, np.arange(5001) * 1_000_000)
    # The encoder may have left out what it had no time for, but not the last state.
    assert {*run.latent_stamp} <= {*run.configuration_stamp}
    assert run.latent_stamp[-1] == run.force_stamp[-1] == run.configuration_stamp[-1]
    shutil.rmtree(made.bag)  # no reader would find in 15000 messages what it doesn't in 3000


def test_losses_are_counted_by_topic(recording, observer):
    said = []
    observer.node.create_subscription(DiagnosticArray, '/diagnostics', said.append, 10)
    made = recording()
    # Keeps one message only: what a sleeping recorder has not taken is gone.
    careless = made.publisher(WrenchStamped, 'external_force', QoSProfile(depth=1))
    careful = made.publisher(WrenchStamped, 'control_force', LOOP_QOS)
    careless.publish(force(1))
    careful.publish(force(1))
    made.wait_for(2)
    made.process.send_signal(signal.SIGSTOP)
    published = 3000
    for number in range(2, published + 1):
        careless.publish(force(number))
    made.process.send_signal(signal.SIGCONT)
    # The last one is not lost, and the gaps before it are known when it has come.
    observer.wait(lambda: max(made.numbers) == published, 'the last message')

    def is_reported():
        reports = [array.status[0] for array in said if array.status[0].name == 'recorder']
        counts = [{value.key: value.value for value in each.values} for each in reports]
        return (
            counts
            and counts[-1].get('lost: /external_force', '0') != '0'
            and (reports[-1].level == DiagnosticStatus.WARN)
        )

    observer.wait(is_reported, 'the report of the losses')
    contents = made.stop()
    lost = published - contents.messages['/external_force']
    assert lost > 0
    losses = contents.metadata[LOSSES_RECORD]
    assert losses == {'/external_force': str(lost), '/control_force': '0'}


def test_an_idle_recorder_holds_nothing_back_and_a_killed_one_loses_nothing(recording, domain):
    made = recording()
    publisher = made.publisher(WrenchStamped, 'control_force', LOOP_QOS)
    for number in range(1, 11):
        publisher.publish(force(number))
    made.wait_for(10)  # and nothing comes that would fill the chunk
    domain.kill(made.process)
    assert made.numbers == list(range(1, 11))


def test_what_is_recorded_is_synced_within_the_interval(
    domain, observer, tmp_path, monkeypatch, complete_messages
):
    """In one process, so that the system calls can be seen."""
    folder = tmp_path / 'bag'
    file = folder / 'bag_0.mcap'
    synced = []

    def fsync(descriptor):
        os_fsync(descriptor)
        synced.append((os.readlink(f'/proc/self/fd/{descriptor}'), os.fstat(descriptor).st_size))

    os_fsync = os.fsync
    monkeypatch.setattr(os, 'fsync', fsync)
    context = Context()
    with prompt_dds():
        rclpy.init(
            context=context, domain_id=domain.number, args=['--ros-args', '-p', f'bag:={folder}']
        )
    node = RecorderNode(context)
    executor = KeptWaitSetExecutor(context=context)
    executor.add_node(node)
    try:
        assert node.start()
        periods = [timer.timer_period_ns for timer in node.timers]
        assert min(periods) <= node.settings['sync_interval'] * 1e9 == 0.2e9
        publisher = observer.node.create_publisher(WrenchStamped, 'control_force', LOOP_QOS)
        observer.wait(publisher.get_subscription_count, 'the recorder')
        for number in range(1, 6):
            publisher.publish(force(number))

            def is_synced(number=number):
                executor.spin_once(timeout_sec=0.01)
                return len(complete_messages(file)) == number

            observer.wait(is_synced, f'message {number} in a complete chunk')
            assert synced[-1] == (str(file), file.stat().st_size)
        count = len(synced)
    finally:
        executor.shutdown()
        node.close()
        context.try_shutdown()
    assert len(synced) > count, 'the end is synced, too'


def test_a_publisher_whose_clock_is_behind_does_not_hold_up_the_end(recording, domain, tmp_path):
    compiler = shutil.which('cc')
    if compiler is None:
        pytest.skip('no C compiler to build another clock with')
    clock = tmp_path / 'clock.so'
    command = [compiler, '-shared', '-fPIC', '-x', 'c', '-', '-o', str(clock)]
    subprocess.run(command, input=CLOCK_AN_HOUR_BEHIND, text=True, check=True)
    domain.start_script(ENDLESS_PUBLISHER, LD_PRELOAD=str(clock))
    made = recording("topics:=['/lab/*']")
    made.wait_for(10)
    made.stop()
    half_an_hour = 1800 * 10**9
    for message in read_messages(made.file, ['/lab/chat']):
        assert message.log_time_ns - message.publish_time_ns > half_an_hour


def flood(made):
    """Publish noise until the recorder gives up; return its exit code and errors."""
    publisher = made.publisher(JointState, 'configuration', LOOP_QOS)
    rng = np.random.default_rng(0)

    def has_ended():
        for _ in range(10):
            noise = array('d', rng.normal(size=400).tobytes())
            publisher.publish(JointState(position=noise))
        return made.process.poll() is not None

    made.observer.wait(has_ended, 'the recorder to give up')
    output = made.process.stdout.read()
    assert 'Traceback' not in output
    return [line for line in output.splitlines() if line.startswith('error:')]


@pytest.mark.faults(
    fault='disk full at the recorder',
    promise='one clear error, the log is valid up to there',
    mode='both',
    most=10,
)
def test_a_full_disk_ends_with_one_clear_error_and_a_whole_log(recording, small_disk, tmp_path):
    made = recording(folder=small_disk / 'bag')
    (error,) = flood(made)
    assert made.process.returncode == 1
    for words in (str(made.folder), 'No space left', 'kept'):
        assert words in error
    shutil.copytree(made.folder, tmp_path / 'kept')  # and read by every reader after the test
    numbers = [each.sequence for each in read_messages(made.file, ['/configuration'])]
    assert numbers == list(range(1, len(numbers) + 1))
    assert len(numbers) * 3200 > 2 * 2**20


def test_a_file_that_may_not_grow_keeps_what_it_has(recording):
    made = recording()
    limit = 2_000_000
    psutil.Process(made.process.pid).rlimit(psutil.RLIMIT_FSIZE, (limit, limit))
    (error,) = flood(made)
    assert made.process.returncode == 1
    for words in (str(made.folder), 'File too large', 'dpc bag repair'):
        assert words in error
    numbers = made.numbers
    assert numbers == list(range(1, len(numbers) + 1))
    assert len(numbers) * 3200 > limit / 2
    assert not (made.folder / 'metadata.yaml').exists()
