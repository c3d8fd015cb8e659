"""What must not move the body does not, and all goes on by itself when it is over."""

import itertools
import signal
import time
from array import array

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from state_messages import state_message
from std_srvs.srv import SetBool, Trigger

from dpc_ros.network import Body, Integrator, Mechanics, load_network
from dpc_ros.nodes.messages import force_message, from_stamp, to_stamp
from dpc_ros.nodes.topics import LOOP_QOS

LOOP = ('simulator', 'encoder', 'controller')
NETWORK = load_network('paper_2')
STEP = 5_000_000  # ns
FOR_EVER = 1000.0  # s


class Witness:
    """Sees the states and the health of a loop, publishes forces and sets parameters."""

    def __init__(self, observer):
        self.observer = observer
        self.node = observer.node
        self.states = []
        self.health = {}
        self.warnings = {}
        self.node.create_subscription(JointState, 'configuration', self.states.append, LOOP_QOS)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._take, 100)
        self.forces = self.node.create_publisher(WrenchStamped, 'control_force', LOOP_QOS)

    def _take(self, message):
        for status in message.status:
            self.health[status.name] = {pair.key: pair.value for pair in status.values}
            self.warnings[status.name] = status.message

    @property
    def stamp(self):
        return from_stamp(self.states[-1].header.stamp)

    def push(self, force, identifier='', stamp=None):
        stamp = self.stamp if stamp is None else stamp
        self.forces.publish(force_message(to_stamp(stamp), 162, np.array(force), identifier))
        return stamp

    def wait_for_rejection(self, node, words):
        def is_reported():
            return any(
                key.startswith('rejected') and words in key for key in self.health.get(node, ())
            )

        self.observer.wait(is_reported, f'{node} to report {words!r}')

    def call(self, service_type, name, request):
        client = self.node.create_client(service_type, name)
        self.observer.wait(client.service_is_ready, name)
        called = client.call_async(request)
        self.observer.wait(called.done, f'the answer of {name}')
        return called.result()

    def set_parameters(self, node, **values):
        request = SetParametersAtomically.Request(
            parameters=[
                Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
            ]
        )
        answer = self.call(SetParametersAtomically, f'{node}/set_parameters_atomically', request)
        assert answer.result.successful, answer.result.reason


@pytest.fixture
def witness(observer):
    return Witness(observer)


def distinct(states):
    """Return the states by stamp, the first of each."""
    found = {}
    for state in states:
        found.setdefault(from_stamp(state.header.stamp), state)
    return found


@pytest.mark.faults(
    fault='a second controller; simulator stopped for longer than its time-out',
    promise='every force is rejected and reported, the body waits, then goes on bit for bit',
    mode='lockstep',
    most=10,
)
def test_lockstep_waits_out_a_second_controller_and_a_stopped_simulator(
    domain, observer, witness, plan, reference
):
    """Neither shows in what comes out: all bits are those of the in-process loop.

    The controller, which is not asked for longer than its time-out, commands zero meanwhile.
    """
    readers = ['encoder', 'observer']
    made = plan(
        record=False,
        simulator={
            'duration': 0.0,
            'expected_subscribers': readers,
            'controller_timeout': FOR_EVER,
            'response_timeout': FOR_EVER,
        },
    )
    nodes = {kind: domain.start_node(kind, made) for kind in LOOP}
    observer.wait(lambda: len(distinct(witness.states)) > 20, 'a running loop')
    witness.push([5.0, 0.0], 'feedface', stamp=0)
    witness.wait_for_rejection('simulator', 'got those of ')
    assert 'feedface' in witness.warnings['simulator']
    count = len(witness.states)

    def stands():
        return len({from_stamp(state.header.stamp) for state in witness.states[count:][-4:]}) == 1

    observer.wait(lambda: len(witness.states) > count + 4 and stands(), 'the unanswered state')
    waiting, count = witness.stamp, len(witness.states)
    observer.wait(lambda: len(witness.states) > count + 3, 'it to be repeated')
    assert {from_stamp(state.header.stamp) for state in witness.states[count:]} == {waiting}
    # The second one has been silent for that long: the first is taken again.
    limit = 6.0  # s, for which its own standing still does not count
    witness.set_parameters('simulator', controller_timeout=0.1, response_timeout=limit)
    observer.wait(lambda: witness.stamp > waiting + 20 * STEP, 'the loop to go on')
    nodes['simulator'].send_signal(signal.SIGSTOP)
    stopped = time.monotonic()
    observer.wait(lambda: time.monotonic() > stopped + 1.1 * limit, 'more than the time-out')
    before = witness.stamp
    nodes['simulator'].send_signal(signal.SIGCONT)
    observer.wait(lambda: witness.stamp > before + 20 * STEP, 'the loop to go on')
    for kind in LOOP:
        code, output = domain.stop(nodes[kind])
        assert code == 0, output
    found = distinct(witness.states)
    steps = min(len(found), len(reference.configuration))
    assert list(found) == [STEP * k for k in range(len(found))]
    for k, state in enumerate(itertools.islice(found.values(), steps)):
        np.testing.assert_array_equal(state.position, reference.configuration[k])


