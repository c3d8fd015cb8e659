"""States wait for the force before them, so that no order of two topics matters."""

from hypothesis import given, settings
from hypothesis import strategies as st

from dpc_ros.nodes.answers import Answers
from dpc_ros.nodes.turns import Turns

STEP = 5_000_000  # ns


@settings(max_examples=30)
@given(st.lists(st.booleans(), max_size=20))
def test_in_lockstep_force_and_state_may_come_in_any_order(force_first):
    turns, seen = Turns(), []

    def state(k):
        seen.extend(('state', each) for each in turns.come(k * STEP, k))

    def force(k):
        seen.append(('force', k))
        seen.extend(('state', each) for each in turns.answered(k * STEP))

    state(0)
    for k, first in enumerate(force_first):
        for act, number in ((force, k), (state, k + 1))[:: 1 if first else -1]:
            act(number)
    expected = [('state', 0)]
    for k in range(len(force_first)):
        expected += [('force', k), ('state', k + 1)]
    assert seen == expected


def test_a_state_waits_until_a_newer_one_comes():
    turns = Turns()
    assert turns.come(0, 'a') == ['a']
    assert turns.come(1, 'b') == []
    assert turns.waits(1)
    assert not turns.waits(0)
    assert turns.come(2, 'c') == ['b', 'c']
    assert not turns.waits(1)
    assert turns.come(3, 'd') == ['d']  # late: nobody waits
    assert turns.answered(0) == turns.answered(2) == []
    assert turns.come(4, 'e') == ['e']
    assert turns.answered(4) == []  # in time again
    assert turns.come(5, 'f') == ['f']
    assert turns.come(6, 'g') == []
    assert turns.answered(5) == ['g']


def test_a_motion_begins_where_stamps_fall_back_or_leap():
    answers = Answers()
    assert answers.newest == (-1, None)
    answers.remember(100 * STEP, 'question', 'answer')
    assert answers.newest == (100 * STEP, 'answer')
    assert answers.begins_anew(99 * STEP)
    assert not answers.begins_anew(200 * STEP)  # half a second
    assert answers.begins_anew(201 * STEP)
    assert not answers.starts_epoch(201 * STEP)
