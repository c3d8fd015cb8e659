"""A controller that nobody has to watch: what it refuses, when it falls silent, how it solves."""

import json
import math
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from process_state import is_gone
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python
from sensor_msgs.msg import JointState
from state_messages import state_message

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.control import Target
from dpc_ros.control.registry import ENTRY_POINT_GROUP
from dpc_ros.network import load_network
from dpc_ros.nodes.messages import (
    from_stamp,
    latent_names,
    read_force,
    to_stamp,
)
from dpc_ros.nodes.target_messages import target_message
from dpc_ros.nodes.topics import IN_FORCE_QOS, LOOP_QOS, TARGET_QOS

NETWORK = load_network('paper_2').identifier
CHECKPOINT = load_checkpoint('paper_2_extended_m5').identifier
NAMES = latent_names(5)
STEP = 5_000_000  # ns
TARGETS = 1000
BOUND = 20.0  # N, largest_force

# Pushes by two coordinates of the target, times the gain. It solves for a latent target above zero
# no sooner than the test lets it, and gives no number where ξ₀ is above 100.
GATED_LAW = """
import os
import time
from pathlib import Path

import numpy as np

from dpc_ros.control import ControlLaw

FOLDER = Path(os.environ['GATE'])


class Gated(ControlLaw):
    def __init__(self, system, settings):
        super().__init__(system, settings)
        self.push = np.zeros(2)

    def solve(self, target):
        with (FOLDER / 'solved').open('a') as file:
            file.write(f'{target.value[0]:g}\\n')
        while target.is_latent and target.value[0] > 0 and not (FOLDER / 'open').exists():
            time.sleep(0.01)
        if self.settings.proportional_gain > 100:
            raise ValueError('no equilibrium with such a gain')
        return self.settings.proportional_gain * target.value[:2]

    def adopt(self, solution):
        self.push = solution

    def unbounded_force(self, latent, latent_velocity):
        return self.push if latent[0] < 100 else np.full(2, np.nan)
"""


class Controller:
    """A controller in a process, the loop around which is the test's."""

    def __init__(self, observer, domain, *parameters):
        self.observer, self.domain = observer, domain
        self.node = observer.node
        self.stamp = 0
        self.forces, self.in_force, self.parameters, self.reports = [], [], [], []
        arguments = [
            part
            for each in ('expected_subscribers:=[observer]', *parameters)
            for part in ('-p', each)
        ]
        self.process = domain.start('controller_node', '--ros-args', *arguments)
        listen = self.node.create_subscription
        listen(WrenchStamped, 'control_force', self.forces.append, LOOP_QOS)
        listen(JointState, 'target_in_force', self.in_force.append, IN_FORCE_QOS)
        listen(ParameterEvent, 'parameters_in_force', self.parameters.append, IN_FORCE_QOS)
        listen(DiagnosticArray, '/diagnostics', self.reports.append, 10)
        self.states = self.node.create_publisher(JointState, 'latent_state', LOOP_QOS)
        self.targets = self.node.create_publisher(JointState, 'target', TARGET_QOS)
        observer.wait(self.is_matched, 'the controller')

    def is_matched(self):
        return (
            self.states.get_subscription_count()
            and self.targets.get_subscription_count()
            and self.node.count_publishers('control_force')
        )

    def aim(self, *place):
        value = np.zeros(5)
        value[: len(place)] = place
        self.targets.publish(target_message(Target(latent=value), NETWORK))

    def publish(self, stamp, first=0.0):
        latent = np.full(5, first)
        message = state_message(to_stamp(stamp), CHECKPOINT, latent, np.ones(5), NAMES)
        self.states.publish(message)

    def step(self, first=0.0):
        """Return the answer to the next state: of its stamp, the first force that is there."""
        self.stamp += STEP
        self.publish(self.stamp, first)
        return self.answer(self.stamp)

    def answer(self, stamp):
        found = []

        def is_there():
            found[:] = [each for each in self.forces if from_stamp(each.header.stamp) == stamp]
            return bool(found)

        self.observer.wait(is_there, f'the force of {stamp}')
        return found[0]

    def step_until(self, condition, what):
        """Let states come, each answered, until a condition holds."""

        def holds():
            self.step()
            return condition()

        self.observer.wait(holds, what)

    def first_step(self):
        """Let the first state come until the node has discovered the observer."""

        def publish_again():
            self.publish(self.stamp)
            return bool(self.forces)

        self.observer.wait(publish_again, 'a first force')

    def call(self, kind, name, request):
        service = self.node.create_client(kind, f'/controller/{name}')
        self.observer.wait(service.service_is_ready, name)
        future = service.call_async(request)
        self.observer.wait(future.done, f'the answer of {name}')
        return future.result()

    def set(self, **values):
        """Return why a set of parameters is refused; empty where it is not."""
        changes = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=changes)
        result = self.call(SetParametersAtomically, 'set_parameters_atomically', request).result
        assert result.successful == (not result.reason)
        return result.reason

    def get(self, *names):
        answer = self.call(GetParameters, 'get_parameters', GetParameters.Request(names=names))
        return [parameter_value_to_python(each) for each in answer.values]

    def reported(self, words):
        return any(
            words in text
            for each in self.reports
            for status in each.status
            for text in (status.message, *(value.key for value in status.values))
        )


