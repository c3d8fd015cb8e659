"""Realtime mode, nodes started by hand, and stopping."""

import itertools
import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState

from dpc_ros.bag import read_run
from dpc_ros.bag.convergence import analyse
from dpc_ros.nodes.topics import LOOP_QOS
from dpc_ros.resources import config_path

LOOP = ('simulator', 'encoder', 'controller')
REALTIME = ('--ros-args', '--params-file', str(config_path('realtime.yaml')))
ORDERS = [
    pytest.param(order, id='-'.join(order), marks=[] if order == LOOP[::-1] else pytest.mark.long)
    for order in itertools.permutations(LOOP)
]
# A recorder's subscriptions may be found later than those of the loop.
READERS = {
    'simulator': '[encoder, recorder]',
    'encoder': '[controller, recorder]',
    'controller': '[simulator, recorder]',
}


@pytest.mark.faults(
    fault='every start order',
    promise='nothing is lost, the body converges',
    mode='realtime',
    most=5,
)
@pytest.mark.parametrize('order', ORDERS)
def test_nodes_started_by_hand_converge_in_any_order(
    domain, observer, tmp_path, order, assert_nothing_lost
):
    recorder = domain.start('recorder_node', '--ros-args', '-p', f'bag:={tmp_path / "bag"}')
    observer.wait_for_node('recorder')
    nodes = {}
    for kind in order:
        readers = ('-p', f'expected_subscribers:={READERS[kind]}')
        nodes[kind] = domain.start(f'{kind}_node', *REALTIME, *readers)
        observer.wait_for_node(kind)
    output, _ = nodes['simulator'].communicate(timeout=120)
    assert nodes['simulator'].returncode == 0, output
    for process in (nodes['encoder'], nodes['controller'], recorder):
        code, output = domain.stop(process)
        assert code == 0, output
    run = assert_nothing_lost(tmp_path / 'bag')
    np.testing.assert_array_equal(run.configuration_stamp, np.arange(1001) * 5_000_000)
    convergence = analyse(run)
    # What no control does is 1; a delayed force may cost an order over lockstep's 3e-4, not more.
    assert convergence.final_nmse < 0.05


@pytest.mark.parametrize(
    'mode',
    [
        pytest.param((), id='processes', marks=pytest.mark.long),
        pytest.param(('--composed',), id='composed'),
        pytest.param(('--realtime',), id='realtime'),
    ],
)
def test_ctrl_c_ends_the_launcher_cleanly_and_keeps_the_log(domain, observer, tmp_path, mode):
    seen = []
    observer.node.create_subscription(JointState, 'configuration', seen.append, LOOP_QOS)
    launcher = domain.start('launcher', '--output', str(tmp_path / 'run'), '--duration', '0', *mode)
    observer.wait(lambda: len(seen) > 100, 'a running loop')
    launcher.send_signal(signal.SIGINT)
    observer.wait(lambda: launcher.poll() is not None, 'the launcher to end')
    assert launcher.returncode == 130, launcher.stdout.read()
    observer.wait(lambda: observer.node.get_node_names() == ['observer'], 'the nodes to have gone')
    run = read_run(tmp_path / 'run' / 'bag')
    published = {(message.header.stamp.sec, message.header.stamp.nanosec) for message in seen}
    assert len(run.configuration) >= len(published) - 1 > 50
    assert not any(run.losses.values())


def test_a_recorder_ends_beside_a_running_loop(domain, observer, plan, tmp_path):
    # The simulator waits for the recorder's subscription: a fast loop would outrun its discovery.
    readers = ['encoder', 'recorder']
    made = plan(record=False, simulator={'duration': 0.0, 'expected_subscribers': readers})
    seen = []
    observer.node.create_subscription(JointState, 'configuration', seen.append, LOOP_QOS)
    recorder = domain.start('recorder_node', '--ros-args', '-p', f'bag:={tmp_path / "bag"}')
    observer.wait_for_node('recorder')
    for kind in LOOP:
        domain.start_node(kind, made)
    observer.wait(lambda: len(seen) > 100, 'a running loop')
    recorder.send_signal(signal.SIGINT)
    before = len(seen)
    observer.wait(lambda: recorder.poll() is not None, 'the recorder to end')
    assert recorder.returncode == 0, recorder.stdout.read()
    observer.wait(lambda: len(seen) > before + 100, 'the loop to go on')
    assert len(read_run(tmp_path / 'bag').configuration) > 0


def test_without_a_controller_a_realtime_body_is_left_alone(domain, observer, plan):
    made = plan(
        record=False,
        simulator={
            'time_mode': 'realtime',
            'expected_subscribers': ['observer'],
            'duration': 0.0,
            'force_timeout': 0.05,
        },
    )
    states = []
    observer.node.create_subscription(JointState, 'configuration', states.append, LOOP_QOS)
    force = observer.node.create_publisher(WrenchStamped, 'control_force', LOOP_QOS)
    simulator = domain.start_node('simulator', made)
    observer.wait(lambda: states and force.get_subscription_count(), 'the first state')
    message = WrenchStamped()
    message.header.frame_id = 'mass_162'
    message.wrench.force.x = 1.0
    force.publish(message)  # one force, and silence: the watchdog takes it away
    observer.wait(lambda: len(states) > 400, 'two seconds without a force')
    code, output = domain.stop(simulator)
    assert code == 0, output
    assert 'stale' in output
    early = np.abs(states[5].velocity).max()
    late = np.abs(states[-1].velocity).max()
    assert early > 0
    assert np.isfinite(late)


def test_the_delay_of_the_loop_is_measured(domain, observer, tmp_path):
    values = {}

    def take(message):
        for status in message.status:
            if status.name == 'encoder':
                values.update({pair.key: pair.value for pair in status.values})

    observer.node.create_subscription(DiagnosticArray, '/diagnostics', take, 10)
    chosen = [f'--set=encoder.{value}' for value in ('observer=kalman', 'measure_delay=true')]
    output = ['--output', str(tmp_path / 'run'), '--no-record']
    launcher = domain.start('launcher', *output, '--realtime', '--duration', '0', *chosen)
    observer.wait(lambda: 'measured delay [ms]' in values, 'a measured delay')
    launcher.send_signal(signal.SIGINT)
    observer.wait(lambda: launcher.poll() is not None, 'the launcher to end')
    assert launcher.returncode == 130, launcher.stdout.read()
    measured = float(values['measured delay [ms]'])
    foreseen = float(values['foreseen delay [ms]'])
    assert 0 < measured < np.inf
    assert foreseen % 5 == pytest.approx(0, abs=1e-6)  # whole control steps
    assert foreseen <= measured + 5