@pytest.mark.faults(
    fault='a second controller; forces that are too strong, not finite, or of a state to come',
    promise='rejected and reported; no force acts from the next step on; late ones are passed over',
    mode='realtime',
    most=10,
)
def test_the_force_that_acts_in_realtime(domain, observer, witness, plan):
    """Each step says by its very bits which force has acted in it."""
    made = plan(
        record=False,
        simulator={
            'time_mode': 'realtime',
            'duration': 0.0,
            'expected_subscribers': ['observer'],
            'controller_timeout': FOR_EVER,
            'force_timeout': FOR_EVER,
            'stale_force': 'hold',
        },
    )
    simulator = domain.start_node('simulator', made)
    observer.wait(lambda: witness.states and witness.forces.get_subscription_count(), 'a state')
    body = Body(Integrator(Mechanics(NETWORK), STEP / 1e9), 162)

    def acted(before, after, strength):
        body.configuration = np.array(before.position)
        body.velocity = np.array(before.velocity)
        body.advance(np.array([strength, 0.0]))
        return np.array_equal(body.configuration, after.position) and np.array_equal(
            body.velocity, after.velocity
        )

    candidates = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 60.0)
    acting = []  # the force of each step [N]

    def judge():
        states = list(distinct(witness.states).values())
        for before, after in itertools.pairwise(states[len(acting) :]):
            # The force of the step before is the likely one.
            tried = sorted(candidates, key=lambda force: force != (acting or [0.0])[-1])
            acting.append(next((each for each in tried if acted(before, after, each)), np.nan))
        return acting

    def wait_until_acts(strength):
        start = len(judge())
        observer.wait(lambda: strength in judge()[start:], f'{strength} N to act')

    def changes():
        return [force for force, _ in itertools.groupby(judge())]

    def pause(whether):
        assert witness.call(SetBool, 'simulator/pause', SetBool.Request(data=whether)).success

    def step():
        assert witness.call(Trigger, 'simulator/step', Trigger.Request()).success

    pause(True)  # and a step before the first force: time runs all the same once there is one
    step()
    pause(False)
    witness.push([1.0, 0.0], 'aaaa')
    wait_until_acts(1.0)
    for bad, stamp in ((60.0, None), (np.nan, None), (4.0, 10**12)):
        witness.push([bad, 0.0], 'aaaa', stamp)
        wait_until_acts(0.0)
        witness.push([1.0, 0.0], 'aaaa')
        wait_until_acts(1.0)
    newest = witness.push([2.0, 0.0], 'aaaa')
    wait_until_acts(2.0)
    witness.push([3.0, 0.0], 'aaaa', stamp=newest - STEP)  # late
    newest = witness.push([2.5, 0.0], 'aaaa')
    wait_until_acts(2.5)
    witness.push([0.0, 0.0], 'aaaa', stamp=newest)  # as the watchdog of a controller does
    wait_until_acts(0.0)
    witness.push([1.0, 0.0], 'aaaa')
    wait_until_acts(1.0)
    witness.push([4.0, 0.0], 'bbbb')  # a second controller
    wait_until_acts(0.0)
    witness.push([5.0, 0.0], 'aaaa')  # nobody knows which one is right
    witness.wait_for_rejection('simulator', 'got those of aaaa and bbbb')
    assert 'aaaa and bbbb' in witness.warnings['simulator']
    witness.set_parameters('simulator', controller_timeout=0.001, force_rate_limit=100.0)
    witness.push([2.0, 0.0], 'bbbb')  # taken by itself, in steps of 100 N/s
    wait_until_acts(2.0)
    refused = [0.0, 1.0] * 3
    assert changes() == [0.0, 1.0, *refused, 2.0, 2.5, 0.0, 1.0, 0.0, 0.5, 1.0, 1.5, 2.0]
    assert judge().count(0.5) == judge().count(1.5) == 1

    simulator.send_signal(signal.SIGSTOP)
    stopped = time.monotonic()
    observer.wait(lambda: time.monotonic() > stopped + 0.2, 'some steps to be missed')
    simulator.send_signal(signal.SIGCONT)
    observer.wait(
        lambda: int(witness.health['simulator'].get('missed steps', 0)) > 20, 'missed steps'
    )
    witness.set_parameters('simulator', real_time_factor=0.5, stale_force='zero', force_timeout=0.1)
    wait_until_acts(0.0)  # let go at once, whatever the rate
    assert changes()[-2:] == [2.0, 0.0]
    witness.set_parameters('simulator', force_timeout=1.0)  # a hundred ticks
    free = witness.stamp
    observer.wait(lambda: witness.stamp > free + 200 * STEP, 'steps without a force')
    witness.push([1.5, 0.0], 'bbbb', stamp=witness.stamp - 150 * STEP)  # was long on its way
    sent = witness.stamp
    observer.wait(lambda: witness.stamp > sent + 50 * STEP, 'steps that it could act in')
    assert changes()[-1] == 0.0
    witness.push([0.5, 0.0], 'bbbb')
    wait_until_acts(0.5)
    wait_until_acts(0.0)
    assert changes()[-4:] == [2.0, 0.0, 0.5, 0.0]
    observer.wait(
        lambda: witness.health['simulator'].get('rate-limited steps') == '3', 'the limited steps'
    )
    newest = witness.stamp
    assert witness.call(Trigger, 'simulator/reset', Trigger.Request()).success
    leapt = len(witness.states)
    observer.wait(
        lambda: (
            max(np.diff([from_stamp(each.header.stamp) for each in witness.states])) > STEP
            and len(witness.states) > leapt + 3
        ),
        'states after the reset',
    )
    witness.push([3.0, 0.0], 'bbbb', stamp=newest)  # of before the reset
    witness.push([0.5, 0.0], 'bbbb')
    wait_until_acts(0.5)
    stamps = np.array([from_stamp(state.header.stamp) for state in witness.states])
    assert (np.diff(stamps) >= STEP).all()
    (leap,) = np.flatnonzero(np.diff(stamps) > STEP)
    np.testing.assert_array_equal(witness.states[leap + 1].position, NETWORK.rest_configuration)
    after = [force for force, _ in itertools.groupby(judge()[leap + 1 :])]
    assert after[:2] == [0.0, 0.5]
    pause(True)
    witness.set_parameters('simulator', force_timeout=0.1)
    paused = time.monotonic()
    observer.wait(lambda: time.monotonic() > paused + 0.2, 'the force to become stale')
    begin = len(judge())
    step()
    observer.wait(lambda: len(judge()) > begin, 'the step')
    assert judge()[begin:] == [0.0]
    code, output = domain.stop(simulator)
    assert code == 0, output
    for words in ('expected at most 50 N, got 60', 'stale, using zero'):
        assert words in output


