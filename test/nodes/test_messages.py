"""What is read of a message is what was written into it; what can't be used is refused."""

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given, settings
from hypothesis import strategies as st

from dpc_ros.nodes.messages import (
    MessageError,
    force_message,
    read_force,
    read_stamp,
    to_stamp,
)


@settings(max_examples=30)
@given(st.integers(0, 2**31 * 10**9 - 1))
def test_a_stamp_is_read_as_it_was_written(nanoseconds):
    assert read_stamp(to_stamp(nanoseconds)) == nanoseconds


@pytest.mark.parametrize('parts', [(-1, 0), (0, 10**9), (0, 2**32 - 1), (-(2**31), 999)])
def test_a_stamp_that_is_none_is_refused(parts):
    with pytest.raises(MessageError, match='expected a stamp from 0 on'):
        read_stamp(Time(sec=parts[0], nanosec=parts[1]))


@pytest.mark.parametrize('identifier', ['', '1f3a9c02'])
def test_a_force_names_its_mass_and_its_controller(identifier):
    message = force_message(to_stamp(5), 162, np.array([1.0, -2.0]), identifier)
    frame, force = read_force(message)
    assert frame == (162, identifier, False)
    np.testing.assert_array_equal(force, [1.0, -2.0])


@pytest.mark.parametrize('frame', ['', 'mass_' + '9' * 5000, 'mass_162@', 'force@1f3a9c02'])
def test_a_force_without_a_mass_is_refused(frame):
    message = force_message(to_stamp(0), 162, np.zeros(2))
    message.header.frame_id = frame
    with pytest.raises(MessageError, match='expected a frame like'):
        read_force(message)
