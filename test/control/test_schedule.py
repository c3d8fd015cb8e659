"""Of the targets that are due, the newest is in force."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.control import Target, TargetError, TargetSchedule

A, B, C = (Target(latent=np.array([value])) for value in (1.0, 2.0, 3.0))


def test_nothing_is_in_force_before_the_first_target():
    schedule = TargetSchedule()
    assert schedule.in_force(10**9) is None
    schedule.add(100, A)
    assert schedule.in_force(99) is None
    assert schedule.in_force(100) is A


def test_a_target_waits_for_its_stamp():
    schedule = TargetSchedule()
    schedule.add(10, A)
    schedule.add(20, B)
    assert [schedule.in_force(t) for t in (5, 10, 19, 20, 30)] == [None, A, A, B, B]


def test_a_stamp_of_zero_is_at_once():
    schedule = TargetSchedule()
    schedule.add(10, A)
    assert schedule.in_force(50) is A
    schedule.add(0, B)
    assert schedule.in_force(51) is B
    schedule.add(40, C)  # older than the moment at which B came
    assert schedule.in_force(52) is B


def test_of_equal_stamps_the_later_given_wins():
    schedule = TargetSchedule()
    schedule.add(10, A)
    schedule.add(10, B)
    assert schedule.in_force(10) is B
    schedule.add(10, C)
    assert schedule.in_force(11) is C


def test_an_older_target_given_later_does_not_count():
    schedule = TargetSchedule()
    schedule.add(20, A)
    assert schedule.in_force(20) is A
    schedule.add(15, B)
    assert schedule.in_force(25) is A


@given(st.permutations(range(1, 8)), st.lists(st.integers(1, 9), min_size=1, max_size=9))
def test_the_newest_due_is_in_force_however_they_came(stamps, questions):
    targets = {stamp: Target(latent=np.array([float(stamp)])) for stamp in stamps}
    schedule = TargetSchedule()
    for stamp in stamps:
        schedule.add(stamp, targets[stamp])
    for now in sorted(questions):
        assert schedule.in_force(now) is targets[min(now, 7)]


def test_a_restart_keeps_the_target_and_forgets_its_age():
    schedule = TargetSchedule()
    schedule.add(1000, A)
    assert schedule.in_force(1000) is A
    schedule.restart()
    assert schedule.in_force(1) is A
    schedule.add(2, B)
    assert schedule.in_force(2) is B


def test_a_restart_of_nothing_is_nothing():
    schedule = TargetSchedule()
    schedule.restart()
    assert schedule.in_force(1) is None


def test_targets_that_never_come_into_force_do_not_gather():
    schedule = TargetSchedule()
    for number in range(100):
        schedule.add(100 + number, A)
    with pytest.raises(TargetError, match='wait for their stamp'):
        schedule.add(200, B)
    schedule.add(100, C)  # instead of one that waits
    assert schedule.in_force(100) is C
    schedule.add(200, B)
