"""What is replayed of a log, and in which order."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.bag import BagError, BagWriter, QosProfile, read_topics
from dpc_ros.bag.playback import Excerpt, lockstep_steps, stamp_of_header

JOINT_STATE = 'sensor_msgs/msg/JointState'
WRENCH = 'geometry_msgs/msg/WrenchStamped'
LATCHED = (QosProfile(depth=1, durability='transient_local'),)


@pytest.fixture
def write_log(messages, tmp_path):
    """Return a function: rows of (topic, log time [s], stamp [s]) → the bag that holds them."""

    def write(rows):
        with BagWriter(tmp_path / 'log') as bag:
            bag.add_topic(messages.topic('/configuration', JOINT_STATE))
            bag.add_topic(messages.topic('/target', JOINT_STATE, LATCHED))
            bag.add_topic(messages.topic('/control_force', WRENCH))
            for number, (name, time, stamp) in enumerate(rows):
                nanoseconds = round(stamp * 1e9)
                cdr = (
                    messages.wrench(nanoseconds, (number, 0))
                    if name == 'control_force'
                    else messages.joint_state(nanoseconds, [number])
                )
                bag.write(f'/{name}', cdr, round(time * 1e9), round(time * 1e9))
        return tmp_path / 'log'

    return write


def shown(message):
    return message.topic.lstrip('/'), message.log_time_ns / 1e9


@given(times=st.lists(st.integers(0, 4), max_size=30), chunk_size=st.sampled_from([1, 500, 10**6]))
def test_messages_of_equal_times_come_as_they_were_recorded(
    times, chunk_size, messages, tmp_path_factory
):
    folder = tmp_path_factory.mktemp('logs') / 'log'
    with BagWriter(folder, chunk_size=chunk_size) as bag:
        bag.add_topic(messages.topic('/configuration', JOINT_STATE))
        for number, time in enumerate(times):
            bag.write('/configuration', messages.joint_state(0, [number]), time, time, number)
    found = [m.sequence for m in Excerpt(folder, frozenset({'/configuration'})).messages()]
    assert found == sorted(range(len(times)), key=lambda number: times[number])


def test_an_excerpt_begins_with_what_was_latched_before_it(write_log):
    rows = [('configuration', k, k) for k in range(6)]
    rows += [('target', 0.5, 0), ('target', 1.5, 0), ('target', 3.5, 0)]
    log = write_log(sorted(rows, key=lambda row: row[1]))
    topics = frozenset({'/configuration', '/target'})
    excerpt = Excerpt(log, topics, frozenset({'/target'}), start_time=2, duration=2)
    assert [shown(message) for message in excerpt.messages()] == [
        *(('target', 1.5), ('configuration', 2), ('configuration', 3), ('target', 3.5)),
    ]
    with pytest.raises(BagError, match='within the log of 5 s, got 9 s'):
        Excerpt(log, topics, start_time=9).span_ns()


def test_lockstep_plays_what_was_answered_once_and_after_what_counted_for_it(write_log):
    log = write_log(
        [
            ('configuration', 0.0, 0.0),  # published again: nobody had answered
            ('configuration', 0.1, 0.0),
            ('target', 0.2, 0.0),
            ('control_force', 0.3, 0.0),
            ('configuration', 0.4, 0.1),
            ('target', 0.45, 0.1),
            ('control_force', 0.5, 0.1),
            ('configuration', 0.6, 0.2),
            ('control_force', 0.7, 0.2),
            ('configuration', 0.8, 0.1),  # a new epoch
            ('control_force', 0.9, 0.1),
            ('configuration', 1.0, 0.2),  # the end of the run: never answered
        ]
    )
    excerpt = Excerpt(log, frozenset({'/configuration', '/target'}))
    steps = [
        (step.stamp / 1e9, [shown(message) for message in step.before])
        for step in lockstep_steps(excerpt, '/configuration', '/control_force')
    ]
    assert steps == [(0, [('target', 0.2)]), (0.1, [('target', 0.45)]), (0.2, []), (0.1, [])]


@given(stamp=st.integers(0, 2**61))
def test_the_stamp_is_read_off_the_bytes(messages, stamp):
    stamp %= 2**31 * 10**9
    raw = type('Raw', (), {'topic': '/x', 'cdr': messages.joint_state(stamp, np.zeros(2))})
    assert stamp_of_header(raw) == stamp


def test_topics_are_read_as_they_were_written(messages, tmp_path):
    profiles = (
        QosProfile(history='unknown', depth=0, durability='transient_local', deadline_ns=1_500_000),
        QosProfile(reliability='best_effort', lifespan_ns=7, liveliness='manual_by_topic'),
    )
    written = [
        messages.topic('/target', JOINT_STATE, profiles),
        messages.topic('/control_force', WRENCH, ()),
    ]
    with BagWriter(tmp_path / 'log') as bag:
        for topic in written:
            bag.add_topic(topic)
        bag.write('/target', messages.joint_state(0, [1.0]), 1, 1)
        bag.write('/control_force', messages.wrench(0, (1, 2)), 1, 1)
    assert read_topics(tmp_path / 'log') == {topic.name: topic for topic in written}