def frame_of(message):
    frame, _ = read_force(message)
    return frame


def force_of(message):
    _, force = read_force(message)
    return force.tolist()


@pytest.mark.faults(
    fault='gain NaN, negative, 1e12; unknown law; one bad value of a set',
    promise='refused as a whole with the reason, the old values stay in force',
    mode='lockstep',
    most=10,
)
def test_what_no_actuator_may_get_is_refused_and_what_is_good_counts_from_a_state_on(
    domain, observer
):
    controller = Controller(
        observer, domain, 'law:=paper', 'target:=rest', 'latent_timeout:=0.0', 'autostart:=true'
    )
    controller.first_step()
    before = force_of(controller.step(0.5))
    names = ['derivative_gain', 'proportional_gain', 'law', 'largest_force']
    values = controller.get(*names)
    refused = [
        ({'derivative_gain': math.nan}, 'derivative_gain'),
        ({'derivative_gain': -1.0}, 'derivative_gain'),
        ({'proportional_gain': 1e12}, 'proportional_gain'),
        ({'largest_force': math.inf}, 'largest_force'),
        ({'derivative_gain': 2.0, 'proportional_gain': math.nan}, 'proportional_gain'),
        ({'derivative_gain': 2.0, 'law': 'pid'}, "unknown control law 'pid'"),
        ({'derivative_gain': 2.0, 'law_options': '{a: 1}'}, 'takes no options'),
        ({'derivative_gain': 2.0, 'network': 'paper_1'}, 'read-only'),
    ]
    for change, words in refused:
        assert words in controller.set(**change)
    assert controller.get(*names) == values
    assert force_of(controller.step(0.5)) == before
    observer.wait(lambda: controller.parameters, 'the first announcement')
    assert len(controller.parameters) == 1

    # The velocity is ones throughout, and the momentum is not zero: twice the gain acts.
    assert not controller.set(derivative_gain=2.0, proportional_gain=0.0)
    assert controller.get(*names)[:2] == [2.0, 0.0]
    answered = controller.forces[-1]
    count = len(controller.forces)
    controller.publish(controller.stamp, 0.5)  # a state that was answered stays answered so
    observer.wait(lambda: len(controller.forces) > count, 'the same answer')
    assert controller.forces[-1] == answered
    assert force_of(controller.step(0.5)) != before
    observer.wait(lambda: len(controller.parameters) == 2, 'the change to be announced')
    first, change = controller.parameters
    assert first.node == change.node == '/controller'
    assert set(values) <= {parameter_value_to_python(each.value) for each in first.new_parameters}
    assert from_stamp(change.stamp) == controller.stamp
    assert {each.name: each.value.double_value for each in change.changed_parameters} == {
        'derivative_gain': 2.0,
        'proportional_gain': 0.0,
    }
    assert not controller.set(derivative_gain=values[0], proportional_gain=values[1])
    assert force_of(controller.step(0.5)) == before
    code, output = domain.stop(controller.process)
    assert code == 0, output


@pytest.fixture
def gate(install_package, monkeypatch, tmp_path):
    """Install the gated law for child processes; return its folder."""
    site = install_package('gated_law', GATED_LAW, {'gated': 'gated_law:Gated'}, ENTRY_POINT_GROUP)
    paths = [str(site), *filter(None, [os.environ.get('PYTHONPATH')])]
    monkeypatch.setenv('PYTHONPATH', os.pathsep.join(paths))
    monkeypatch.setenv('GATE', str(tmp_path))
    return tmp_path


def children(process):
    """Return the living processes that a process has started."""
    return [
        int(each)
        for task in Path(f'/proc/{process.pid}/task').iterdir()
        for each in (task / 'children').read_text().split()
    ]


