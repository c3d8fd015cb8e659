"""Period, age and losses of a run, by the times and numbers of its messages."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.bag import measure_timing, read_run
from dpc_ros.bag.reader import Arrivals

STEP = 5_000_000  # ns
TIMES = st.lists(st.integers(0, 2**62), min_size=20, max_size=20)


@pytest.fixture(scope='module')
def run(small_log, record):
    return read_run(record(small_log))


def at(times):
    times = np.array(times)
    return Arrivals(times, times, np.zeros_like(times))


@given(received=TIMES)
def test_a_period_is_the_time_between_two_arrivals(run, received):
    timing = measure_timing(replace(run, arrivals={'configuration': at(received)}))
    assert timing.period_time.tolist() == pytest.approx([5e-3 * k for k in range(1, 20)])
    goes_on = np.diff(received) >= 0  # else another simulator has begun
    assert np.isnan(timing.period).tolist() == (~goes_on).tolist()
    np.testing.assert_allclose(timing.period[goes_on], np.diff(received)[goes_on] / 1e9)
    assert not len(timing.age)


@given(asked=TIMES, wait=st.lists(st.integers(-1000, 10**12), min_size=19, max_size=19))
def test_an_age_is_from_a_configuration_to_the_force_of_its_stamp(run, asked, wait):
    answered = np.array(asked[:-1]) + wait  # the last one has no force
    arrivals = {'configuration': at(asked), 'control_force': at(answered)}
    timing = measure_timing(replace(run, arrivals=arrivals))
    assert timing.age_time.tolist() == pytest.approx([5e-3 * k for k in range(19)])
    expected = [each / 1e9 if each >= 0 else np.nan for each in wait]
    np.testing.assert_allclose(timing.age, expected)


def test_losses_are_counted_from_where_they_are_noticed(small_log, record):
    numbers = [*range(1, 6), *range(8, 23)]
    timing = measure_timing(
        read_run(record(replace(small_log, sequences={'configuration': numbers})))
    )
    assert timing.lost['configuration'].tolist() == [0] * 5 + [2] * 15
    assert not timing.lost['latent_state'].any()
    assert not timing.lost['control_force'].any()


def test_a_log_without_times_has_no_timing(run):
    timing = measure_timing(replace(run, arrivals={}))
    assert not len(timing.period)
    assert not len(timing.age)
    assert timing.lost == {}
