"""A lockstep run over DDS is the in-process closed loop, bit for bit."""

import csv
import itertools

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.bag import read_run
from dpc_ros.control import ObserverSettings
from dpc_ros.nodes.messages import from_stamp
from dpc_ros.nodes.topics import LOOP_QOS
from dpc_ros.resources import config_path

LOOP = ('simulator', 'encoder', 'controller')
ORDERS = [
    pytest.param(order, id='-'.join(order), marks=[] if order == LOOP[::-1] else pytest.mark.long)
    for order in itertools.permutations(LOOP)
]

# That nodes give the same bits from processes of their own, the demonstration shows in every run.
MODES = [
    pytest.param((), id='processes', marks=pytest.mark.long),
    pytest.param(('--composed',), id='composed'),
]


@pytest.mark.parametrize('mode', [(), ('--composed',)], ids=['processes', 'composed'])
def test_launcher_repeats_the_in_process_loop(domain, tmp_path, assert_repeats, mode):
    code, output = domain.run('launcher', '--output', str(tmp_path / 'run'), *mode)
    assert code == 0, output
    assert_repeats(tmp_path / 'run' / 'bag')
    assert 'final nMSE' in output
    assert (tmp_path / 'run' / 'convergence.png').stat().st_size > 0
    page = tmp_path / 'run' / 'report.html'
    assert f'report      {page.as_uri()}\n\nnetwork ' in output
    assert page.read_text().endswith('</html>\n')


@pytest.mark.parametrize(
    ('checkpoint', 'encoder'),
    [
        pytest.param('paper_2_flat_m2', 'network', marks=pytest.mark.long),
        pytest.param('paper_2_graph_m5', 'network', marks=pytest.mark.long),
        pytest.param('paper_2_pod_m5', 'network', marks=pytest.mark.long),
        ('paper_2_extended_m5', 'projection'),
    ],
)
@pytest.mark.parametrize('mode', MODES)
def test_every_kind_of_encoder_gives_the_same(
    domain, tmp_path, assert_repeats, in_process, checkpoint, encoder, mode
):
    # The law that has no equilibrium to solve for, which takes long with some decoders.
    chosen = [
        f'--set={node}.{name}={value}'
        for node in ('encoder', 'controller')
        for name, value in (('checkpoint', checkpoint), ('encoder', encoder))
    ]
    output_folder = ['--output', str(tmp_path / 'run'), '--duration', '0.25']
    code, output = domain.run('launcher', *output_folder, *chosen, '--law', 'paper', *mode)
    assert code == 0, output
    expected = in_process(checkpoint, encoder, steps=50, law_name='paper')
    assert_repeats(tmp_path / 'run' / 'bag', expected)


@pytest.mark.parametrize(
    'number', [1, *(pytest.param(number, marks=pytest.mark.long) for number in (2, 3, 4, 5))]
)
@pytest.mark.parametrize('mode', MODES)
def test_a_run_of_the_experiment_repeats(
    domain, tmp_path, assert_repeats, in_process, number, mode
):
    """One of the 50 of `dpc paper control`, with integral action beside."""
    with config_path('control', 'paper_targets.csv').open(newline='') as file:
        row = list(csv.DictReader(file))[number - 1]
    assert row['run'] == str(number)
    mass, target = row['actuated_mass'], row['target']
    code, output = domain.run(
        'launcher',
        *('--output', str(tmp_path / 'run'), '--mass', mass, '--target', target),
        *('--law', 'lqr', '--set', 'controller.integral_gain=0.5'),
        *('--set', 'controller.integral_delay=1.0', *mode),
    )
    assert code == 0, output
    expected = in_process(mass=int(mass), target=target, integral_gain=0.5, integral_delay=1.0)
    assert_repeats(tmp_path / 'run' / 'bag', expected)


