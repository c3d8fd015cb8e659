"""A vector approaches another one by bounded steps, and arrives at its very bits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpc_ros.control import approach

forces = st.tuples(st.floats(-50, 50), st.floats(-50, 50)).map(np.array)


@settings(max_examples=50)
@given(forces, forces, st.floats(1.0, 200.0))
def test_an_approach_is_bounded_and_ends_at_the_goal(begin, goal, longest):
    force = begin
    for _ in range(int(np.linalg.norm(goal - begin) / longest) + 2):
        moved = approach(force, goal, longest)
        assert np.linalg.norm(moved - force) <= longest * (1 + 1e-9)
        left = np.linalg.norm(goal - force) - np.linalg.norm(goal - moved)
        assert left == pytest.approx(np.linalg.norm(moved - force), abs=1e-9)  # straight
        force = moved
    np.testing.assert_array_equal(force, goal)
