"""A running loop that faults are put into."""

import math
import signal
import time
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState

from dpc_ros.network import Body, Integrator, Mechanics, load_network
from dpc_ros.nodes.launch_plan import LOOP
from dpc_ros.nodes.messages import from_stamp
from dpc_ros.nodes.topics import LOOP_QOS

STEP = 5_000_000  # ns


class State(NamedTuple):
    """A configuration as it came; `sent` is when it was published, by the clock of `time.time`."""

    stamp: int
    configuration: np.ndarray
    velocity: np.ndarray
    sent: float


class Force(NamedTuple):
    """A force as it came."""

    stamp: int
    force: np.ndarray
    sent: float


@dataclass
class Loop:
    """Simulator, encoder and controller in processes, watched by the test's own node.

    What this node takes may have waited for it: only when a message was published says whether it
    is of before a fault or of after it.
    """

    domain: object
    observer: object
    plan: object
    nodes: dict = field(default_factory=dict)
    states: list[State] = field(default_factory=list)
    published: dict[int, float] = field(default_factory=dict)  # states: when first, by stamp [s]
    forces: list[Force] = field(default_factory=list)

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
        """Kill a node; return when the signal was sent [s]."""
        return self.domain.kill(self.nodes[kind])

    def pause(self, kind):
        """Stop a node; return when the signal was sent [s]."""
        self.nodes[kind].send_signal(signal.SIGSTOP)
        return time.time()

    def unpause(self, kind):
        self.nodes[kind].send_signal(signal.SIGCONT)

    def go_on(self, answers, since=0.0, within=math.inf):
        """Wait for so many states to be answered since a moment; return how long it took [s].

        That is when the second one was: the first may have been on its way when a node was lost.
        Answers to states that were published longer ago [s] than they may be do not count.
        """
        begin = len(self.forces)

        def found():
            """Return when each answer that is not a watchdog's zero was sent."""
            new = [each for each in self.forces[begin:] if each.sent > since and each.force.any()]
            # A state that has not come yet is a young one.
            ages = [each.sent - self.published.get(each.stamp, each.sent) for each in new]
            return [each.sent for each, age in zip(new, ages, strict=True) if age <= within]

        self.observer.wait(lambda: len(found()) >= answers, 'answers')
        return found()[1] - since

    def wait_for_states(self, count):
        begin = len(self.states)
        self.observer.wait(lambda: len(self.states) >= begin + count, 'states')

    def stop(self):
        for kind in (*LOOP, *(kind for kind in self.nodes if kind not in LOOP)):
            code, output = self.domain.stop(self.nodes[kind])
            assert code == 0, output
            assert 'Traceback' not in output

    def _take_state(self, message, info):
        state = np.array(message.position), np.array(message.velocity)
        self.states.append(State(from_stamp(message.header.stamp), *state, sent(info)))
        self.published.setdefault(self.states[-1].stamp, sent(info))

    def _take_force(self, message, info):
        force = message.wrench.force
        force = np.array([force.x, force.y])
        self.forces.append(Force(from_stamp(message.header.stamp), force, sent(info)))


def sent(info):
    """Return when a message was published [s]."""
    return info['source_timestamp'] * 1e-9


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
        body.configuration, body.velocity = before.configuration, before.velocity
        body.advance(force)
        return (
            after.stamp == before.stamp + STEP
            and np.array_equal(body.configuration, after.configuration)
            and np.array_equal(body.velocity, after.velocity)
        )

    return check


@pytest.fixture
def passed(observer):
    """Return a function: let so many seconds pass, which are the fault itself."""

    def wait(seconds):
        end = time.monotonic() + seconds
        observer.wait(lambda: time.monotonic() >= end, 'time to pass')

    return wait
