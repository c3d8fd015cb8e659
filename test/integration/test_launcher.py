"""Nodes through their lifecycle, and the launcher that starts, watches and ends them."""

import contextlib
import os
import signal
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import psutil
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from process_state import is_gone
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from dpc_ros.bag import read_run
from dpc_ros.bag.mcap_file import read_messages
from dpc_ros.bag.repair import repair
from dpc_ros.network import Body, Integrator, Mechanics, load_network
from dpc_ros.nodes.health import PROCESS_READING
from dpc_ros.nodes.markers_node import MARKERS
from dpc_ros.nodes.messages import from_stamp
from dpc_ros.nodes.program import PARENT_VARIABLE
from dpc_ros.nodes.topics import IN_FORCE_QOS, LOOP_QOS, TARGET_QOS
from dpc_ros.resources import config_path

GIVE_UP = 120.0  # s after which a test stops waiting
SAMPLE = Path(__file__).parents[2] / 'bags' / 'demo_1s'
LOOP = ('simulator', 'encoder', 'controller')
NODES = ('recorder', *LOOP)
CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
DEACTIVATE, CLEANUP = Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP
COMMON_SERVICES = (
    *('change_state', 'get_state', 'get_available_states', 'get_available_transitions'),
    *('get_transition_graph', 'describe_parameters', 'get_parameter_types', 'get_parameters'),
    *('list_parameters', 'set_parameters', 'set_parameters_atomically', 'get_type_description'),
)