def configuration(stamp, position=0.0, velocity=0.0):
    """Return the body displaced by a length from rest."""
    displaced = NETWORK.rest_configuration + position
    message = state_message(
        to_stamp(0), NETWORK.identifier, displaced, np.full_like(displaced, velocity)
    )
    message.header.stamp = stamp if isinstance(stamp, Time) else to_stamp(stamp)
    return message


@pytest.mark.faults(
    fault='configuration with NaN, Inf, huge values, bad stamps',
    promise='rejected with the reason, nothing is published, the next good one is answered',
    mode='both',
    most=10,
)
def test_an_encoder_refuses_what_no_body_does(domain, observer, witness, plan):
    made = plan(record=False, encoder={'expected_subscribers': ['observer']})
    encoder = domain.start_node('encoder', made)
    answers = []
    observer.node.create_subscription(JointState, 'latent_state', answers.append, LOOP_QOS)
    states = observer.node.create_publisher(JointState, 'configuration', LOOP_QOS)
    observer.wait(lambda: states.get_subscription_count(), 'the encoder')

    def stamps():
        return [from_stamp(each.header.stamp) for each in answers]

    def is_answered():
        states.publish(configuration(0))  # again and again: the encoder may not know the test yet
        return bool(answers)

    observer.wait(is_answered, 'an answer')
    states.publish(configuration(1))
    observer.wait(lambda: stamps()[-1] == 1, 'an answer behind which there are none to the first')
    answers.clear()
    observer.wait(lambda: witness.warnings.get('encoder') == 'configuration is stale', 'staleness')
    far, fast = configuration(STEP, position=1e308), configuration(STEP, velocity=-1e308)
    short = configuration(STEP)
    short.velocity = array('d', [0.0] * 3)
    refused = (
        (far, 'expected a displacement of at most 100 m, got 1e+308'),
        (fast, 'expected a speed of at most 1000 m/s, got 1e+308'),
        (short, 'expected 400 velocities, got 3'),
        (configuration(STEP, velocity=np.inf), 'finite velocities, but number 0 is inf'),
        (configuration(STEP, position=np.nan), 'finite positions, but number 0 is nan'),
        (configuration(Time(sec=-1)), 'expected a stamp from 0 on'),
        (configuration(Time(nanosec=10**9)), 'expected a stamp from 0 on'),
    )
    for message, _ in refused:
        states.publish(message)
    for _, words in refused:
        witness.wait_for_rejection('encoder', words)
    witness.set_parameters('encoder', largest_displacement=1e308, largest_speed=1e308)
    states.publish(far)  # what overflows on the way
    witness.wait_for_rejection('encoder', 'encoder: expected a finite latent state')
    witness.set_parameters('encoder', configuration_timeout=0.0)
    later = 10**9 * 10**9  # a leap of thirty years, and back: a new epoch
    for stamp in (later, STEP):
        states.publish(configuration(stamp))
    observer.wait(lambda: len(answers) > 1, 'the answers')
    assert stamps() == [later, STEP]
    assert answers[0].position == answers[1].position
    observer.wait(lambda: witness.warnings['encoder'] != 'configuration is stale', 'no staleness')
    code, output = domain.stop(encoder)
    assert code == 0, output
    assert 'Traceback' not in output


