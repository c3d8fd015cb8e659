"""A log says everything: run again, in process or over DDS, it gives the same bits."""

import re
import subprocess
import sys

import pytest
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from dpc_ros import cli
from dpc_ros.bag.rerun import rerun
from dpc_ros.bag.rerun_table import table
from dpc_ros.control import load_target
from dpc_ros.network import load_network
from dpc_ros.nodes.messages import from_stamp
from dpc_ros.nodes.target_messages import target_message
from dpc_ros.nodes.topics import IN_FORCE_QOS, TARGET_QOS

NETWORK = load_network('paper_2')
STEPS = 200
CHANGE = 10  # steps before the first change of the target
LATER = 500_000_000  # ns, from the first change to the second


@pytest.fixture
def changing_run(domain, observer, plan):
    """Return a function that records a run whose target changes twice and returns its plan.

    The body stands still while a target is on its way: the first change counts at once, whenever
    that is, the second from a stamp on. With gains, these are set behind the first change; the
    stamp from which on they counted is returned, too.
    """

    def run(encoder=(), gains=(), **controller):
        made = plan(
            simulator={'duration': STEPS * 0.005},
            encoder=dict(encoder),
            controller={'target': 'simulation:4@100', **controller},
        )
        node, announced = observer.node, []
        node.create_subscription(
            JointState,
            'target_in_force',
            lambda message: announced.append(from_stamp(message.header.stamp)),
            IN_FORCE_QOS,
        )
        parameters = []
        node.create_subscription(
            ParameterEvent, 'parameters_in_force', parameters.append, IN_FORCE_QOS
        )
        setter = node.create_client(
            SetParametersAtomically, '/controller/set_parameters_atomically'
        )
        targets = node.create_publisher(JointState, 'target', TARGET_QOS)
        pause = node.create_client(SetBool, '/simulator/pause')
        step = node.create_client(Trigger, '/simulator/step')

        def ask(client, request):
            observer.wait(client.service_is_ready, 'the node')
            future = client.call_async(request)
            observer.wait(future.done, 'its answer')
            return future.result()

        def call(client, request):
            return ask(client, request).success

        def take_step():  # refused until the state before has been answered
            observer.wait(lambda: call(step, Trigger.Request()), 'a step')

        def send(specification, stamp):
            observer.wait(lambda: targets.get_subscription_count() == 2, 'recorder and controller')
            target = load_target(specification, NETWORK)
            targets.publish(target_message(target, NETWORK.identifier, stamp))
            observer.wait(targets.wait_for_all_acked, 'that they have it')

        nodes = {kind: domain.start_node(kind, made) for kind in ('recorder', 'simulator')}
        assert call(pause, SetBool.Request(data=True))
        nodes |= {kind: domain.start_node(kind, made) for kind in ('encoder', 'controller')}
        for _ in range(CHANGE):
            take_step()
        send('simulation:2@60', 0)
        take_step()
        observer.wait(lambda: len(announced) == 2, 'the new target in force')
        if gains:
            changes = [
                Parameter(name, value=each).to_parameter_msg() for name, each in gains.items()
            ]
            request = SetParametersAtomically.Request(parameters=changes)
            answer = ask(setter, request).result
            assert answer.successful, answer.reason
            take_step()
            observer.wait(lambda: len(parameters) == 2, 'the new gains in force')
            assert {each.name for each in parameters[1].changed_parameters} == set(gains)
        later = announced[-1] + LATER
        send('rest', later)
        assert call(pause, SetBool.Request(data=False))
        observer.wait(lambda: nodes['simulator'].poll() is not None, 'the end of the run')
        observer.wait(lambda: len(announced) == 3, 'the last target in force')
        for kind in ('simulator', 'encoder', 'controller', 'recorder'):
            code, output = domain.stop(nodes[kind])
            assert code == 0, output
        node.destroy_publisher(targets)  # its last one would come to a later controller, too
        assert announced[0] == 0
        assert announced[1] >= CHANGE * 5_000_000
        assert announced[2] == later
        return (made, from_stamp(parameters[1].stamp)) if gains else made

    return run


def test_a_log_run_again_is_identical_in_process_and_over_dds(domain, changing_run, tmp_path):
    gains = {'velocity_weight': 0.1, 'integral_gain': 2.0}
    made, changed = changing_run(gains=gains, integral_gain=0.5, integral_delay=0.2)
    result = rerun(made.bag)
    assert result.is_exact, result.reason
    assert result.is_identical, table(result)
    assert {each.stamps for each in result.deviations} == {STEPS + 1}

    kept = rerun(made.bag, {'controller': {'velocity_weight': 0.03}})  # as it was before
    *_, force = kept.deviations
    assert force.first_stamp_ns == changed

    command = [sys.executable, '-m', 'dpc_ros.cli', 'bag', 'rerun', str(made.bag), '--over-dds']
    done = subprocess.run(
        [*command, '--output', str(tmp_path / 'again')],
        env=domain.environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'identical, bit for bit' in done.stdout
    again = rerun(tmp_path / 'again' / 'bag')
    assert again.is_exact
    assert again.is_identical, table(again)


def test_a_changed_gain_is_found_where_it_first_acts(changing_run, capfd):
    """With an observer, too: its forces are those of the log, whatever the law gives now."""
    made = changing_run(
        encoder={'observer': 'kalman'},
        law='reduced_equilibrium',
        expected_subscribers=['simulator', 'encoder', 'recorder'],
    )
    assert rerun(made.bag).is_identical
    capfd.readouterr()
    with pytest.raises(SystemExit) as end:
        cli.main(['bag', 'rerun', str(made.bag), '--set', 'controller.derivative_gain=1.001'])
    shown, _ = capfd.readouterr()
    assert end.value.code == 1
    rows = dict(re.findall(r'^(latent|latent_velocity|force) +(.*)$', shown, re.M))
    assert rows['latent'].split()[:3] == [str(STEPS + 1), '0', '0']
    assert rows['force'].split()[:2] == [str(STEPS + 1), '0']
    # At rest there is no velocity that the gain could act on: the first state gives the same force.
    assert rows['force'].split()[3] == '0.005'
    assert 'DIFFERENT' in shown
