"""The frame of a force says which mass and, where it can, which controller."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpc_ros.bag.force_frame import force_frame, read_force_frame, without_controller


@settings(max_examples=50)
@given(st.integers(0, 9_999_999), st.from_regex(r'[0-9a-f]{8}', fullmatch=True) | st.just(''))
def test_what_is_written_is_read(mass, controller):
    for is_release in {False, bool(controller)}:
        frame = force_frame(mass, controller, is_release)
        assert read_force_frame(frame) == (mass, controller, is_release)
        assert without_controller(frame) == f'mass_{mass}'


@pytest.mark.parametrize(
    'frame',
    [
        *('', 'mass_', 'mass_162@', 'mass_-1', 'mass_1@a@b', 'mass_²', 'mass_1\n'),
        *('mass_1:released', 'mass_1@:released', 'mass_1@a:held'),
        *('paper_2@0123456789ab', 'mass_' + '9' * 5000, 'mass_1@' + 'a' * 33),
    ],
)
def test_another_frame_is_refused(frame):
    with pytest.raises(ValueError, match="expected a frame like 'mass_162'"):
        read_force_frame(frame)
    assert without_controller(frame) == frame