@pytest.mark.long
@pytest.mark.faults(
    fault='another simulator, whose time begins at zero',
    promise='encoder and controller serve it without a restart',
    mode='realtime',
    most=10,
)
def test_another_simulator_in_realtime_is_a_new_epoch(domain, observer, witness, plan):
    """Encoder, observer and controller serve it without a restart, and count nothing as wrong."""
    made = plan(
        record=False,
        simulator={
            'time_mode': 'realtime',
            'duration': 0.0,
            'expected_subscribers': ['encoder', 'observer'],
        },
        encoder={'observer': 'kalman'},
        controller={'expected_subscribers': ['simulator', 'encoder']},
    )
    nodes = {kind: domain.start_node(kind, made) for kind in LOOP}
    observer.wait(lambda: len(distinct(witness.states)) > 200, 'a second of the run')
    domain.kill(nodes['simulator'])
    nodes['simulator'] = domain.start_node('simulator', made)
    observer.wait(lambda: witness.stamp == 0, 'another simulator')
    observer.wait(lambda: witness.stamp > 200 * STEP, 'a second of its run')
    moved = np.abs(witness.states[-1].position - NETWORK.rest_configuration).max()
    assert 0 < moved < np.inf
    for kind in LOOP:
        code, output = domain.stop(nodes[kind])
        assert code == 0, output
    assert not [key for key in witness.health['encoder'] if key.startswith('rejected: control')]
