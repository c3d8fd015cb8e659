"""The measured delay is that of the loop, whatever single messages do; it counts in whole steps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpc_ros.control.delay import DelayMeter

MILLISECOND = 1_000_000  # ns
STEP = 5 * MILLISECOND  # of the stamps


def measured(out, processing, back, period=STEP, offset=0, messages=60, late=(), every=1):
    """Return what a meter saw of a loop; the force's way back is not what it sees."""
    meter = DelayMeter()
    for k in range(0, every * messages, every):
        sent = 10**18 + k * period
        received = sent + out + offset + (10 * period if k in late else 0)
        meter.configuration(k * STEP, k, sent, received)
        meter.force(k * STEP, received + processing)
    return meter, (out + processing + back) * 1e-9


milliseconds = st.integers(0, 30).map(lambda tenths: tenths * MILLISECOND // 10)


@settings(max_examples=30)
@given(
    milliseconds, milliseconds, st.sampled_from([1, 2, 5]), st.sets(st.integers(0, 59), max_size=9)
)
def test_it_is_the_way_out_twice_and_what_lies_between(way, processing, factor, late):
    """Some messages that come late don't matter, nor does the pace of simulated time."""
    period = STEP // factor
    meter, delay = measured(way, processing, way, period, late=late)
    assert meter.delay == pytest.approx(delay, abs=1e-9)
    assert meter.is_believable
    assert meter.acting_delay == pytest.approx((2 * way + processing) // period * STEP * 1e-9)


def test_nothing_is_said_before_enough_was_seen():
    meter, _ = measured(MILLISECOND, MILLISECOND, MILLISECOND, messages=5)
    assert meter.delay is None
    assert meter.is_believable
    assert meter.acting_delay == 0
    meter.force(4 * STEP, 10**19)  # a force that comes again says nothing
    assert meter.delay is None
    meter, _ = measured(MILLISECOND, MILLISECOND, MILLISECOND)
    meter.restart()
    assert meter.delay is None


def test_a_state_that_is_sent_again_counts_from_then():
    meter, drawn = DelayMeter(), np.random.default_rng(0).integers(1, 100, 40)
    number = 0
    for k, wait in enumerate(drawn):
        sent = 10**18 + k * STEP
        for again in (0, int(wait) * STEP):
            number += 1
            meter.configuration(k * STEP, number, sent + again, sent + again)
        meter.force(k * STEP, sent + again + MILLISECOND)
    assert meter.delay == pytest.approx(1e-3)


@pytest.mark.parametrize('every', [1, 2, 3])
def test_states_that_are_left_out_do_not_make_steps_longer(every):
    meter, delay = measured(5 * MILLISECOND, 2 * MILLISECOND, 5 * MILLISECOND, every=every)
    assert meter.delay == pytest.approx(delay)
    assert meter.acting_delay == pytest.approx(10e-3)


@pytest.mark.parametrize('offset', [-60 * 10**9, 60 * 10**9])
def test_clocks_that_differ_are_not_believed(offset):
    meter, _ = measured(MILLISECOND, MILLISECOND, MILLISECOND, offset=offset)
    assert not meter.is_believable
    assert meter.acting_delay == 0
