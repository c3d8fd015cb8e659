"""The colour of a spring tells its strain."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.view import strain_colours


def test_springs_at_rest_are_grey():
    red, green, blue = strain_colours(np.zeros(1))[0]
    assert red == green == blue


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_more_strain_is_more_colour_until_it_is_full(one, other):
    low, high = sorted((one, other))
    stretched = strain_colours(np.array([low, high, 1.0, 2.0]), largest=1.0).astype(int)
    compressed = strain_colours(-np.array([low, high, 1.0, 2.0]), largest=1.0).astype(int)
    assert stretched[0, 0] <= stretched[1, 0] <= stretched[2, 0] == stretched[3, 0]
    assert compressed[0, 0] >= compressed[1, 0] >= compressed[2, 0] == compressed[3, 0]
    assert not np.array_equal(stretched[2], compressed[2])


def test_a_scale_without_extent_is_refused():
    with pytest.raises(ValueError, match='expected a positive number, got 0'):
        strain_colours(np.zeros(1), largest=0.0)
