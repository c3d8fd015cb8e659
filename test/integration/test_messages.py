"""What a node does with a message that it can't use: it reports and goes on."""

import itertools
import time
from array import array

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.srv import ChangeState
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from state_messages import state_message
from std_srvs.srv import SetBool, Trigger

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.control import LatentObserver, ObserverSettings
from dpc_ros.network import Mechanics, load_network, save_network
from dpc_ros.nodes.controller_node import ControllerNode
from dpc_ros.nodes.encoder_node import EncoderNode
from dpc_ros.nodes.loop_node import LoopNode
from dpc_ros.nodes.messages import force_message, from_stamp, to_stamp
from dpc_ros.nodes.simulator_node import SimulatorNode
from dpc_ros.nodes.topics import LOOP_QOS, TARGET_QOS
from dpc_ros.reduction import CompressedSystem
from dpc_ros.threads import single_threaded_algebra

NETWORK = load_network('paper_2')
LATENT_NAMES = [f'xi_{i}' for i in range(5)]


def configuration(stamp=0, **changes):
    rest = NETWORK.rest_configuration
    message = state_message(to_stamp(stamp), NETWORK.identifier, rest, np.zeros_like(rest))
    for name, value in changes.items():
        setattr(message, name, value)
    return message


class Client:
    """Publishes to a node in a process and collects what it says."""

    def __init__(self, observer, domain, kind, *parameters):
        self.observer = observer
        self.answers = []
        parameters = ('expected_subscribers:=[observer]', *parameters)
        arguments = [part for item in parameters for part in ('-p', item)]
        self.process = domain.start(f'{kind}_node', '--ros-args', *arguments)
        self.domain = domain
        self.kind = kind
        observer.wait_for_node(kind)

    def call(self, service_type, name, request):
        node = self.observer.node
        service = node.create_client(service_type, f'/{self.kind}/{name}')
        self.observer.wait(service.service_is_ready, name)
        future = service.call_async(request)
        self.observer.wait(future.done, f'the answer of {name}')
        return future.result()

    def connect(self, input_type, input_topic, output_type, output_topic):
        node = self.observer.node
        node.create_subscription(output_type, output_topic, self.answers.append, LOOP_QOS)
        self.publisher = node.create_publisher(input_type, input_topic, LOOP_QOS)
        self.observer.wait(
            lambda: self.publisher.get_subscription_count() and node.count_publishers(output_topic),
            'the node to be matched',
        )

    def greet(self, first, second):
        """Wait until the node has discovered the observer: what comes before goes unanswered."""

        def publish_again():
            self.publisher.publish(first)
            return bool(self.answers)

        self.observer.wait(publish_again, 'a first answer')
        # One connection keeps its order: behind this answer there is none to the first message.
        self.publisher.publish(second)
        stamp = second.header.stamp
        self.observer.wait(lambda: self.answers[-1].header.stamp == stamp, 'a second answer')
        self.answers.clear()

    def ask(self, message):
        count = len(self.answers)
        self.publisher.publish(message)
        self.observer.wait(lambda: len(self.answers) > count, 'an answer')
        return self.answers[-1]

    def stop(self):
        code, output = self.domain.stop(self.process)
        assert code == 0, output
        return output


def test_encoder_reports_bad_configurations_and_goes_on(domain, observer):
    client = Client(observer, domain, 'encoder')
    client.connect(JointState, 'configuration', JointState, 'latent_state')
    client.greet(configuration(1), configuration(2))
    bad = {
        'size': configuration(position=array('d', [0.0] * 399)),
        'nan': configuration(velocity=array('d', [float('nan')] + [0.0] * 399)),
        'names': configuration(name=['mass_000/x'] * 400),
        'frame': configuration(),
    }
    bad['frame'].header.frame_id = 'paper_1@000000000000'
    for message in bad.values():
        client.publisher.publish(message)
    # One connection keeps its order: an answer to this one says that the others had none.
    answer = client.ask(configuration(5, name=NETWORK.coordinate_names))
    assert len(client.answers) == 1
    assert from_stamp(answer.header.stamp) == 5
    autoencoder = load_checkpoint('paper_2_extended_m5').autoencoder()
    expected, _ = autoencoder.encoder_jacobian_vector_product(
        NETWORK.rest_configuration, np.zeros(400)
    )
    np.testing.assert_allclose(answer.position, expected, rtol=1e-12, atol=1e-12)
    output = client.stop()
    for words in ('400 positions, got 399', 'number 0 is nan', 'expected the names', 'paper_1@0'):
        assert words in output


