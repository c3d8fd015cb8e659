"""Nodes on hosts of their own: a body, a brain beside it, and a log of both."""

import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from dpc_ros.nodes.launch_plan import LOOP

SWITCH = Path(__file__).with_name('switch.py')
WATCH = Path(__file__).with_name('watch.py').read_text()
PLACES = {'simulator': 'body', 'encoder': 'brain', 'controller': 'brain', 'recorder': 'log'}
HOSTS = ('body', 'brain', 'log')
MOST = 5  # repetitions of a test
GIVE_UP = 200.0  # s after which a test stops waiting; nothing is asserted about the time itself
TOOLS = ('ip', 'mount', 'nsenter', 'setpriv', 'unshare')
# What it starts ends with the test, even if that is killed.
BOUND = ('setpriv', '--pdeathsig', 'KILL', '--')


def pytest_generate_tests(metafunc):
    """Repeat each test of a network as often as `--repetitions` says, few times at most."""
    count = min(metafunc.config.getoption('--repetitions'), MOST)
    if count > 1 and 'network' in metafunc.fixturenames:
        metafunc.fixturenames.append('_repetition')
        metafunc.parametrize('_repetition', range(count))


@dataclass
class Network:
    """Hosts on a switch, and the nodes that run on them.

    Attributes:
        variables: of the environment of each node.
        nodes: by kind; launchers by host.
    """

    domain: object
    switch: subprocess.Popen
    hosts: dict[str, int]
    variables: dict[str, str] = field(
        default_factory=lambda: {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}
    )
    nodes: dict[str, subprocess.Popen] = field(default_factory=dict)

    def order(self, command: str) -> str:
        """Give the switch a command (see there); return its answer."""
        self.switch.stdin.write(f'{command}\n')
        self.switch.stdin.flush()
        return self.switch.stdout.readline().strip()

    def counts(self) -> dict:
        return json.loads(self.order('counts'))

    @property
    def addresses(self) -> list[str]:
        return [f'10.0.0.{number}' for number in range(1, len(self.hosts) + 1)]

    def cut(self, host: str, seconds: float) -> int:
        """Let no frames to or from a host through for a while; return when it is over [ns]."""
        self.order(f'link {host} off')
        time.sleep(seconds)
        self.order(f'link {host} on')
        return time.time_ns()

    def forbid_multicast(self) -> None:
        self.order('multicast off')
        for host in self.hosts:
            command = [*self.through(host), 'ip', 'route', 'delete', '224.0.0.0/4']
            subprocess.run(command, check=True)

    def through(self, host: str) -> list[str]:
        """Return a command that runs another on a host, as the same process."""
        namespaces = ['--mount', '--net', '--uts', '--']
        return [*BOUND, 'nsenter', '--target', str(self.hosts[host]), *namespaces]

    def start(self, plan) -> None:
        for kind in plan.nodes:
            through = self.through(PLACES[kind])
            self.nodes[kind] = self.domain.start_node(kind, plan, through, **self.variables)

    def launch(self, host: str, *arguments: str) -> None:
        """Start the launcher on a host."""
        self.nodes[host] = self.domain.start(
            'launcher', *arguments, through=self.through(host), **self.variables
        )

    def start_script(self, host: str, script: str, *arguments: str) -> subprocess.Popen:
        through = self.through(host)
        return self.domain.start_script(script, *arguments, through=through, **self.variables)

    def watch(self, stamp: int) -> subprocess.Popen:
        """Start a node `watch`, which sees when the body comes to the state of a stamp [ns]."""
        return self.start_script(PLACES['recorder'], WATCH, str(stamp))

    def wait_for(self, watch: subprocess.Popen) -> None:
        """Wait until it has seen that."""
        others = []
        for line in watch.stdout:
            if line == 'there\n':
                return
            others.append(line)  # of DDS for one
        pytest.fail(''.join(others))

    def wait_for_the_end(self) -> dict[str, str]:
        """Wait until the simulator ends by itself, then end the others; return what they said."""
        said = {}
        for kind in (*LOOP, 'recorder'):
            if kind == 'simulator':
                said[kind], _ = self.nodes[kind].communicate(timeout=GIVE_UP)
                code = self.nodes[kind].returncode
            else:
                code, said[kind] = self.domain.stop(self.nodes[kind])
            assert code == 0, said[kind]
            assert 'Traceback' not in said[kind]
        return said


@pytest.fixture
def hosts():
    """The names of the hosts, where a test gives no others."""
    return HOSTS


@pytest.fixture
def start_switch(hosts):
    """The command that starts hosts on a switch; they end with whoever runs it."""
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing or os.geteuid() or not Path('/dev/net/tun').exists():
        pytest.skip(f'hosts need root, /dev/net/tun and the tools {", ".join(TOOLS)}')
    return [*BOUND, sys.executable, '-S', str(SWITCH), *hosts]


@pytest.fixture
def network(domain, start_switch):
    """Hosts on a switch that is sound until it is told otherwise."""
    pipes = {'stdin': subprocess.PIPE, 'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE}
    with subprocess.Popen(start_switch, text=True, **pipes) as switch:
        processes = switch.stdout.readline()
        if not processes:
            reason = switch.stderr.read().splitlines()[-1]
            if 'Operation not permitted' in reason:
                pytest.skip(f'may not make hosts here: {reason}')
            pytest.fail(reason)
        made = Network(domain, switch, json.loads(processes))
        yield made
        for process in made.nodes.values():
            process.kill()
            process.wait()
        switch.stdin.close()
        assert switch.wait(10) == 0, switch.stderr.read()
