"""Whether numbers are finite, or within a bound: as each value says, without a warning."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.finite import all_finite, all_within

VALUES = st.lists(st.floats(), max_size=9)
BOUNDS = st.floats(min_value=0.0)


@given(values=VALUES)
def test_all_finite_is_what_each_value_says(values):
    assert all_finite(np.array(values)) == all(map(math.isfinite, values))


@given(values=VALUES, largest=BOUNDS)
def test_all_within_is_what_each_value_says(values, largest):
    assert all_within(np.array(values), largest) == all(abs(each) <= largest for each in values)


@given(value=st.floats(allow_nan=False), count=st.integers(1, 40))
def test_a_bound_is_exact(value, count):
    """The least that is beyond it is; as many as are at it are not."""
    values = np.full(count, value)
    assert all_within(values, abs(value))
    if value:
        assert not all_within(values, math.nextafter(abs(value), 0.0))


@pytest.mark.parametrize('values', [[1e200], [math.inf], [-math.inf, math.inf], [math.nan]])
def test_what_is_far_off_is_no_warning(values):
    with np.errstate(all='raise'):
        assert all_finite(np.array(values)) == (abs(values[0]) < math.inf)
        assert not all_within(np.array(values), 1.0)