def test_a_repeated_stamp_is_answered_the_same_and_an_earlier_one_begins_anew(domain, observer):
    client = Client(observer, domain, 'encoder')
    client.connect(JointState, 'configuration', JointState, 'latent_state')
    client.greet(configuration(1), configuration(2))
    first = client.ask(configuration(10**9))
    assert client.ask(configuration(10**9)) == first
    moved = configuration(0, position=array('d', (NETWORK.rest_configuration + 0.1).tobytes()))
    anew = client.ask(moved)
    assert from_stamp(anew.header.stamp) == 0
    assert anew.position != first.position
    client.stop()


def test_an_estimate_waits_for_the_force_before(domain, observer):
    client = Client(observer, domain, 'encoder', 'observer:=kalman')
    client.connect(JointState, 'configuration', JointState, 'latent_state')
    forces = observer.node.create_publisher(WrenchStamped, 'control_force', LOOP_QOS)
    observer.wait(lambda: forces.get_subscription_count() > 0, 'the force to be matched')
    late = 10**9  # another motion than that of the greeting
    client.greet(configuration(1), configuration(late))
    client.answers.clear()
    autoencoder = load_checkpoint('paper_2_extended_m5').autoencoder()
    system = CompressedSystem(Mechanics(NETWORK), autoencoder, 162)
    filtered = LatentObserver(system, ObserverSettings())
    state = autoencoder.encoder_jacobian_vector_product(NETWORK.rest_configuration, np.zeros(400))

    def at(step):
        return 2 * late + step * 5_000_000

    def stamps():
        return [from_stamp(answer.header.stamp) for answer in client.answers]

    def assert_estimated(answer):
        with single_threaded_algebra():
            estimate = filtered.estimate(*state, from_stamp(answer.header.stamp))
        np.testing.assert_array_equal([answer.position, answer.velocity], estimate)

    def assert_waits(message):
        """Sent again, it makes the encoder ask for the missing force by its last answer."""
        last, count = client.answers[-1], len(client.answers)

        def send_again():
            client.publisher.publish(message)
            return len(client.answers) > count

        observer.wait(send_again, 'the last answer again')
        assert client.answers[-1] == last

    assert_estimated(client.ask(configuration(at(0))))
    assert_waits(configuration(at(1)))
    forces.publish(force_message(to_stamp(at(0)), 7, np.zeros(2)))
    forces.publish(force_message(to_stamp(at(5)), 162, np.zeros(2)))
    for _ in range(2):  # what comes twice counts once
        forces.publish(force_message(to_stamp(at(0)), 162, np.array([1.0, 2.0])))
    filtered.acted(at(0), np.array([1.0, 2.0]))
    observer.wait(lambda: stamps()[-1] == at(1), 'the estimate that waited')
    assert_estimated(client.answers[-1])
    forces.publish(force_message(to_stamp(at(1)), 162, np.zeros(2)))
    filtered.acted(at(1), np.zeros(2))
    client.publisher.publish(configuration(at(2)))
    observer.wait(lambda: stamps()[-1] == at(2), 'the next estimate')
    assert_estimated(client.answers[-1])
    assert client.ask(configuration(at(2))) == client.answers[-2]
    # A newer one, after two that were lost: both go on without the force.
    assert_waits(configuration(at(3)))
    client.publisher.publish(configuration(at(6)))
    observer.wait(lambda: stamps()[-1] == at(6), 'the newer estimate')
    assert [stamp for stamp, _ in itertools.groupby(stamps())] == [at(k) for k in (0, 1, 2, 3, 6)]
    for answer in client.answers[-2:]:
        assert_estimated(answer)
    output = client.stop()
    for words in ('expected mass 162, got 7', 'of no state so far'):
        assert words in output


