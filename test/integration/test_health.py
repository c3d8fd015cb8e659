"""What running nodes report of themselves, and what `dpc top` shows of it."""

import contextlib
import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.network import load_network
from dpc_ros.nodes.messages import force_message, to_stamp
from dpc_ros.nodes.topics import LOOP_QOS
from dpc_ros.resources import share_directory

GIVE_UP = 120.0  # s after which a test stops waiting
CLEAR = '\x1b[H\x1b[J'
LOOP = ('simulator', 'encoder', 'controller')
NETWORK = load_network('paper_2').identifier
CHECKPOINT = load_checkpoint('paper_2_extended_m5').identifier
INTERFACE = (share_directory() / 'docs' / 'interface.md').read_text()
DURATIONS = {
    'simulator': {'jitter', 'processing', 'age', 'waiting', 'round trip'},
    'encoder': {'jitter', 'processing', 'age', 'waiting'},
    'controller': {'jitter', 'processing', 'age', 'waiting'},
    'recorder': {'processing', 'age', 'waiting'},
    'player': {'jitter', 'processing', 'age', 'waiting', 'round trip'},
}


class Listener:
    """Keeps the last status of each node."""

    def __init__(self, observer):
        self.observer = observer
        self.statuses = {}
        node = observer.node
        node.create_subscription(DiagnosticArray, '/diagnostics', self._take, 100)

    def _take(self, message):
        for status in message.status:
            self.statuses[status.name] = status

    def values(self, node):
        status = self.statuses.get(node, DiagnosticStatus())
        return {pair.key: pair.value for pair in status.values}

    def wait(self, node, condition, what):
        self.observer.wait(
            lambda: (values := self.values(node)) and condition(values), f'{node}: {what}'
        )


@pytest.fixture
def listener(observer):
    return Listener(observer)


def dpc_top(domain, *arguments):
    return [sys.executable, '-m', 'dpc_ros.cli', 'top', '--domain', str(domain.number), *arguments]


def run_top(domain, *arguments):
    return subprocess.run(
        dpc_top(domain, *arguments),
        env=domain.environment,
        capture_output=True,
        text=True,
        timeout=GIVE_UP,
        check=False,
    )


def assert_ordered(values, what):
    p50, p99, largest = (float(values[f'{what} {which} [ms]']) for which in ('p50', 'p99', 'max'))
    assert p50 <= p99 <= largest, what
    if what != 'age':  # between two clocks
        assert p50 >= 0, what


def is_documented(key):
    """Return whether the page on the interface has a key, or the one that stands for it."""
    name, colon, _ = re.sub(' (p99|max) ', ' p50 ', key).partition(': ')
    start = f'`{name}: <' if colon else f'`{name}`'
    return start in INTERFACE


@pytest.fixture
def start(domain, plan):
    """Start the nodes of a run; return them by their names."""

    def start(mode='realtime'):
        if mode == 'player':
            bag = share_directory() / 'bags' / 'demo_1s'
            given = {
                'player': (
                    f'bag:={bag}',
                    'topics:=[configuration]',
                    'time_mode:=lockstep',
                    'loop:=true',
                    'expected_subscribers:=[encoder]',
                ),
                'encoder': ('expected_subscribers:=[controller]',),
                'controller': ('target:=simulation:4@100', 'expected_subscribers:=[player]'),
            }
            return {
                kind: domain.start(
                    f'{kind}_node',
                    '--ros-args',
                    *(part for each in values for part in ('-p', each)),
                )
                for kind, values in given.items()
            }
        # Slowly: what is shown does not depend on it, and a test at full speed takes two cores.
        made = plan(simulator={'time_mode': mode, 'duration': 0.0, 'real_time_factor': 0.25})
        return {kind: domain.start_node(kind, made) for kind in ('recorder', *LOOP)}

    return start


