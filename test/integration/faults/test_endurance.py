"""What comes often, and what lasts long."""

import random
import time

import numpy as np
import psutil
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from dpc_ros.bag import read_contents
from dpc_ros.bag.metadata import LOSSES_RECORD
from dpc_ros.nodes.messages import force_message, latent_names, to_stamp
from dpc_ros.nodes.topics import TOPICS

pytestmark = pytest.mark.faults
TARGETS = 1000
FLAT = 4e6  # byte by which a node may grow after its first minute, in nine more
INPUTS = ('configuration', 'latent_state', 'target', 'control_force', 'external_force')


@pytest.mark.long
def test_a_target_that_changes_a_thousand_times(loop, kept_promise, passed):
    """As a slider in a viewer does it; what counts in the end is the last one."""
    running = loop('realtime')
    node, in_force = running.observer.node, []
    entry = TOPICS['target']
    publisher = node.create_publisher(JointState, 'target', entry.qos)
    entry = TOPICS['target_in_force']
    node.create_subscription(
        JointState, 'target_in_force', lambda m: in_force.append(list(m.position)), entry.qos
    )
    running.observer.wait(publisher.get_subscription_count, 'the controller')
    rng = np.random.default_rng(0)
    for _ in range(TARGETS):
        target = JointState(name=latent_names(5), position=rng.normal(scale=0.3, size=5))
        publisher.publish(target)
        passed(5.0 / TARGETS)
    last = list(target.position)
    running.observer.wait(lambda: in_force and in_force[-1] == last, 'the last target')
    running.go_on(40)
    running.stop()
    kept_promise(
        'target changed 1000 times in 5 s',
        'the loop goes on, the last target is in force in the end',
        'realtime',
        1,
    )


@pytest.mark.long
def test_bytes_that_are_no_message(loop, repetitions, kept_promise):
    running = loop('realtime')
    node = running.observer.node
    rng = random.Random(0)
    heard = {topic: [] for topic in INPUTS}  # what came, as bytes: whatever this test sends, too
    heard['external_force'].append(serialize_message(force_message(to_stamp(0), 200, np.ones(2))))
    for topic in INPUTS:
        source = 'target_in_force' if topic == 'target' else topic
        entry = TOPICS[source]
        node.create_subscription(
            entry.message_type, source, heard[topic].append, entry.qos, raw=True
        )
    running.observer.wait(lambda: all(heard.values()), 'a message of each kind')
    sent = set()
    for topic in INPUTS:
        publisher = node.create_publisher(TOPICS[topic].message_type, topic, TOPICS[topic].qos)
        running.observer.wait(publisher.get_subscription_count, f'a reader of {topic}')
        content = heard[topic][-1]
        for _ in range(20 * repetitions):
            damaged = _damaged(content, rng)
            sent.add(damaged)
            publisher.publish(damaged)
        running.go_on(40)
        node.destroy_publisher(publisher)
    for topic in ('configuration', 'latent_state', 'control_force'):
        assert all(_is_finite(data, topic) for data in heard[topic] if data not in sent)
    running.stop()
    kept_promise(
        'fuzzed bytes on every subscribed topic',
        'no node ends, nothing that is not finite is published, control goes on',
        'realtime',
        20 * repetitions * len(INPUTS),
    )


def _is_finite(data, topic):
    message = deserialize_message(data, TOPICS[topic].message_type)
    if topic == 'control_force':
        force = message.wrench.force
        return bool(np.isfinite([force.x, force.y, force.z]).all())
    return bool(np.isfinite([*message.position, *message.velocity]).all())


def _damaged(content, rng):
    """Return noise, or a message that is cut off, or has some other bytes."""
    kind = rng.randrange(3)
    if kind == 0:
        return rng.randbytes(rng.randrange(100))
    if kind == 1:
        return content[: rng.randrange(len(content))]
    changed = bytearray(content)
    for _ in range(3):
        changed[rng.randrange(len(changed))] = rng.randrange(256)
    return bytes(changed)


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_ten_minutes(domain, observer, plan, kept_promise):
    # The recorder keeps the index of a file until it ends.
    made = plan(
        simulator={'time_mode': 'realtime', 'duration': 600.0},
        recorder={'split_duration': 30.0},
    )
    nodes = {kind: domain.start_node(kind, made) for kind in made.nodes}
    memory = {kind: psutil.Process(process.pid).memory_info for kind, process in nodes.items()}
    states = []
    observer.node.create_subscription(
        JointState,
        'configuration',
        lambda message: states.append(None),
        TOPICS['configuration'].qos,
    )
    observer.wait(lambda: len(states) >= 60 * 200, 'the first minute')
    before = {kind: each().rss for kind, each in memory.items()}
    end = time.monotonic() + 900.0
    while len(states) < 590 * 200:
        observer.executor.spin_once(timeout_sec=0.05)
        assert nodes['simulator'].poll() is None
        assert time.monotonic() < end
    growth = {kind: each().rss - before[kind] for kind, each in memory.items()}
    observer.wait(lambda: nodes['simulator'].poll() is not None, 'the end')
    for kind in ('simulator', 'encoder', 'controller', 'recorder'):
        code, output = domain.stop(nodes[kind])
        assert code == 0, output
    assert max(growth.values()) < FLAT, growth
    contents = read_contents(made.bag)
    assert set(contents.metadata[LOSSES_RECORD].values()) == {'0'}
    kept_promise(
        'ten minutes at 200 Hz, the log split each half minute',
        f'memory of every node grows by less than {FLAT:.0e} byte after the first minute; nothing '
        'is lost',
        'realtime',
        1,
    )