def test_controller_takes_targets_and_refuses_bad_ones(domain, observer):
    parameters = ('law:=paper', 'proportional_gain:=1.0', 'latent_timeout:=0.0')
    client = Client(observer, domain, 'controller', *parameters)
    client.connect(JointState, 'latent_state', WrenchStamped, 'control_force')
    targets = observer.node.create_publisher(JointState, 'target', TARGET_QOS)
    observer.wait(lambda: targets.get_subscription_count() > 0, 'the target to be matched')
    identifier = load_checkpoint('paper_2_extended_m5').identifier

    def latent(stamp):
        return state_message(to_stamp(stamp), identifier, np.ones(5), np.zeros(5), LATENT_NAMES)

    client.publisher.publish(latent(0))  # no target yet: no answer
    reported = set()
    observer.node.create_subscription(
        DiagnosticArray,
        '/diagnostics',
        lambda array: reported.update(pair.key for pair in array.status[0].values),
        10,
    )
    for bad, words in (
        (JointState(position=array('d', [0.0] * 7)), '400 positions, got 7'),
        (JointState(position=array('d', [float('inf')] * 400)), 'number 0 is inf'),
        (JointState(name=['xi_0'], position=array('d', [0.0])), 'expected the names xi_0, xi_1'),
    ):
        targets.publish(bad)
        observer.wait(
            lambda words=words: any(words in key for key in reported), f'a report of {words}'
        )
    assert not client.answers
    targets.publish(JointState(name=LATENT_NAMES, position=array('d', [1.0] * 5)))
    stamp = 0

    def next_answer():
        nonlocal stamp
        stamp += 1
        client.publisher.publish(latent(stamp))
        return bool(client.answers)

    observer.wait(next_answer, 'the target to be taken')
    at_target = client.answers[-1]
    assert at_target.header.frame_id.startswith('mass_162@')
    assert from_stamp(at_target.header.stamp) > 0
    # A target for later does not count yet; from its stamp on it does.
    later = JointState(name=LATENT_NAMES, position=array('d', [0.5] * 5))
    later.header.stamp = Time(sec=100)
    targets.publish(later)
    before = client.ask(latent(50 * 10**9))
    assert before.wrench == at_target.wrench

    def changed():
        return client.ask(latent(100 * 10**9 + len(client.answers))).wrench != before.wrench

    observer.wait(changed, 'the later target to be in force')
    client.stop()


def test_simulator_rejects_bad_forces_and_goes_on(domain, observer):
    client = Client(observer, domain, 'simulator')
    client.connect(WrenchStamped, 'control_force', JointState, 'configuration')
    observer.wait(lambda: client.answers, 'the first state')
    now = to_stamp(0)
    bad = [
        force_message(now, 100, np.zeros(2)),
        force_message(now, 162, np.array([np.nan, 0.0])),
        force_message(to_stamp(10**9), 162, np.zeros(2)),
        WrenchStamped(),
    ]
    for message in bad:
        client.publisher.publish(message)
    # A controller that lets go, of which this is the first that has come, has not answered.
    client.publisher.publish(force_message(now, 162, np.zeros(2), 'aaaa', is_release=True))
    client.publisher.publish(force_message(now, 162, np.array([1.0, 0.0]), 'aaaa'))
    observer.wait(lambda: from_stamp(client.answers[-1].header.stamp) == 5_000_000, 'the next step')
    place = 2 * NETWORK.mobile_index(162)
    assert client.answers[-1].velocity[place] > 0
    output = client.stop()
    for words in ('expected mass 162, got 100', 'number 0 is nan', 'of no state so far', 'frame'):
        assert words in output


