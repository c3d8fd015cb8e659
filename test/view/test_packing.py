"""Positions in sixteen bits are near to what they were, and arrays are what Plotly reads."""

import base64

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from dpc_ros.view import packed, quantise
from dpc_ros.view.packing import MISSING

LEVELS = MISSING - 1
POSITIONS = st.tuples(st.integers(1, 5), st.integers(1, 4)).flatmap(
    lambda shape: arrays(float, (*shape, 2), elements=st.floats(-1e6, 1e6))
)


@given(POSITIONS)
def test_a_position_is_within_half_a_step(positions):
    quantised = quantise(positions)
    extent = np.ptp(positions.reshape(-1, 2), axis=0)
    rounding = 1e-9 * np.abs(positions).max()
    error = np.abs(quantised.positions() - positions)
    assert (error <= extent / LEVELS / 2 + rounding).all()
    assert (quantised.level < MISSING).all()


@given(POSITIONS, st.sampled_from([np.nan, np.inf, -np.inf]), st.data())
def test_a_frame_that_is_not_finite_is_missing_and_no_other(positions, value, data):
    frame, mass, axis = (data.draw(st.integers(0, size - 1)) for size in positions.shape)
    positions[frame, mass, axis] = value
    restored = quantise(positions).positions()
    assert np.isnan(restored[frame]).all()
    assert np.isfinite(np.delete(restored, frame, axis=0)).all()


@pytest.mark.parametrize('kind', ['f8', 'f4', 'i4', 'u4', 'u2', '>f8'])
@given(st.data())
def test_an_array_comes_back_from_a_page(kind, data):
    array = data.draw(arrays(np.uint16, array_shapes(max_dims=2))).astype(kind)
    content = packed(array)
    assert content['dtype'] == kind[-2:]
    bits = base64.b64decode(content['bdata'])
    assert np.array_equal(np.frombuffer(bits, f'<{content["dtype"]}'), array.ravel())
