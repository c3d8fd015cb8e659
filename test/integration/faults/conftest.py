"""A running loop that faults are put into."""

import signal
import time
from dataclasses import dataclass, field

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState

from dpc_ros.network import Body, Integrator, Mechanics, load_network
from dpc_ros.nodes.launch_plan import LOOP
from dpc_ros.nodes.messages import from_stamp
from dpc_ros.nodes.topics import LOOP_QOS

STEP = 5_000_000  # ns


@dataclass
class Loop:
    """Simulator, encoder and controller in processes, watched by the test's own node."""

    domain: object
    observer: object
    plan: object
    nodes: dict = field(default_factory=dict)
    states: list = field(default_factory=list)  # (stamp, q, q̇, monotonic time)
    forces: list = field(default_factory=list)  # (stamp, u, monotonic time)

    def __post_init__(self):
        node = self.observer.node
        node.create_subscription(JointState, 'configuration', self._take_state, LOOP_QOS)
        node.create_subscription(WrenchStamped, 'control_force', self._take_force, LOOP_QOS)
        for kind in self.plan.nodes:
            self.start(kind)
        self.go_on(40)

    def start(self, kind):
        self.nodes[kind] = self.domain.start_node(kind, self.plan)

    def kill(self, kind):
        self.domain.kill(self.nodes[kind])

    def pause(self, kind):
        self.nodes[kind].send_signal(signal.SIGSTOP)

    def unpause(self, kind):
        self.nodes[kind].send_signal(signal.SIGCONT)

    def go_on(self, answers):
        """Wait for so many more states that were answered; return when the first was [s]."""
        begin = len(self.forces)
        self.observer.wait(lambda: len(self._answers(begin)) >= answers, 'answers')
        return self._answers(begin)[0]

    def wait_for_states(self, count):
        begin = len(self.states)
        self.observer.wait(lambda: len(self.states) >= begin + count, 'states')

    def stop(self):
        for kind in (*LOOP, *(kind for kind in self.nodes if kind not in LOOP)):
            code, output = self.domain.stop(self.nodes[kind])
            assert code == 0, output
            assert 'Traceback' not in output

    def _answers(self, begin):
        """Return when each force that is not a watchdog's zero came, since a place in the list."""
        return [at for _, force, at in self.forces[begin:] if force.any()]

    def _take_state(self, message):
        stamp = from_stamp(message.header.stamp)
        entry = stamp, np.array(message.position), np.array(message.velocity), time.monotonic()
        self.states.append(entry)

    def _take_force(self, message):
        force = message.wrench.force
        stamp = from_stamp(message.header.stamp)
        self.forces.append((stamp, np.array([force.x, force.y]), time.monotonic()))


@pytest.fixture
def loop(domain, observer, plan):
    """Return a function: parameters by node → a running loop, in lockstep or realtime."""

    def make(mode, **overrides):
        readers = {
            'simulator': ['encoder', 'observer'],
            'encoder': ['controller'],
            'controller': ['simulator', 'observer'],
        }
        given = {kind: {'expected_subscribers': names} for kind, names in readers.items()}
        given['simulator'] |= {'duration': 0.0, 'time_mode': mode, 'response_timeout': 100.0}
        for kind, values in overrides.items():
            given[kind] |= values
        return Loop(domain, observer, plan(record=False, **given))

    return make


@pytest.fixture(scope='session')
def moved_by():
    """Return a function: a force, two states that follow each other → whether it acted between."""
    body = Body(Integrator(Mechanics(load_network('paper_2')), STEP * 1e-9), 162)

    def check(force, before, after):
        stamp, body.configuration, body.velocity, _ = before
        body.advance(force)
        return (
            after[0] == stamp + STEP
            and np.array_equal(body.configuration, after[1])
            and np.array_equal(body.velocity, after[2])
        )

    return check


@pytest.fixture
def passed(observer):
    """Return a function: let so many seconds pass, which are the fault itself."""

    def wait(seconds):
        end = time.monotonic() + seconds
        observer.wait(lambda: time.monotonic() >= end, 'time to pass')

    return wait