@pytest.mark.long  # a law of another package is in every run
@pytest.mark.parametrize('law', ['reduced_equilibrium', 'transpose'])
def test_every_law_gives_the_same(domain, tmp_path, assert_repeats, in_process, law):
    output_folder = ['--output', str(tmp_path / 'run'), '--duration', '0.25']
    code, output = domain.run('launcher', *output_folder, '--law', law)
    assert code == 0, output
    assert_repeats(tmp_path / 'run' / 'bag', in_process(steps=50, law_name=law))


@pytest.mark.parametrize('mode', MODES)
def test_a_law_of_another_package_gives_the_same(
    domain, tmp_path, assert_repeats, in_process, spring, mode
):
    arguments = ['--output', str(tmp_path / 'run'), '--duration', '0.25', '--law', spring, *mode]
    arguments += ['--set', 'controller.law_options={stiffness: 5.0}']
    code, output = domain.run('launcher', *arguments)
    assert code == 0, output
    expected = in_process(steps=50, law_name=spring, options={'stiffness': 5.0})
    run = assert_repeats(tmp_path / 'run' / 'bag', expected)
    assert np.abs(run.force).max() > 0


@pytest.mark.parametrize('mode', MODES)
def test_estimates_are_the_same(domain, tmp_path, assert_repeats, in_process, mode):
    """Though DDS keeps no order between forces and configurations; for another mass as well."""
    arguments = ['--output', str(tmp_path / 'run'), '--duration', '0.25', '--mass', '122', *mode]
    arguments += ['--set', 'encoder.observer=kalman', '--set', 'encoder.delay=0.01']
    code, output = domain.run('launcher', *arguments)
    assert code == 0, output
    observer = ObserverSettings(delay=0.01)
    expected = in_process(steps=50, mass=122, observer=observer)
    run = assert_repeats(tmp_path / 'run' / 'bag', expected)
    encoded = load_checkpoint('paper_2_extended_m5').autoencoder().encode(run.configuration)
    assert np.abs(run.latent - encoded).max() > 0
    written = yaml.safe_load((tmp_path / 'run' / 'parameters.yaml').read_text())
    readers = written['/**/controller']['ros__parameters']['expected_subscribers']
    assert 'encoder' in readers  # none of its forces may be missing


@pytest.mark.faults(
    fault='`reset` in mid-run',
    promise='the body begins at rest, and repeats bit for bit what it did from its start',
    mode='lockstep',
    most=10,
)
def test_a_reset_begins_anew(domain, observer, plan, in_process):
    """Law, encoder and observer then do what they did at first, under stamps that rise on."""
    settings = {'law': 'lqr', 'integral_gain': 0.5, 'integral_delay': 0.0}
    made = plan(
        simulator={'duration': 0.0, 'expected_subscribers': ['encoder', 'recorder', 'observer']},
        encoder={'observer': 'kalman', 'delay': 0.01},
        controller={**settings, 'expected_subscribers': ['simulator', 'encoder', 'recorder']},
    )
    stamps = []
    reset = observer.node.create_client(Trigger, 'simulator/reset')
    nodes = {kind: domain.start_node(kind, made) for kind in ('recorder', *LOOP)}
    observer.wait(reset.service_is_ready, 'the service')
    observer.node.create_subscription(
        JointState,
        'configuration',
        lambda message: stamps.append(from_stamp(message.header.stamp)),
        LOOP_QOS,
    )
    observer.wait(lambda: len(set(stamps)) > 40, 'states before the reset')
    called = reset.call_async(Trigger.Request())
    observer.wait(called.done, 'the reset')
    observer.wait(lambda: (np.diff(stamps) >= 10**9).any(), 'the leap')
    leap = stamps[int(np.argmax(np.diff(stamps) >= 10**9)) + 1]
    observer.wait(lambda: stamps[-1] > leap + 50 * 5_000_000, 'states after the reset')
    for kind in (*LOOP, 'recorder'):
        code, output = domain.stop(nodes[kind])
        assert code == 0, output
    run = read_run(made.bag)
    expected = in_process(
        steps=50, observer=ObserverSettings(delay=0.01), integral_gain=0.5, integral_delay=0.0
    )
    for begin in (0, leap):
        for name, its_stamps in (
            ('configuration', run.configuration_stamp),
            ('latent', run.latent_stamp),
            ('force', run.force_stamp),
        ):
            first = int(np.searchsorted(its_stamps, begin))
            np.testing.assert_array_equal(
                its_stamps[first : first + 40], begin + np.arange(40) * 5_000_000
            )
            found = getattr(run, name)[first : first + 40]
            np.testing.assert_array_equal(found, getattr(expected, name)[:40])