def test_simulator_services_and_pushes(domain, observer):
    client = Client(observer, domain, 'simulator')
    client.connect(WrenchStamped, 'control_force', JointState, 'configuration')
    observer.wait(lambda: client.answers, 'the first state')

    def call(service_type, name, **request):
        return client.call(service_type, name, service_type.Request(**request)).success

    def stamp():
        return from_stamp(client.answers[-1].header.stamp)

    assert not call(Trigger, 'step')  # not paused
    assert call(SetBool, 'pause', data=True)
    client.publisher.publish(force_message(to_stamp(0), 162, np.array([1.0, 0.0])))
    observer.wait(lambda: call(Trigger, 'step'), 'the force, and a step by hand')
    observer.wait(lambda: stamp() == 5_000_000, 'the step')
    assert not call(Trigger, 'step')  # the new state is not answered yet
    assert call(SetBool, 'pause', data=False)
    assert call(Trigger, 'reset')
    leap = 1_000_000_000  # by which encoder and controller see that the body was set back
    observer.wait(lambda: stamp() == leap + 5_000_000, 'the state after the reset')
    np.testing.assert_array_equal(client.answers[-1].position, NETWORK.rest_configuration)
    pushes = observer.node.create_publisher(WrenchStamped, 'external_force', LOOP_QOS)
    observer.wait(lambda: pushes.get_subscription_count() > 0, 'the push to be matched')
    place = 2 * NETWORK.mobile_index(204) + 1

    def push(force):
        pushes.publish(force_message(to_stamp(0), 204, np.array([0.0, force])))

    def moved_by(force):
        push(force)
        client.ask(force_message(client.answers[-1].header.stamp, 162, np.zeros(2)))
        return client.answers[-1].velocity[place] * np.sign(force) > 0.1

    # What comes before the simulator, too, has matched the two may be lost.
    observer.wait(lambda: moved_by(5.0), 'the push to move its mass')
    push(1e6)  # over the limit
    # One connection keeps its order: the simulator has seen the former by now.
    observer.wait(lambda: moved_by(-5.0), 'the push to turn its mass round')
    assert 'expected at most 100 N' in client.stop()


def test_lifecycle_by_hand(domain, observer, tmp_path):
    network = tmp_path / 'body.json'
    save_network(NETWORK, network)
    client = Client(observer, domain, 'simulator', 'autostart:=false', f'network:={network}')
    states = client.answers
    observer.node.create_subscription(JointState, 'configuration', states.append, LOOP_QOS)

    def change(label):
        request = ChangeState.Request()
        request.transition.label = label
        return client.call(ChangeState, 'change_state', request).success

    text = network.read_text()
    network.write_text('nothing')
    assert not change('configure')  # stays unconfigured, and alive
    network.write_text(text)
    assert change('configure')
    assert client.call(Trigger, 'reset', Trigger.Request()).success
    assert not states  # an inactive simulator is silent
    assert change('activate')
    observer.wait(lambda: states, 'the first state')
    assert change('deactivate')
    assert change('cleanup')
    count = len(states)
    assert change('configure')
    assert change('activate')
    observer.wait(lambda: len(states) > count + 1, 'the first state again')
    assert 'expected a network as JSON' in client.stop()


def test_a_paused_simulator_still_answers_a_late_node(domain, observer):
    client = Client(observer, domain, 'simulator', 'resend_interval:=0.05')
    assert client.call(SetBool, 'pause', SetBool.Request(data=True)).success
    client.connect(WrenchStamped, 'control_force', JointState, 'configuration')
    observer.wait(lambda: len(client.answers) > 2, 'the state, published again while paused')
    client.publisher.publish(force_message(to_stamp(0), 162, np.zeros(2)))
    observer.wait(
        lambda: client.call(Trigger, 'step', Trigger.Request()).success, 'the force and a step'
    )
    client.stop()


def test_several_publishers_are_reported(domain, observer):
    client = Client(observer, domain, 'encoder')
    client.connect(JointState, 'configuration', JointState, 'latent_state')
    second = observer.node.create_publisher(JointState, 'configuration', LOOP_QOS)
    observer.wait(lambda: second.get_subscription_count() > 0, 'the second publisher')
    for _ in range(100):  # more than the second will say
        client.ask(configuration(1))

    def answered(stamp):
        return any(from_stamp(answer.header.stamp) == stamp for answer in client.answers)

    # Two publishers keep no order between them, so one waits for the answer to the other; and the
    # node may know the second later than the second knows the node.
    def asked_by_the_second():
        second.publish(configuration(11))
        return answered(11)

    observer.wait(asked_by_the_second, 'an answer to the second publisher')
    client.publisher.publish(configuration(12))
    observer.wait(lambda: answered(12), 'an answer to the first publisher')
    assert 'several publishers' in client.stop()


