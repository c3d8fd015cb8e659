"""Datasets hold the paper's configurations and come back from their files as they were."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from dpc_ros.data import (
    Condition,
    extra_conditions,
    load_dataset,
    make_dataset,
    save_dataset,
    simulate_conditions,
    thin,
)
from dpc_ros.data.conditions import test_conditions as paper_test_conditions
from dpc_ros.data.conditions import training_conditions
from dpc_ros.network import Gravity, load_network

KEPT = {  # configurations: training, validation
    'paper_1': (4009, 1230),
    'paper_2': (3370, 1469),
    'paper_3': (3362, 1044),
    'paper_4': (4216, 1707),
    'paper_5': (3630, 1630),
}
FEW = [
    Condition(1, 'train', Gravity(9.81), 'rest'),
    Condition(2, 'validation', Gravity(5.0, 0.3), 'continue'),
]
HELD_OUT = [
    Condition(3, 'test', Gravity(4.0), 'rest'),
    Condition(4, 'outside', Gravity(20.0), 'previous_end'),
    Condition(5, 'test', Gravity(7.0), 'previous_end'),
]


@pytest.fixture(scope='module')
def dataset(small_network):
    return make_dataset(small_network, FEW, HELD_OUT)


@pytest.fixture
def file(dataset, tmp_path):
    path = tmp_path / 'data' / 'grid.npz'
    save_dataset(dataset, path)
    return path


@pytest.mark.parametrize('name', KEPT)
def test_thinning_keeps_as_many_configurations_as_the_paper(name, paper_trajectories):
    kept = {'train': 0, 'validation': 0}
    for condition, trajectory in paper_trajectories(load_network(name)):
        kept[condition.split] += len(thin(trajectory.configuration))
    assert (kept['train'], kept['validation']) == KEPT[name]


def test_splits_hold_the_frames_of_their_simulations(dataset):
    assert set(dataset.train_simulation) == {1}
    assert set(dataset.validation_simulation) == {2}
    for split in ('train', 'validation', 'test'):
        assert len(getattr(dataset, split)) == len(getattr(dataset, f'{split}_simulation'))
    assert dataset.test.shape == dataset.test_velocity.shape


def test_the_test_set_keeps_every_second_frame_of_the_measured_simulations(dataset):
    numbers, counts = np.unique(dataset.test_simulation, return_counts=True)
    np.testing.assert_array_equal(numbers, [3, 5])
    np.testing.assert_array_equal(counts, [501, 501])
    np.testing.assert_array_equal(dataset.test_velocity[[0, 501]], 0)


def test_training_frames_are_thinned_within_their_simulation(dataset):
    np.testing.assert_array_equal(thin(dataset.train), np.arange(len(dataset.train)))
    np.testing.assert_array_equal(thin(dataset.validation), np.arange(len(dataset.validation)))


def test_provenance_tells_how_the_data_were_made(dataset, small_network):
    provenance = dataset.provenance
    assert provenance['network_digest'] == small_network.digest
    assert [c['simulation'] for c in provenance['conditions']] == [1, 2, 3, 4, 5]
    assert (provenance['duration_s'], provenance['step_s']) == (5.0, 0.005)
    assert (provenance['integrator'], provenance['thinning_distance_m']) == ('rk4', 0.1)


def test_round_trip_keeps_every_bit(dataset, file):
    loaded = load_dataset(file)
    for field in fields(dataset):
        if field.name != 'provenance':
            value = getattr(loaded, field.name)
            np.testing.assert_array_equal(value, getattr(dataset, field.name))
            assert value.dtype == getattr(dataset, field.name).dtype
    assert loaded.provenance == json.loads(json.dumps(dataset.provenance))
    assert [path.name for path in file.parent.iterdir()] == ['grid.npz']


@pytest.mark.parametrize(('extra', 'validation'), [(1, 1), (8, 1), (9, 2), (60, 8)])
def test_one_in_nine_extra_simulations_validates(extra, validation):
    conditions = extra_conditions(extra)
    splits = [c.split for c in conditions]
    assert splits == ['train'] * extra + ['validation'] * validation
    assert conditions[0].start == 'rest'
    papers = (*training_conditions(), *paper_test_conditions())
    numbers = {c.simulation for c in (*conditions, *papers)}
    assert len(numbers) == len(conditions) + 7 + 30


def test_extra_simulations_stand_beside_the_others_thinned_three_times_as_far(
    dataset, small_network
):
    conditions = [
        Condition(11, 'train', Gravity(8.0, -1.0), 'rest'),
        Condition(12, 'validation', Gravity(12.0, -2.0), 'previous_end'),
    ]
    both = make_dataset(small_network, FEW, HELD_OUT, extra_conditions=conditions)
    expected = {
        condition.split: trajectory.configuration[thin(trajectory.configuration, 0.3)]
        for condition, trajectory in simulate_conditions(small_network, conditions)
    }
    for split, number in (('train', 11), ('validation', 12)):
        frames = getattr(both, split)
        extra = getattr(both, f'{split}_simulation') == number
        np.testing.assert_array_equal(frames[~extra], getattr(dataset, split))
        np.testing.assert_array_equal(frames[extra], expected[split])
    np.testing.assert_array_equal(both.test, dataset.test)
    assert both.provenance['extra_thinning_distance_m'] == pytest.approx(0.3)
    assert 'extra_thinning_distance_m' not in dataset.provenance


def refuse(path):
    with pytest.raises(ValueError, match=r'expected a dataset as `dpc simulate` writes it') as e:
        load_dataset(path)
    assert str(path) in str(e.value)


@pytest.mark.parametrize('fraction', [0.0, 0.001, 0.3, 0.9, 0.999])
def test_truncated_files_are_refused(file, fraction):
    content = file.read_bytes()
    file.write_bytes(content[: int(fraction * len(content))])
    refuse(file)


def test_altered_files_are_refused(file):
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 0xFF
    file.write_bytes(content)
    refuse(file)


@pytest.mark.parametrize('content', [b'q,v\n1,2\n', b'\x80\x04]\x94.', b'PK\x03\x04'])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / 'other.npz'
    path.write_bytes(content)
    refuse(path)


def test_other_arrays_are_refused(tmp_path):
    np.savez(tmp_path / 'other.npz', train=np.zeros((2, 4)))
    refuse(tmp_path / 'other.npz')
    np.save(tmp_path / 'other.npy', np.zeros((2, 4)))
    refuse(tmp_path / 'other.npy')


def test_objects_are_never_unpickled(tmp_path, dataset):
    arrays = {f.name: getattr(dataset, f.name) for f in fields(dataset) if f.name != 'provenance'}
    arrays['train'] = np.array([{'an': 'object'}])
    np.savez(tmp_path / 'objects.npz', provenance='{}', **arrays)
    refuse(tmp_path / 'objects.npz')


def test_a_missing_file_is_missing(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_dataset(tmp_path / 'nothing.npz')


def test_conditions_without_a_split_are_refused(small_network):
    with pytest.raises(ValueError, match='validation'):
        make_dataset(small_network, FEW[:1], HELD_OUT)


def test_an_unwritable_dataset_leaves_the_old_one(dataset, file):
    before = file.read_bytes()
    with pytest.raises(TypeError):
        save_dataset(replace(dataset, provenance={'network': object()}), file)
    assert file.read_bytes() == before
    assert list(file.parent.iterdir()) == [file]