@pytest.mark.faults(
    fault='latent states stop; law gives NaN; 1000 targets while one is solved; solver killed',
    promise='zero force, reported; every state is answered; the last target ends in force',
    mode='realtime',
    most=10,
)
def test_the_loop_goes_on_while_another_process_solves(domain, observer, gate):
    controller = Controller(
        observer,
        domain,
        'law:=gated',
        'proportional_gain:=1.0',
        'solve_in_background:=true',
        'latent_timeout:=0.3',
    )
    controller.aim(-1.0, 2.0)
    controller.first_step()
    identifier = frame_of(controller.forces[0]).controller
    assert len(identifier) == 8
    assert force_of(controller.step()) == [-1.0, 2.0]

    # However many targets come while one is being solved, the newest is the only one solved next.
    controller.aim(1.0)
    solved = gate / 'solved'
    controller.step_until(lambda: solved.read_text().split()[-1] == '1', 'it is being solved')
    for number in range(2, TARGETS + 1):
        controller.aim(float(number))
        if number % 100 == 0:
            assert force_of(controller.step()) == [-1.0, 2.0]
    (gate / 'open').touch()
    controller.step_until(lambda: solved.read_text().split()[-1] == str(TARGETS), 'the last one')
    numbers = [int(each) for each in solved.read_text().split()]
    newest = numbers[numbers.index(1) + 1 :]
    assert len(newest) < 10, newest  # some may have been on their way when the gate was opened
    assert newest == sorted(newest)
    brought = [-1, 1, *newest]
    controller.step_until(lambda: len(controller.in_force) == len(brought), 'the targets in force')
    assert [each.position[0] for each in controller.in_force] == brought
    first = next(each for each in controller.forces if force_of(each) == [BOUND, 0.0])
    assert from_stamp(controller.in_force[2].header.stamp) == from_stamp(first.header.stamp)

    # A solver that was killed is replaced; no target is lost.
    (solver,) = children(controller.process)
    os.kill(solver, signal.SIGKILL)
    controller.aim(-3.0, 1.0)
    controller.step_until(lambda: force_of(controller.forces[-1]) == [-3.0, 1.0], 'its successor')

    # A gain without a solution is reported, the old one stays, and the parameters say so.
    assert not controller.set(proportional_gain=101.0)
    controller.step_until(lambda: controller.get('proportional_gain') == [1.0], 'it is taken back')
    assert force_of(controller.step()) == [-3.0, 1.0]
    controller.observer.wait(lambda: controller.reported('no equilibrium with'), 'the report')
    assert not controller.set(proportional_gain=2.0)
    controller.step_until(lambda: force_of(controller.forces[-1]) == [-6.0, 2.0], 'the new gain')

    # Force that is no number never leaves: zero is commanded for that state, and said.
    nothing = controller.step(200.0)
    assert force_of(nothing) == [0.0, 0.0]
    assert force_of(controller.step()) == [-6.0, 2.0]
    controller.observer.wait(lambda: controller.reported('expected a finite force'), 'the report')

    # Without a new state zero is commanded once, and the next one is answered as ever.
    controller.step()
    count = len(controller.forces)
    observer.wait(lambda: len(controller.forces) > count, 'the watchdog')
    assert from_stamp(controller.forces[-1].header.stamp) == controller.stamp
    assert force_of(controller.forces[-1]) == [0.0, 0.0]
    assert frame_of(controller.forces[-1]).is_release
    controller.observer.wait(lambda: controller.reported('no new latent_state'), 'the report')
    assert force_of(controller.step()) == [-6.0, 2.0]
    assert len(controller.forces) == count + 2
    frames = [frame_of(each) for each in controller.forces]
    assert {frame.controller for frame in frames} == {identifier}
    assert [frame.is_release for frame in frames].count(True) >= 1
    assert not frames[-1].is_release

    (solver,) = children(controller.process)
    code, output = domain.stop(controller.process)
    assert code == 0, output
    assert is_gone(solver)


def test_a_controller_reports_while_it_solves_for_its_first_target(
    domain, observer, gate, tmp_path
):
    """As long as it may take: nobody is to take the node for one that hangs."""
    states = []

    def hear(message):
        values = {each.key: each.value for each in message.status[0].values}
        states.append(values['state'])

    observer.node.create_subscription(DiagnosticArray, '/diagnostics', hear, 10)
    target = tmp_path / 'target.json'
    target.write_text(json.dumps({'latent': [1.0, 0.0, 0.0, 0.0, 0.0]}))
    parameters = ('law:=gated', 'solve_in_background:=true', f'target:={target}')
    arguments = (part for each in parameters for part in ('-p', each))
    controller = domain.start('controller_node', '--ros-args', *arguments)
    observer.wait((gate / 'solved').exists, 'it to solve')
    states.clear()
    observer.wait(lambda: len(states) > 2, 'reports')
    assert {*states} == {'configuring'}
    (gate / 'open').touch()
    observer.wait(lambda: states[-1] == 'active', 'the end of its configuration')
    code, output = domain.stop(controller)
    assert code == 0, output


@pytest.mark.faults(
    fault='controller killed (`kill -9`) while it solves',
    promise='its solver ends, too',
    mode='realtime',
    most=10,
)
def test_a_solver_ends_with_a_controller_that_was_killed(domain, observer, gate):
    """Also while it solves."""
    controller = Controller(observer, domain, 'law:=gated', 'solve_in_background:=true')
    controller.aim(1.0)

    def is_solving():
        controller.publish(0)
        return (gate / 'solved').exists() and '1' in (gate / 'solved').read_text().split()

    observer.wait(is_solving, 'a target that is never solved')
    (solver,) = children(controller.process)
    domain.kill(controller.process)
    observer.wait(lambda: is_gone(solver), 'the end of its solver')
