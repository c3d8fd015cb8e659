"""Durations are summed up as they were measured, in bounded memory."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dpc_ros.nodes.window import RoundTrips, Window, jitter, percentiles

DURATIONS = arrays(float, st.integers(1, 500), elements=st.floats(0, 1e3))


def nearest_rank(values):
    return tuple(np.percentile(values, (50, 99, 100), method='inverted_cdf'))


@given(durations=DURATIONS)
def test_percentiles_are_those_of_numpy(durations):
    found = percentiles(durations)
    assert found == nearest_rank(durations)
    assert found.p50 <= found.p99 <= found.largest


@given(periods=DURATIONS)
def test_jitter_is_the_deviation_from_the_median_period(periods):
    median = nearest_rank(periods)[0]
    assert jitter(periods) == nearest_rank(abs(periods - median))


def test_where_nothing_was_measured_there_is_no_number():
    assert np.isnan([*percentiles(np.empty(0)), *jitter(np.empty(0))]).all()


@given(rounds=st.lists(st.lists(st.floats(0, 1e3), max_size=30), max_size=3))
def test_a_window_holds_the_newest_since_it_was_last_taken(rounds):
    window = Window(capacity=8)
    for durations in rounds:
        for duration in durations:
            window.add(duration)
        assert sorted(window.take()) == sorted(durations[-8:])


# What happens to one of three stamps.
@given(events=st.lists(st.tuples(st.sampled_from(['sent', 'answered']), st.integers(0, 2))))
def test_round_trips_are_those_of_stamps_sent_once(events):
    trips, sent, expected = RoundTrips(), {0: 0, 1: 0, 2: 0}, 0
    for event, stamp in events:
        getattr(trips, event)(stamp)
        if event == 'sent':
            sent[stamp] += 1
        else:
            expected += sent[stamp] == 1
            sent[stamp] = 0
    found = trips.window.take()
    assert len(found) == expected
    assert (found >= 0).all()


def test_what_is_never_answered_takes_bounded_memory():
    trips = RoundTrips()
    for stamp in range(10_000):
        trips.sent(stamp)
    trips.answered(0)  # long forgotten
    trips.answered(9_999)
    assert len(trips.window.take()) == 1
    trips.sent(1)
    trips.restart()
    trips.answered(1)
    assert not len(trips.window.take())
