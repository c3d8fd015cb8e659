"""The paper's conditions are read as they are; a bad file names its line."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.data import load_conditions
from dpc_ros.data.conditions import random_conditions, training_conditions
from dpc_ros.data.conditions import test_conditions as held_out_conditions

HEADER = 'simulation,split,gravity_m_s2,angle_rad,start\n'
GOOD = '1,train,9.81,-1.5,rest\n'


def test_the_papers_training_and_validation_simulations():
    conditions = training_conditions()
    assert [c.simulation for c in conditions] == [1, 2, 3, 4, 5, 6, 7]
    assert [c.split for c in conditions] == ['train'] * 5 + ['validation'] * 2
    assert {c.start for c in conditions} == {'rest', 'continue'}


def test_the_papers_test_set_is_28_simulations():
    conditions = held_out_conditions()
    measured = [c for c in conditions if c.split == 'test']
    assert len(measured) == len({c.simulation for c in measured}) == 28
    assert {c.split for c in conditions} == {'test', 'outside'}
    assert {c.start for c in conditions} == {'rest', 'previous_end'}


@given(st.integers(1, 60), st.integers(0, 10), st.integers(0, 10_000))
def test_random_simulations_stay_in_the_papers_range(training, validation, seed):
    conditions = random_conditions(training, validation, seed)
    assert [c.split for c in conditions] == ['train'] * training + ['validation'] * validation
    assert all(3.0 <= c.gravity.magnitude <= 17.0 for c in conditions)
    assert all(-0.75 * np.pi <= c.gravity.angle <= -0.25 * np.pi for c in conditions)
    assert conditions[0].start == 'rest'
    assert {c.start for c in conditions} <= {'rest', 'previous_end'}


def test_random_simulations_follow_their_seed():
    assert random_conditions(20, 5, 3) == random_conditions(20, 5, 3)
    assert random_conditions(20, 5, 3) != random_conditions(20, 5, 4)
    # More of them begin with the same ones.
    gravity = [c.gravity for c in random_conditions(40, 5)]
    assert [c.gravity for c in random_conditions(20, 5)] == gravity[:25]


def test_no_random_simulation_is_one_of_the_papers():
    papers = [*training_conditions(), *held_out_conditions()]
    conditions = random_conditions(500, 100)
    assert {c.gravity for c in conditions}.isdisjoint({c.gravity for c in papers})
    numbers = {c.simulation for c in conditions}
    assert len(numbers) == 600
    assert numbers.isdisjoint({c.simulation for c in papers})


def test_reads_a_file(tmp_path):
    path = tmp_path / 'conditions.csv'
    path.write_text(HEADER + GOOD + '2,validation,3,0.5,continue\n')
    first, second = load_conditions(path)
    assert (first.simulation, first.split, first.start) == (1, 'train', 'rest')
    assert (first.gravity.magnitude, first.gravity.angle) == (9.81, -1.5)
    assert (second.gravity.magnitude, second.start) == (3.0, 'continue')


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', 'at least one condition'),
        (HEADER, 'at least one condition'),
        (HEADER + '1,train,9.81,-1.5,continue\n', 'the first starting from rest'),
        (HEADER + GOOD + '2,train,9.81,-1.5,somewhere\n', r'line 3: .*somewhere'),
        (HEADER + GOOD + '2,training,9.81,-1.5,rest\n', r"line 3: .*split 'training'"),
        (HEADER + GOOD + '2,train,fast,-1.5,rest\n', r'line 3: .*fast'),
        (HEADER + GOOD + '2,train,-9.81,-1.5,rest\n', r'line 3: .*gravity'),
        (HEADER + GOOD + '2,train,nan,-1.5,rest\n', r'line 3: .*gravity'),
        (HEADER + GOOD + 'two,train,9.81,-1.5,rest\n', r'line 3: .*two'),
        (HEADER + GOOD + '2,train,9.81\n', r'line 3: '),
        ('simulation,split,gravity_m_s2,start\n1,train,9.81,rest\n', r'line 2: .*angle_rad'),
        ('simulation,gravity_m_s2,angle_rad,start\n1,1,1,rest\n', r'line 2: .*in_paper_28'),
    ],
)
def test_bad_files_are_refused(tmp_path, text, message):
    path = tmp_path / 'conditions.csv'
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        load_conditions(path)
    assert str(path) in str(caught.value)