@pytest.mark.parametrize('node_class', [SimulatorNode, EncoderNode, ControllerNode])
def test_parameters_are_described_and_read_only(observer, node_class):
    node = node_class(observer.node.context)
    try:
        described = node.describe_parameters(['network', 'executor'])
        assert all(item.description and item.read_only for item in described)
        assert 'kept_wait_set' in described[1].additional_constraints
        (result,) = node.set_parameters([Parameter('network', value='paper_1')])
        assert not result.successful
        assert result.reason
    finally:
        node.close()


@pytest.mark.parametrize('newest', [1, 20])
def test_who_was_held_up_takes_the_newest(run_here, observer, newest):
    """And all that come after it, in order; those that it left out count as lost."""
    node = run_here(LoopNode('encoder', observer.node.context))
    taken = []

    def take(message, info):
        node.receive('configuration', info)
        taken.append(from_stamp(message.header.stamp))

    node.create_input('configuration', take, newest)
    publisher = observer.node.create_publisher(JointState, 'configuration', LOOP_QOS)
    observer.wait(publisher.get_subscription_count, 'the subscription')
    publisher.publish(configuration(0))
    observer.wait(lambda: taken, 'the first message')
    for stamp in range(1, 1001):  # while nothing is taken
        publisher.publish(configuration(stamp))
    assert publisher.wait_for_all_acked(Duration(seconds=10))
    observer.wait(lambda: len(taken) > newest, 'the newest messages')
    publisher.publish(configuration(1001))
    observer.wait(lambda: taken[-1] == 1001, 'the message after them')
    assert taken == [0, *range(1001 - newest, 1002)]
    assert node.health.lost['configuration'] == 1000 - newest


@pytest.mark.parametrize(
    ('waited', 'expected'),
    [(0.0, [1]), (0.01, [3]), (-10.0, [3])],  # the last by a clock that was set back
)
def test_newer_ones_are_looked_for_behind_what_has_waited(run_here, observer, waited, expected):
    node = run_here(LoopNode('encoder', observer.node.context))
    taken = []
    node.create_input('configuration', lambda message, _: taken.append(message.header.stamp), 1)
    publisher = observer.node.create_publisher(JointState, 'configuration', LOOP_QOS)
    observer.wait(publisher.get_subscription_count, 'the subscription')
    states = {each: configuration(each) for each in (1, 2, 3)}
    for state in states.values():
        publisher.publish(state)
    assert publisher.wait_for_all_acked(Duration(seconds=10))
    (subscription,) = (
        each for each in node.subscriptions if each.topic_name.endswith('configuration')
    )
    message, info = subscription.handle.take_message(JointState, False)
    info['received_timestamp'] = time.time_ns() - round(waited * 1e9)
    subscription.callback(message, info)
    assert taken == [states[each].header.stamp for each in expected]


@pytest.mark.parametrize('order', [('target', 1), (1, 'target', 2)])
def test_a_target_counts_for_all_states_that_are_not_answered_yet(run_here, observer, order):
    """Though the executor has looked for targets before that one came."""
    node = run_here(LoopNode('encoder', observer.node.context))
    taken = []
    node.create_input('target', lambda _: taken.append('target'))
    node.create_input('configuration', lambda message, _: taken.append(message.header.stamp), 20)
    publishers = {
        topic: observer.node.create_publisher(JointState, topic, qos)
        for topic, qos in (('target', TARGET_QOS), ('configuration', LOOP_QOS))
    }
    for publisher in publishers.values():
        observer.wait(publisher.get_subscription_count, 'the subscription')
    states = {each: configuration(each) for each in order if each != 'target'}
    for each in order:
        publisher = publishers[each if each == 'target' else 'configuration']
        publisher.publish(states.get(each, JointState()))
        assert publisher.wait_for_all_acked(Duration(seconds=10))
    (subscription,) = (
        each for each in node.subscriptions if each.topic_name.endswith('configuration')
    )
    while (found := subscription.handle.take_message(JointState, False)) is not None:
        subscription.callback(*found)
    assert taken == ['target', *(state.header.stamp for state in states.values())]