@pytest.mark.long
def test_rclpys_own_executor_gives_the_same(domain, tmp_path, assert_repeats, in_process):
    executors = [f'--set={kind}.executor=single_threaded' for kind in (*LOOP, 'recorder')]
    output_folder = ['--output', str(tmp_path / 'run'), '--duration', '0.25']
    code, output = domain.run('launcher', *output_folder, *executors)
    assert code == 0, output
    assert_repeats(tmp_path / 'run' / 'bag', in_process(steps=50))


@pytest.mark.faults(
    fault='every start order',
    promise='the run is bit for bit the one in a single process',
    mode='lockstep',
    most=5,
)
@pytest.mark.parametrize('order', ORDERS)
def test_any_start_order_gives_the_same(domain, observer, plan, assert_repeats, order):
    made = plan(simulator={'duration': 1.0})
    recorder = domain.start_node('recorder', made)
    nodes = {}
    for kind in order:
        nodes[kind] = domain.start_node(kind, made)
        observer.wait_for_node(kind)  # the next one starts only when this one is up
    output, _ = nodes['simulator'].communicate(timeout=120)
    assert nodes['simulator'].returncode == 0, output
    for process in (nodes['encoder'], nodes['controller'], recorder):
        code, output = domain.stop(process)
        assert code == 0, output
    assert_repeats(made.bag, steps=200)


@pytest.mark.long  # one that is killed and comes late again is in every run
@pytest.mark.parametrize('late', ['encoder', 'controller'])
def test_a_late_node_catches_up(domain, observer, plan, assert_repeats, late):
    readers = ['recorder', 'observer']
    made = plan(simulator={'expected_subscribers': readers, 'resend_interval': 0.05})
    seen = []
    observer.node.create_subscription(
        JointState, 'configuration', lambda message: seen.append(message), LOOP_QOS
    )
    recorder = domain.start_node('recorder', made)
    observer.wait_for_node('recorder')
    nodes = {kind: domain.start_node(kind, made) for kind in LOOP if kind != late}
    observer.wait(lambda: len(seen) > 3, 'the first state, published several times')
    assert {message.header.stamp.nanosec for message in seen} == {0}
    nodes[late] = domain.start_node(late, made)
    observer.wait(lambda: nodes['simulator'].poll() is not None, 'the end of the run')
    assert nodes['simulator'].returncode == 0, nodes['simulator'].stdout.read()
    for process in (nodes['encoder'], nodes['controller'], recorder):
        code, output = domain.stop(process)
        assert code == 0, output
    run = assert_repeats(made.bag)
    assert run.repeats['/configuration'] > 0


def test_an_independent_reader_finds_every_message_in_order(domain, tmp_path):
    code, output = domain.run(
        'launcher', '--output', str(tmp_path / 'run'), '--duration', '1', '--composed'
    )
    assert code == 0, output
    stamps = {}
    with AnyReader([tmp_path / 'run' / 'bag']) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            stamp = getattr(message, 'header', message).stamp  # a parameter event has no header
            stamps.setdefault(connection.topic, []).append(stamp.sec * 10**9 + stamp.nanosec)
    expected = [step * 5_000_000 for step in range(201)]
    assert stamps['/target'] == stamps['/parameters_in_force'] == [0]
    for topic in ('/configuration', '/latent_state', '/control_force'):
        # A state that was answered late is there twice, one after the other.
        assert [stamp for stamp, _ in itertools.groupby(stamps[topic])] == expected
