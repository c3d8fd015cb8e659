"""What is plotted is what was shown, of the last seconds."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.view.frame import Frame
from dpc_ros.view.history import History

Q = np.zeros(4)


def frame(time, **known):
    return Frame(time, Q, **known)


def test_every_value_comes_back_in_its_column():
    history = History(2)
    history.add(frame(0.0))
    history.add(
        frame(
            0.5,
            latent=np.array([1.0, 2.0]),
            target_latent=np.array([3.0, 4.0]),
            force=np.array([5.0, 6.0]),
            nmse=0.25,
            energies=(7.0, 8.0, 9.0),
        )
    )
    curves = history.curves()
    np.testing.assert_array_equal(curves.time, [0.0, 0.5])
    np.testing.assert_array_equal(curves.nmse, [np.nan, 0.25])
    np.testing.assert_array_equal(curves.latent, [[np.nan] * 2, [1.0, 2.0]])
    np.testing.assert_array_equal(curves.target_latent, [[np.nan] * 2, [3.0, 4.0]])
    np.testing.assert_array_equal(curves.force, [[np.nan] * 2, [5.0, 6.0]])
    np.testing.assert_array_equal(curves.energies, [[np.nan] * 3, [7.0, 8.0, 9.0]])


@given(st.lists(st.floats(0.0, 3.0), min_size=1, max_size=30), st.floats(0.5, 5.0))
def test_times_rise_and_span_no_more_than_the_seconds_kept(steps, seconds):
    history = History(1, seconds)
    time = 0.0
    for step in steps:
        time += step
        history.add(frame(time))
    times = history.curves().time
    assert (np.diff(times) > 0).all()
    assert times[-1] == time
    assert times[-1] - times[0] <= seconds


def test_a_body_that_begins_anew_has_no_past():
    history = History(1)
    for time in (0.0, 1.0, 2.0, 0.0):
        history.add(frame(time))
    np.testing.assert_array_equal(history.curves().time, [0.0])


def test_what_is_infinite_is_not_known():
    history = History(1)
    history.add(frame(0.0, energies=(np.inf, 1.0, 2.0)))
    np.testing.assert_array_equal(history.curves().energies, [[np.nan, 1.0, 2.0]])
