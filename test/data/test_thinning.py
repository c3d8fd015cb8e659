"""Thinning keeps what is new, in time order, and nothing twice."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from dpc_ros.data import thin

# Multiples of 1/8 have exact distances: nothing hangs on rounding.
EIGHTHS = st.integers(-16, 16).map(lambda i: i / 8)
TRAJECTORIES = arrays(float, array_shapes(min_dims=2, max_dims=2, max_side=12), elements=EIGHTHS)
DISTANCES = st.integers(0, 16).map(lambda i: i / 8)


@given(TRAJECTORIES, DISTANCES)
def test_kept_frames_stand_apart_and_dropped_ones_are_near_an_earlier_kept_one(frames, distance):
    kept = thin(frames, distance)
    apart = np.linalg.norm(frames[:, None] - frames[None], axis=-1)
    assert kept[0] == 0
    assert (np.diff(kept) > 0).all()
    assert (apart[np.ix_(kept, kept)][np.triu_indices(len(kept), 1)] >= distance).all()
    for dropped in np.setdiff1d(np.arange(len(frames)), kept):
        assert apart[dropped, kept[kept < dropped]].min() < distance


@given(TRAJECTORIES, DISTANCES)
def test_thinning_twice_drops_no_more(frames, distance):
    once = frames[thin(frames, distance)]
    np.testing.assert_array_equal(thin(once, distance), np.arange(len(once)))


@given(TRAJECTORIES, DISTANCES)
def test_later_frames_do_not_change_what_is_kept_before(frames, distance):
    half = len(frames) // 2 + 1
    kept = thin(frames, distance)
    np.testing.assert_array_equal(thin(frames[:half], distance), kept[kept < half])


def test_no_distance_keeps_every_frame():
    np.testing.assert_array_equal(thin(np.zeros((4, 2)), 0.0), np.arange(4))


@pytest.mark.parametrize('distance', [-0.1, np.nan])
def test_distance_has_to_be_a_length(distance):
    with pytest.raises(ValueError, match='thinning distance: expected a length'):
        thin(np.zeros((2, 2)), distance)