@pytest.mark.parametrize('mode', ['realtime', 'player'])
def test_running_nodes_report_what_the_page_promises(listener, start, tmp_path, mode):
    for kind, process in start(mode).items():

        def is_measured(values, kind=kind):
            return all(values[f'{what} max [ms]'] != 'nan' for what in DURATIONS[kind])

        listener.wait(kind, is_measured, 'all that it measures')
        values, status = listener.values(kind), listener.statuses[kind]
        assert [key for key in values if not is_documented(key)] == []
        for what in DURATIONS[kind]:
            assert_ordered(values, what)
        assert values['state'] == 'active'
        assert status.hardware_id == f'/{kind}'
        assert int(values['process id']) == process.pid
        for key in ('rate [Hz]', 'uptime [s]', 'peak memory [MiB]', 'received', 'published'):
            assert float(values[key]) > 0, key
        is_watched = kind in ('simulator', 'encoder', 'controller')
        assert (values['watchdog'] != 'none') == is_watched
        if kind in LOOP:
            assert values['network'] == NETWORK
        if kind in ('encoder', 'controller'):
            assert values['checkpoint'] == CHECKPOINT
        if kind == 'recorder':
            assert values['bag'] == str(tmp_path / 'run' / 'bag')
            assert int(values['recorded [bytes]']) > 0


def test_dpc_top_shows_each_node_and_who_hangs(domain, observer, listener, start):
    nodes = start()
    for kind in nodes:
        listener.wait(kind, lambda values: float(values['rate [Hz]']) > 0, 'a rate')

    def shows_all():
        run = run_top(domain, '--once')
        assert run.returncode == 0, run.stderr
        assert run.stdout.replace('\n', '').isprintable()
        lines = run.stdout.partition('\n\n')[0].splitlines()
        rows = [line.split()[:2] for line in lines if line.startswith('/')]
        return rows == [[f'/{kind}', 'active'] for kind in sorted(nodes)]

    observer.wait(shows_all, 'a table with all nodes')
    terminal, its_end = os.openpty()
    top = subprocess.Popen(dpc_top(domain), env=domain.environment, stdout=its_end, stderr=its_end)
    os.close(its_end)
    os.set_blocking(terminal, False)
    shown = ''

    def shows(pattern):
        nonlocal shown
        with contextlib.suppress(OSError):  # nothing new, or the other end is closed
            shown += os.read(terminal, 65536).decode()
        newest = shown.rpartition(CLEAR)[2]
        return re.search(pattern, newest)

    try:
        observer.wait(lambda: shows(r'/encoder +active'), 'the encoder')
        nodes['encoder'].send_signal(signal.SIGSTOP)
        observer.wait(lambda: shows(r'/encoder +silent'), 'its silence')
        nodes['encoder'].send_signal(signal.SIGCONT)
        observer.wait(lambda: shows(r'/encoder +active'), 'the encoder again')
        top.send_signal(signal.SIGINT)
        assert top.wait(GIVE_UP) == 130
        assert shows('stopped')
    finally:
        top.kill()
        top.wait()
        os.close(terminal)


def test_dpc_top_says_where_nobody_reports(domain):
    run = run_top(domain, '--once', '--timeout', '0.2')
    assert (run.returncode, run.stdout) == (1, '')
    assert f'domain {domain.number}' in run.stderr


def test_a_flood_of_bad_messages_is_counted_and_a_failure_is_the_last_report(
    domain, observer, listener, plan
):
    settings = {'expected_subscribers': [], 'response_timeout': 0.5}
    simulator = domain.start_node('simulator', plan(record=False, simulator=settings))
    pushes, forces = (
        observer.node.create_publisher(WrenchStamped, topic, LOOP_QOS)
        for topic in ('external_force', 'control_force')
    )
    for publisher in (pushes, forces):
        observer.wait(publisher.get_subscription_count, 'the simulator')
    listener.wait('simulator', lambda values: True, 'a first report')
    number = 1000
    for k in range(number):
        pushes.publish(force_message(to_stamp(0), number + k, np.zeros(2)))
    listener.wait('simulator', lambda values: values['rejected'] == str(number), 'all of them')
    values = listener.values('simulator')
    counts = {key: int(value) for key, value in values.items() if key.startswith('rejected: ')}
    assert len(counts) == 21
    assert sum(counts.values()) == number
    assert listener.statuses['simulator'].level == DiagnosticStatus.WARN
    # After a first force it gives up for want of a second.
    forces.publish(force_message(to_stamp(0), 162, np.zeros(2)))
    observer.wait(lambda: simulator.poll() is not None, 'the end of the simulator')
    output = simulator.stdout.read()
    assert simulator.returncode == 1
    assert 0 < output.count('rejected a message') < number / 4

    def has_failed():
        return listener.statuses['simulator'].level == DiagnosticStatus.ERROR

    observer.wait(has_failed, 'the last report')
    assert f'error: simulator: {listener.statuses["simulator"].message}' in output
