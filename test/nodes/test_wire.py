"""The bytes of the loop's messages are what rclpy reads, and are read as rclpy reads them."""

import struct

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from state_messages import state_message

from dpc_ros.bag.force_frame import force_frame
from dpc_ros.nodes.messages import (
    MessageError,
    force_message,
    read_force,
    read_stamp,
    read_state,
    to_stamp,
)
from dpc_ros.nodes.wire import ForceReader, StateReader, force_pattern, state_pattern

FRAME, NAMES = 'net@1', ['xi_0', 'xi_1', 'xi_2']
STAMPS = st.integers(0, 2**31 * 10**9 - 1)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
FRAMES = st.text('ab@1', max_size=9)
NAMES_OR_NONE = st.just([]) | st.lists(st.text('xi_', max_size=9), min_size=3, max_size=3)
IDENTIFIERS = st.sampled_from(['', 'a', '1f3a9c02'])
STATES = st.lists(NUMBERS, min_size=3, max_size=3).map(np.array)
DAMAGES = st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=4)


def damaged(data, damages, length):
    data = bytearray(data)
    for place, byte in damages:
        data[place % len(data)] = byte
    return bytes(data[: max(0, len(data) - length)])


def outcome(read, *arguments):
    """Return what a reader says, or that it refuses."""
    try:
        found = read(*arguments)
    except MessageError:
        return 'refused'
    return [each.tobytes() if isinstance(each, np.ndarray) else each for each in found]


def read_state_as_rclpy(data):
    try:
        message = deserialize_message(data, JointState)
    except RuntimeError as error:
        raise MessageError from error
    return read_stamp(message.header.stamp), *read_state(message, FRAME, NAMES)


def read_force_as_rclpy(data):
    try:
        message = deserialize_message(data, WrenchStamped)
    except RuntimeError as error:
        raise MessageError from error
    return read_stamp(message.header.stamp), *read_force(message)


@given(stamp=STAMPS, position=STATES, velocity=STATES, frame=FRAMES, names=NAMES_OR_NONE)
def test_a_state_is_written_so_that_rclpy_reads_it(stamp, position, velocity, frame, names):
    pattern = state_pattern(frame, 3, names)
    pattern.write(1, velocity, position)  # of which nothing stays
    written = pattern.write(stamp, position, velocity)
    expected = state_message(to_stamp(stamp), frame, position, velocity, names)
    assert deserialize_message(written, JointState) == expected
    found, *arrays = pattern.read(written)
    assert found == stamp
    np.testing.assert_array_equal(arrays, [position, velocity])


@given(stamp=STAMPS, x=NUMBERS, y=NUMBERS, identifier=IDENTIFIERS, is_release=st.booleans())
def test_a_force_is_written_so_that_rclpy_reads_it(stamp, x, y, identifier, is_release):
    pattern = force_pattern(force_frame(162, identifier, is_release))
    pattern.write(1, np.ones(2))
    force = np.array([x, y])
    written = pattern.write(stamp, force)
    expected = force_message(to_stamp(stamp), 162, force, identifier, is_release)
    assert deserialize_message(written, WrenchStamped) == expected
    found, array = pattern.read(written)
    assert found == stamp
    np.testing.assert_array_equal(array, force)


@given(
    states=st.lists(st.tuples(STAMPS, STATES, STATES, st.booleans()), min_size=1, max_size=4),
    damages=DAMAGES,
    length=st.sampled_from([0, 0, 0, 1, 4, 8, 40, 1000]),
)
@settings(max_examples=200)
def test_states_are_read_as_rclpy_reads_them(states, damages, length):
    reader = StateReader(FRAME, NAMES)
    for stamp, position, velocity, named in states:
        names = NAMES if named else []
        data = serialize_message(state_message(to_stamp(stamp), FRAME, position, velocity, names))
        assert outcome(reader.read, data) == [stamp, position.tobytes(), velocity.tobytes()]
        other = damaged(data, damages, length)
        assert outcome(reader.read, other) == outcome(read_state_as_rclpy, other)


@given(
    forces=st.lists(
        st.tuples(STAMPS, NUMBERS, NUMBERS, st.sampled_from(['', 'a', 'b'])), min_size=1
    ),
    damages=DAMAGES,
    length=st.sampled_from([0, 0, 0, 1, 4, 8, 40, 1000]),
)
@settings(max_examples=200)
def test_forces_are_read_as_rclpy_reads_them(forces, damages, length):
    reader = ForceReader()
    for stamp, x, y, identifier in forces:
        message = force_message(to_stamp(stamp), 162, np.array([x, y]), identifier)
        data = serialize_message(message)
        expected = outcome(read_force_as_rclpy, data)
        assert expected[0] == stamp
        assert outcome(reader.read, data) == expected
        other = damaged(data, damages, length)
        assert outcome(reader.read, other) == outcome(read_force_as_rclpy, other)


def changed(**fields):
    """Return a sound state with some fields of its message set to others."""
    message = state_message(to_stamp(7), FRAME, np.ones(3), np.zeros(3))
    for name, value in fields.items():
        owner = message.header if name == 'frame_id' else message
        setattr(owner, name, value)
    return serialize_message(message)


@pytest.mark.parametrize(
    ('data', 'reason'),
    [
        (b'', 'expected a JointState, got other bytes'),
        (changed(frame_id='net@2'), "expected the frame 'net@1'"),
        (changed(name=['a', 'b', 'c']), 'expected the names'),
        (changed(position=[1.0, 2.0]), 'expected 3 positions, got 2'),
        (changed(velocity=[1.0, np.nan, 2.0]), 'expected finite velocities, but number 1 is nan'),
    ],
    ids=['no message', 'frame', 'names', 'positions', 'velocities'],  # what aligns the bytes varies
)
def test_the_reason_is_said_before_and_after_a_good_one(data, reason):
    reader = StateReader(FRAME, NAMES)
    for _ in range(2):
        with pytest.raises(MessageError, match=reason):
            reader.read(data)
        assert reader.read(changed()).stamp == 7


@pytest.mark.parametrize('stamp', [(2**31 - 1, 10**9), (0, 2**32 - 1), (-1, 0)])
def test_a_stamp_that_is_none_is_refused_before_and_after_a_good_one(stamp):
    states, forces = state_pattern(FRAME, 3), force_pattern(force_frame(162))
    state = states.write(7, np.ones(3), np.zeros(3))
    force = forces.write(7, np.ones(2))
    for reader, good in ((StateReader(FRAME, NAMES), state), (ForceReader(), force)):
        bad = good[:4] + struct.pack('<iI', *stamp) + good[12:]
        for _ in range(2):
            with pytest.raises(MessageError, match='expected a stamp from 0 on'):
                reader.read(bad)
            assert reader.read(good).stamp == 7


def test_what_aligns_the_content_is_of_no_account():
    pattern, reader = state_pattern('a', 3, NAMES), StateReader('a', NAMES)
    data = pattern.write(7, np.arange(3.0), np.ones(3))
    noisy = bytearray(data)
    noisy[18:20] = b'?!'  # behind the frame
    assert reader.read(bytes(noisy)).content == reader.read(data).content


def test_what_is_read_stays_though_the_next_one_is_written():
    pattern, reader = state_pattern(FRAME, 3), StateReader(FRAME, NAMES)
    read = [reader.read(pattern.write(k, np.full(3, float(k)), np.zeros(3))) for k in range(3)]
    assert [each.position[0] for each in read] == [0.0, 1.0, 2.0]
    assert all(each.position.flags.aligned and each.position.flags.writeable for each in read)