class Lifecycle:
    """The lifecycle services of nodes, as `ros2 lifecycle` calls them."""

    def __init__(self, observer, *names):
        self.observer = observer
        self.changes = {
            n: observer.node.create_client(ChangeState, f'{n}/change_state') for n in names
        }
        self.states = {n: observer.node.create_client(GetState, f'{n}/get_state') for n in names}
        clients = [*self.changes.values(), *self.states.values()]
        observer.wait(
            lambda: all(each.service_is_ready() for each in clients), 'lifecycle services'
        )

    def call(self, client, request):
        called = client.call_async(request)
        self.observer.wait(called.done, 'an answer')
        return called.result()

    def change(self, name, transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.call(self.changes[name], request).success

    def change_all(self, transition):
        for name in self.changes:
            assert self.change(name, transition), f'{name}: {transition}'

    def state(self, name):
        return self.call(self.states[name], GetState.Request()).current_state.label

    def go_round(self, stamps):
        """Configure, run, hold, run on, and let go of everything."""
        self.change_all(CONFIGURE)
        self.change_all(ACTIVATE)
        advance(self.observer, stamps)
        self.change_all(DEACTIVATE)
        newest = stamps[-1]
        self.change_all(ACTIVATE)
        self.observer.wait(lambda: stamps[-1] > newest, 'the motion to go on')
        self.change_all(DEACTIVATE)
        self.change_all(CLEANUP)
        for name in self.changes:
            self.observer.wait(
                lambda: not configured_part(self.observer, name),  # noqa: B023
                f'{name} to have let go of its topics',
            )


def held_by(process):
    """Return what a process holds: its threads, and its open files without what they stand for."""
    folder = Path(f'/proc/{process.pid}')
    return len([*folder.joinpath('task').iterdir()]), len([*folder.joinpath('fd').iterdir()])


def configured_part(observer, name):
    """Return the topics and services that a node has beside those of every node."""
    node = observer.node
    found = [
        *node.get_publisher_names_and_types_by_node(name, '/'),
        *node.get_subscriber_names_and_types_by_node(name, '/'),
        *node.get_service_names_and_types_by_node(name, '/'),
    ]
    common = {'/diagnostics', '/parameter_events', '/rosout', f'/{name}/transition_event'}
    common |= {f'/{name}/{service}' for service in COMMON_SERVICES}
    return {topic for topic, _ in found} - common


def advance(observer, stamps, steps=20):
    """Wait until the newest motion has gone on by some steps."""
    begin = len(stamps)
    observer.wait(lambda: len(set(stamps[begin:])) > steps, 'a running loop')


def test_every_node_goes_through_its_lifecycle(domain, observer, plan, tmp_path, in_process):
    network = tmp_path / 'paper_2.json'
    content = config_path('systems', 'paper_2.json').read_text()
    waits = {'autostart': False, 'network': str(network)}
    made = plan(
        recorder={'autostart': False},
        simulator={**waits, 'publish_clock': True, 'duration': 0.0},
        encoder=waits,
        controller=waits,
    )
    stamps = []
    observer.node.create_subscription(
        JointState, 'configuration', lambda m: stamps.append(from_stamp(m.header.stamp)), LOOP_QOS
    )
    processes = {kind: domain.start_node(kind, made) for kind in NODES}
    nodes = Lifecycle(observer, *NODES)
    for name in NODES:
        assert not nodes.change(name, ACTIVATE)  # there is no such transition yet
        assert nodes.state(name) == 'unconfigured'
        if name in LOOP:
            assert not nodes.change(name, CONFIGURE)  # without the file of the network
        assert nodes.state(name) == 'unconfigured'
    network.write_text(content)

    held = []
    for _ in range(2):
        nodes.go_round(stamps)
        held.append([held_by(processes[name]) for name in NODES])
    assert held[1] == held[0]
    falls = [index for index in range(1, len(stamps)) if stamps[index] < stamps[index - 1]]
    assert [stamps[index] for index in falls] == [0]  # each configuration begins an epoch

    nodes.change_all(CONFIGURE)
    nodes.change_all(ACTIVATE)
    advance(observer, stamps)
    for name in (*LOOP, 'recorder'):
        assert nodes.change(name, Transition.TRANSITION_ACTIVE_SHUTDOWN)
        output, _ = processes[name].communicate(timeout=GIVE_UP)
        assert processes[name].returncode == 0, output
        assert 'Traceback' not in output
    expected = in_process(steps=15)
    for bag in ('bag', 'bag_1', 'bag_2'):
        run = read_run(made.folder / bag)
        np.testing.assert_array_equal(run.force[:15], expected.force[:15])

    log = f'bag:={made.folder / "bag"}'
    readers = 'expected_subscribers:=[observer]'
    player = domain.start('player_node', *ros_parameters('autostart:=false', log, readers))
    node = Lifecycle(observer, 'player')
    held = []
    for _ in range(2):
        node.go_round(stamps)
        held.append(held_by(player))
    assert held[1] == held[0]
    code, output = domain.stop(player)
    assert code == 0, output


def ros_parameters(*values):
    return ['--ros-args', *(part for value in values for part in ('-p', value))]


FAULTY = """
import sys
from dpc_ros.nodes.encoder_node import EncoderNode
from dpc_ros.nodes.loop_node import run_node

class Faulty(EncoderNode):
    faults = 1

    def activate(self):
        Faulty.faults -= 1
        if Faulty.faults == 0:
            raise ZeroDivisionError('a fault')
        super().activate()

sys.exit(run_node(Faulty))
"""


def test_an_error_in_a_transition_leaves_nothing_configured(domain, observer):
    process = domain.start_script(FAULTY, *ros_parameters('autostart:=false'))
    node = Lifecycle(observer, 'encoder')
    node.change_all(CONFIGURE)
    assert not node.change('encoder', ACTIVATE)
    assert node.state('encoder') == 'unconfigured'
    observer.wait(lambda: not configured_part(observer, 'encoder'), 'the clean-up')
    node.change_all(CONFIGURE)
    node.change_all(ACTIVATE)
    code, output = domain.stop(process)
    assert code == 0, output
    assert 'ZeroDivisionError: a fault' in output


def test_an_error_at_the_start_is_a_crash(domain):
    process = domain.start_script(FAULTY)
    output, _ = process.communicate(timeout=GIVE_UP)
    assert process.returncode == os.EX_SOFTWARE, output
    assert output.splitlines()[-1] == 'error: encoder: unexpected ZeroDivisionError: a fault'


WATCHED = """
import gc
import sys
from importlib import import_module

from numba.core.dispatcher import Dispatcher

from dpc_ros.nodes.loop_node import run_node

kind = sys.argv.pop(1)
node_class = getattr(import_module(f'dpc_ros.nodes.{kind}_node'), f'{kind.capitalize()}Node')

def loaded():
    compiled = [each for each in gc.get_objects() if isinstance(each, Dispatcher)]
    return {*sys.modules, *((str(each), len(each.overloads)) for each in compiled)}

class Watched(node_class):
    def on_activate(self, state):
        result = super().on_activate(state)
        self.loaded = loaded()
        return result

    def finish(self):
        super().finish()
        print('loaded late:', loaded() - self.loaded)

sys.exit(run_node(Watched))
"""


def test_nothing_is_imported_or_compiled_once_a_node_is_active(domain, plan):
    """A callback that does takes longer than a step, and holds up the loop."""
    made = plan(simulator={'duration': 0.2}, encoder={'observer': 'kalman'})
    arguments = made.ros_arguments()
    nodes = {kind: domain.start_script(WATCHED, kind, *arguments) for kind in NODES}
    output = {'simulator': nodes['simulator'].communicate(timeout=GIVE_UP)[0]}
    output |= {kind: domain.stop(nodes[kind])[1] for kind in ('encoder', 'controller', 'recorder')}
    for kind in NODES:
        assert nodes[kind].returncode == 0, output[kind]
        assert 'loaded late: set()' in output[kind]


class Launched:
    """A launcher and the nodes that it starts, as their reports and topics show them."""

    def __init__(self, domain, observer, folder, *arguments):
        self.domain, self.observer, self.folder = domain, observer, folder
        self.processes = {}
        self.stamps = []
        self.output = ''
        node = observer.node
        node.create_subscription(DiagnosticArray, '/diagnostics', self._take_report, 10)
        # The run begins when the observer is there, and not before.
        readers = '[encoder, recorder, launcher, observer]'
        self.launcher = domain.start(
            'launcher',
            *('--output', str(folder), '--set', f'simulator.expected_subscribers={readers}'),
            *arguments,
        )

    def begin(self, *names):
        """Let the run begin once nodes have reported."""
        for name in names:
            self.wait(lambda: name in self.processes, f'a report of {name}')  # noqa: B023
        self.observer.node.create_subscription(
            JointState, 'configuration', self._take_state, LOOP_QOS
        )

    def _take_report(self, message):
        for status in message.status:
            values = {each.key: each.value for each in status.values}
            self.processes[status.name] = int(values[PROCESS_READING])

    def _take_state(self, message):
        self.stamps.append(from_stamp(message.header.stamp))

    def wait(self, condition, what):
        self.observer.wait(lambda: condition() or self.has_ended(), what)
        assert not self.has_ended(), self.end()

    def signal(self, name, number):
        """Send a node a signal once it has reported; if it ends it, another will report."""
        self.wait(lambda: name in self.processes, f'a report of {name}')
        process = self.processes.pop(name)
        os.kill(process, number)
        return process

    def wait_for_another(self, name, process):
        self.wait(lambda: self.processes.get(name, process) != process, f'another {name}')

    def end(self):
        self.observer.wait(lambda: self.has_said('') and self.has_ended(), 'the end of the run')
        self.has_said('')
        return self.launcher.returncode, self.output

    def has_ended(self):
        return self.launcher.poll() is not None

    def has_said(self, text):
        """Return whether a text was among what has been shown so far."""
        os.set_blocking(self.launcher.stdout.fileno(), False)
        with contextlib.suppress(BlockingIOError):
            while part := os.read(self.launcher.stdout.fileno(), 4096):
                self.output += part.decode()
        return text in self.output

    def nodes(self, kind=''):
        """Return those that the launcher has started, of a kind, and that have not ended."""
        mark = f'{PARENT_VARIABLE}={self.launcher.pid}'.encode()
        program = f'dpc_ros.nodes.{kind}_node'.encode() if kind else b''
        found = []
        for environment in Path('/proc').glob('[0-9]*/environ'):
            with contextlib.suppress(OSError):
                command = environment.with_name('cmdline').read_bytes()
                if mark in environment.read_bytes().split(b'\0') and program in command:
                    found.append(int(environment.parent.name))
        return found

    def assert_nothing_is_left(self):
        assert not self.nodes()
        self.domain.assert_memory_is_clean()


@pytest.mark.faults(
    fault='a node of the launcher crashes or hangs',
    promise='started anew, said on the terminal; the run ends bit for bit as without',
    mode='lockstep',
    most=5,
)
def test_nodes_that_crash_or_hang_are_started_anew(domain, observer, tmp_path, assert_repeats):
    """In lockstep nothing shows it afterwards. A companion has restarts of its own."""
    repeat = '--set=simulator.resend_interval=0.05'
    options = ('--duration', '2', '--silence', '2', repeat, '--markers')
    run = Launched(domain, observer, tmp_path / 'run', *options)
    run.begin('encoder', 'controller', 'markers')
    run.wait(lambda: len(run.stamps) > 2, 'the first steps')
    run.signal('encoder', signal.SIGSTOP)
    run.signal('controller', signal.SIGKILL)
    run.signal('markers', signal.SIGKILL)
    code, output = run.end()
    assert code == 0, output
    assert_repeats(tmp_path / 'run' / 'bag', steps=400, killed=('latent', 'force'))
    assert 'controller was ended by SIGKILL: started anew (1 of 3)' in output
    assert 'markers was ended by SIGKILL: started anew (1 of 3)' in output
    assert 'encoder was killed: it has not reported' in output
    assert 'restarts    controller 1, encoder 1, markers 1\n' in output
    log = (tmp_path / 'run' / 'log' / 'encoder.log').read_text()
    assert log.count('configured') == 2


@pytest.mark.faults(
    fault='a companion of the launcher, the markers node, crashes more often than `--restarts`',
    promise='given up, said on the terminal; the run ends bit for bit as without',
    mode='lockstep',
    most=5,
)
@pytest.mark.long
def test_a_companion_that_crashes_is_no_matter_to_the_run(
    domain, observer, tmp_path, assert_repeats
):
    options = ('--markers', '--restarts', '1')
    run = Launched(domain, observer, tmp_path / 'run', *options)
    run.wait(lambda: run.nodes('markers'), 'the companion')
    (first,) = run.nodes('markers')
    os.kill(first, signal.SIGKILL)
    pictures = []
    observer.node.create_subscription(MarkerArray, 'markers', pictures.append, MARKERS.qos)
    run.wait(lambda: pictures, 'markers of what holds the body')
    run.signal('markers', signal.SIGKILL)
    run.wait(lambda: run.has_said('the run goes on without it'), 'the companion to be given up')
    run.begin()
    code, output = run.end()
    assert code == 0, output
    assert_repeats(tmp_path / 'run' / 'bag')
    assert 'markers was ended by SIGKILL: started anew (1 of 1)' in output
    assert 'markers was ended by SIGKILL, and --restarts 1 allows no more; the run goes' in output
    assert 'restarts    markers 1\n' in output
    run.assert_nothing_is_left()


ELSEWHERE = """
hosts:
  brain:
    nodes: [{node}]
    command: [env]
    python: {python}
    folder: {folder}
    environment: {{ROS_STATIC_PEERS: 127.0.0.1}}
  disk:
    nodes: [recorder]
    command: [env, SHELL=/bin/sh]
    python: {python}
    folder: {folder}
    environment: {{OMP_NUM_THREADS: 2}}
"""


@pytest.fixture
def there(tmp_path):
    """The folder for runs on other hosts: what is reached by a command need not be far away."""
    return tmp_path / 'there'


@pytest.fixture
def elsewhere(tmp_path, there):
    """Return a function: a node, with the recorder elsewhere → options of the demonstration."""

    def options(node='controller'):
        config = tmp_path / 'hosts.yaml'
        hosts = ELSEWHERE.format(node=node, python=sys.executable, folder=there)
        config.write_text(config_path('demo.yaml').read_text() + hosts)
        return '--config', str(config)

    return options


def test_nodes_on_other_hosts_are_looked_after_as_those_here(
    domain, observer, tmp_path, there, elsewhere, assert_repeats
):
    options = (*elsewhere(), '--duration', '1', '--set=simulator.resend_interval=0.05')
    run = Launched(domain, observer, tmp_path / 'run', *options)
    run.begin('controller', 'recorder')
    run.wait(lambda: len(run.stamps) > 2, 'the first steps')
    assert 'OMP_NUM_THREADS=2' in environment_of(run, 'recorder')
    run.signal('controller', signal.SIGKILL)
    code, output = run.end()
    assert code == 0, output
    assert_repeats(there / 'run' / 'bag', steps=200, killed=('force',))
    assert 'controller was ended by SIGKILL: started anew (1 of 3)' in output
    assert f'log         disk:{there}/run/bag\n' in output


@pytest.mark.faults(
    fault='on another host, the recorder crashes twice and the encoder hangs',
    promise='started anew as here; further logs hold what follows',
    mode='lockstep',
    most=5,
)
@pytest.mark.long
def test_nodes_on_other_hosts_crash_and_hang_again_and_again(
    domain, observer, tmp_path, there, elsewhere
):
    options = (*elsewhere('encoder'), '--duration', '0', '--silence', '3', '--restarts', '5')
    run = Launched(domain, observer, tmp_path / 'run', *options)
    run.begin('encoder', 'recorder')
    for _ in range(2):
        killed = run.signal('recorder', signal.SIGKILL)
        run.wait_for_another('recorder', killed)
    stopped = run.signal('encoder', signal.SIGSTOP)
    run.wait_for_another('encoder', stopped)
    advance(observer, run.stamps)
    run.launcher.send_signal(signal.SIGINT)
    code, output = run.end()
    assert code == 130, output
    assert f'what follows is recorded in disk:{there}/run/bag_2' in output
    assert 'encoder was killed: it has not reported' in output
    assert len(read_run(there / 'run' / 'bag_2').configuration) > 20
    for bag in ('bag', 'bag_1'):
        repair(there / 'run' / bag, tmp_path / bag)


def test_ctrl_c_ends_nodes_on_other_hosts_and_keeps_their_log(
    domain, observer, tmp_path, there, elsewhere
):
    run = Launched(domain, observer, tmp_path / 'run', *elsewhere(), '--duration', '0')
    run.begin(*NODES)
    advance(observer, run.stamps)
    run.launcher.send_signal(signal.SIGINT)
    code, output = run.end()
    assert code == 130, output
    assert len(read_run(there / 'run' / 'bag').configuration) > 20
    logs = [log.read_text() for log in (tmp_path / 'run' / 'log').iterdir()]
    assert 'Traceback' not in '\n'.join([output, *logs])
    assert all(map(is_gone, run.processes.values()))
    run.assert_nothing_is_left()


def test_where_the_link_to_a_host_ends_the_run_does(domain, observer, tmp_path, there, elsewhere):
    """As where ssh ends; the node there ends by itself, as what had started it is gone."""
    run = Launched(domain, observer, tmp_path / 'run', *elsewhere(), '--duration', '0')
    run.begin(*NODES)
    advance(observer, run.stamps)
    psutil.Process(run.processes['controller']).parent().kill()
    code, output = run.end()
    assert code == 255, output
    assert 'error: controller: the link to brain ended: ' in output
    assert len(read_run(there / 'run' / 'bag').configuration) > 20
    observer.wait(lambda: all(map(is_gone, run.processes.values())), 'the end of the nodes')
    run.assert_nothing_is_left()


@pytest.mark.parametrize('options', [[], ['--composed']], ids=['processes', 'composed'])
def test_a_log_is_whole_though_nobody_reads_what_the_launcher_says(
    domain, observer, tmp_path, options
):
    run = Launched(domain, observer, tmp_path / 'run', '--duration', '0', *options)
    run.begin()
    advance(observer, run.stamps)
    run.launcher.stdout.close()  # where its bar goes
    observer.wait(run.has_ended, 'the end of the run')
    assert run.launcher.returncode not in (0, 130)
    assert len(read_run(tmp_path / 'run' / 'bag').configuration) > 20
    run.assert_nothing_is_left()


def environment_of(run, name):
    content = Path(f'/proc/{run.processes[name]}/environ').read_text()
    return content.split('\0')


@pytest.mark.faults(
    fault='the launcher is killed (`kill -9`)',
    promise='its nodes end, those on other hosts, too',
    mode='both',
    most=5,
)
@pytest.mark.long
def test_nodes_end_with_a_launcher_that_was_killed(domain, observer, tmp_path, there, elsewhere):
    run = Launched(domain, observer, tmp_path / 'run', *elsewhere(), '--duration', '0')
    run.begin(*NODES)
    run.wait(lambda: len(run.stamps) > 2, 'the first steps')
    domain.kill(run.launcher)
    observer.wait(lambda: observer.node.get_node_names() == ['observer'], 'the nodes to have gone')
    assert read_run(there / 'run' / 'bag').configuration.size


@pytest.mark.faults(
    fault='recorder or simulator of the launcher crashes',
    promise='started anew; the first log can be repaired, a second one holds what follows',
    mode='realtime',
    most=5,
)
@pytest.mark.long
def test_a_recorder_and_a_simulator_that_crash(domain, observer, tmp_path):
    run = Launched(domain, observer, tmp_path / 'run', '--duration', '0', '--realtime')
    run.begin()
    advance(observer, run.stamps)
    run.wait_for_another('recorder', run.signal('recorder', signal.SIGKILL))
    run.signal('simulator', signal.SIGKILL)
    run.wait(lambda: run.stamps[-1] < run.stamps[-2], 'the motion to begin again')
    advance(observer, run.stamps)
    run.launcher.send_signal(signal.SIGINT)
    code, output = run.end()
    assert code == 130, output
    bags = [tmp_path / 'run' / name for name in ('bag', 'bag_1')]
    assert f'what follows is recorded in {bags[1]}' in output
    assert 'the body begins again at rest' in output
    assert 'restarts: recorder 1, simulator 1' in output
    repair(bags[0], tmp_path / 'repaired')
    assert len(read_run(tmp_path / 'repaired').configuration) > 0
    logged = read_messages(bags[1], {'/configuration'})
    stamps = [from_stamp(message.content.header.stamp) for message in logged]
    # The new recorder may have met the first simulator, or not. The second one waits for it: of its
    # motion none is missing, and a state may be there again until it is answered.
    new = [k for k, (before, after) in enumerate(pairwise(stamps), 1) if after < before]
    motion = stamps[new[0] :] if new else stamps
    assert motion == sorted(motion)
    steps = sorted(set(motion))
    assert steps
    assert steps == [5_000_000 * step for step in range(len(steps))]


@pytest.mark.long
@pytest.mark.faults(
    fault='a node crashes more often than `--restarts`',
    promise='the body ends under no force, exit code 1, the log is whole',
    mode='realtime',
    most=5,
)
def test_after_too_many_crashes_the_body_is_under_no_force(domain, observer, tmp_path):
    """Up to then a controller that is started anew goes on with the target that was in force."""
    options = ('--duration', '0', '--realtime', '--restarts', '1')
    run = Launched(domain, observer, tmp_path / 'run', *options)
    run.begin()
    in_force = []
    take = in_force.append
    observer.node.create_subscription(JointState, 'target_in_force', take, IN_FORCE_QOS)
    target = observer.node.create_publisher(JointState, 'target', TARGET_QOS)
    given = load_network('paper_2').rest_configuration
    observer.wait(lambda: in_force, 'the first target')
    target.publish(JointState(position=[*given]))
    observer.wait(lambda: len(in_force) > 1, 'another target')
    observer.node.destroy_publisher(target)
    run.wait_for_another('controller', run.signal('controller', signal.SIGKILL))
    observer.wait(lambda: len(in_force) > 2, 'the target of the new controller')
    np.testing.assert_array_equal(in_force[-1].position, given)
    run.signal('controller', signal.SIGKILL)
    code, output = run.end()
    assert code == 1, output
    assert '--restarts 1 allows no more' in output
    logged = read_run(tmp_path / 'run' / 'bag')
    assert logged.configuration_stamp[-1] > logged.force_stamp[-1]
    integrator = Integrator(Mechanics(load_network('paper_2')), 0.005)
    body = Body(integrator, 162, logged.configuration[-2], logged.velocity[-2])
    body.advance(np.zeros(2))
    np.testing.assert_array_equal(body.configuration, logged.configuration[-1])


@pytest.mark.long
def test_a_log_is_whole_though_a_node_does_not_stop(domain, observer, tmp_path):
    run = Launched(domain, observer, tmp_path / 'run', '--duration', '0', '--silence', '0')
    run.begin('encoder')
    advance(observer, run.stamps)
    run.signal('encoder', signal.SIGSTOP)
    run.launcher.send_signal(signal.SIGINT)
    code, output = run.end()
    assert code == 1, output
    assert 'encoder was ended by SIGKILL' in output
    assert len(read_run(tmp_path / 'run' / 'bag').configuration) > 0


IMPORTS = 'multiarray_umath'  # a library of numpy's, early among those of a program


def maps(process):
    try:
        return Path(f'/proc/{process.pid}/maps').read_text()
    except OSError:
        return ''


def has_sockets(process):
    """Return whether a process has those of DDS: for discovery, and for messages."""
    try:
        files = [os.readlink(each) for each in Path(f'/proc/{process.pid}/fd').iterdir()]
    except OSError:
        return False
    return sum(file.startswith('socket:') for file in files) > 1


MILESTONES = {
    'imports': lambda run: IMPORTS in maps(run.launcher),
    'ros': lambda run: '_rclpy_pybind11' in maps(run.launcher),
    'plan': lambda run: (run.folder / 'parameters.yaml').exists(),
    'node processes': lambda run: (run.folder / 'log' / 'controller.log').exists(),
    'sockets': lambda run: has_sockets(run.launcher),
    'bag': lambda run: (run.folder / 'bag').exists(),
    'first state': lambda run: bool(run.stamps),
}


@pytest.mark.faults(
    fault='Ctrl-C at each moment of start-up, and twice',
    promise='exit code 130, no traceback, no process and no shared memory left',
    mode='lockstep',
    most=5,
)
@pytest.mark.parametrize(
    'milestone',
    [
        pytest.param(each, marks=[] if each in ('imports', 'node processes') else pytest.mark.long)
        for each in MILESTONES
    ],
)
def test_ctrl_c_ends_the_launcher_at_any_time(domain, observer, tmp_path, milestone):
    """With one more while it is finishing, if it gets that far."""
    run = Launched(domain, observer, tmp_path / 'run', '--duration', '0')
    run.begin()
    run.wait(lambda: MILESTONES[milestone](run), milestone)
    run.launcher.send_signal(signal.SIGINT)
    run.observer.wait(lambda: run.has_said('finishing') or run.has_ended(), 'the end')
    run.launcher.send_signal(signal.SIGINT)
    code, output = run.end()
    assert code == 130, output
    logs = [log.read_text() for log in (tmp_path / 'run').glob('log/*.log')]
    assert 'Traceback' not in '\n'.join([output, *logs])
    assert 'KeyboardInterrupt' not in '\n'.join([output, *logs])
    run.assert_nothing_is_left()


NODE_MILESTONES = {
    'imports': lambda process: IMPORTS in maps(process),
    'ros': lambda process: '_rclpy_pybind11' in maps(process),
    'middleware': lambda process: 'librmw_fastrtps' in maps(process),
    'sockets': has_sockets,
}


@pytest.mark.faults(
    fault='Ctrl-C at each moment of a node’s start-up, twice',
    promise='exit code 0, no traceback, no shared memory left',
    mode='both',
    most=5,
)
@pytest.mark.parametrize('milestone', NODE_MILESTONES)
def test_ctrl_c_ends_a_node_at_any_time(domain, observer, tmp_path, milestone):
    running = {
        kind: domain.start(
            f'{kind}_node', *ros_parameters(f'bag:={bag}', 'expected_subscribers:=[nobody]')
        )
        for kind, bag in (*((kind, tmp_path / 'bag') for kind in NODES), ('player', SAMPLE))
    }
    while running:
        for kind, process in [*running.items()]:
            if NODE_MILESTONES[milestone](process) or process.poll() is not None:
                process.send_signal(signal.SIGINT)
                process.send_signal(signal.SIGINT)
                del running[kind]
    for process in domain.processes:
        output, _ = process.communicate(timeout=GIVE_UP)
        assert process.returncode == 0, output
        assert 'Traceback' not in output
    domain.assert_memory_is_clean()


COMPOSED = """
import gc
import sys
import time
from pathlib import Path

from dpc_ros.nodes.launch_plan import make_plan
from dpc_ros.nodes.launcher import launch
from dpc_ros.resources import config_path

def count(folder):
    return len([*Path('/proc/self', folder).iterdir()])

for cycle in range(int(sys.argv[1])):
    folder = Path(sys.argv[2], f'composed_{cycle}')
    plan = make_plan(config_path('demo.yaml'), {'simulator': {'duration': 0.05}}, folder)
    plan.write()
    assert launch(plan, composed=True) == 0
    gc.collect()
    if not cycle:
        threads = count('task')
    deadline = time.monotonic() + 60
    while count('task') > threads and time.monotonic() < deadline:  # one may be about to end
        time.sleep(0.05)
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    print('cycle', count('task'), count('fd'), pages, flush=True)
"""


MANY = 100
LONG = (pytest.mark.long, pytest.mark.timeout(3600))
PAGE = os.sysconf('SC_PAGE_SIZE')
LARGEST_GROWTH = 4 * 2**20  # bytes, over all cycles but the first ones
FIRST = 3  # cycles, by the end of which everything has been used once


@pytest.mark.parametrize('cycles', [pytest.param(MANY, marks=LONG)])
def test_starting_and_stopping_leaves_nothing(domain, observer, tmp_path, cycles, kept_promise):
    for cycle in range(cycles):
        folder = tmp_path / f'run_{cycle}'
        run = Launched(domain, observer, folder, '--duration', '0.05')
        run.begin()
        code, output = run.end()
        assert code == 0, output
        run.assert_nothing_is_left()
    kept_promise(
        'launcher started and stopped',
        'no process and no shared memory are left',
        'lockstep',
        cycles,
    )


@pytest.mark.parametrize('cycles', [FIRST + 1, pytest.param(MANY, marks=LONG)])
def test_starting_and_stopping_in_one_process_leaves_nothing(
    domain, tmp_path, cycles, kept_promise
):
    # Each thread frees into the heap that it took from, and which threads share one is chance: with
    # several heaps memory may grow by one that is new, though nothing is kept.
    process = domain.start_script(COMPOSED, str(cycles), str(tmp_path), MALLOC_ARENA_MAX='1')
    output, _ = process.communicate(timeout=GIVE_UP * cycles)
    assert process.returncode == 0, output
    lines = [line.split()[1:] for line in output.splitlines() if line.startswith('cycle')]
    threads, files, pages = np.array(lines, int).T
    assert len(threads) == cycles
    assert threads.max() == threads[0]
    assert files.max() == files[0]
    assert (pages[-1] - pages[FIRST - 1]) * PAGE < LARGEST_GROWTH
    kept_promise(
        'launcher started and stopped, all nodes in one process',
        'no thread and no open file are left, memory grows by less than 4 MiB in all',
        'lockstep',
        cycles,
    )
