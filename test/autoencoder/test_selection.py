"""A grid search on Ray trains every combination, orders by validation, leaves nothing behind."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import product
from pathlib import Path
from select import select as wait_for

import numpy as np
import pytest
import ray
import yaml

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.autoencoder.experiment import dataset_for
from dpc_ros.autoencoder.recipe import Recipe
from dpc_ros.autoencoder.selection import PAPER_GRIDS, grid_recipes, load_grid, select
from dpc_ros.autoencoder.training import reconstruction_mse
from dpc_ros.data import save_dataset
from dpc_ros.network import load_network

END_TIMEOUT = 60  # s, for processes that are told to end
START_TIMEOUT = 180  # s, for a search to begin
GRID = {'learning_rate': [3e-3, 1e-3], 'hidden_sizes': [[8], [6, 4]]}
SEARCHED = {'learning_rate': [3e-3, 1e-3]}


@pytest.fixture(scope='module')
def recipe(workplace):
    return Recipe(
        'tiny',
        workplace.network,
        latent_size=2,
        skip=True,
        activation='silu',
        epochs=3,
        schedule='one_cycle',
    )


@pytest.fixture(scope='module')
def data_folder(workplace, tmp_path_factory):
    """The data of the small network, its test part no numbers: nothing may depend on it."""
    folder = tmp_path_factory.mktemp('data')
    nothing = np.full_like(workplace.dataset.test, np.nan)
    save_dataset(replace(workplace.dataset, test=nothing), folder / 'grid.npz')
    return folder


@pytest.fixture(scope='module')
def search(recipe, data_folder, tmp_path_factory):
    """A search of two trainings: its folder and its rows."""
    folder = tmp_path_factory.mktemp('search')
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('DPC_ROS_SEARCH', str(folder))  # every process of Ray inherits it
        return folder, select(grid_recipes(recipe, SEARCHED), folder, data_folder, parallel=1)


def still_running(mark, timeout=END_TIMEOUT):
    """Return the processes that were started with a mark in their environment and do not end."""
    found = []
    for environment in Path('/proc').glob('[0-9]*/environ'):
        # Processes end while they are looked at, and some belong to others.
        with contextlib.suppress(OSError):
            if mark.encode() in environment.read_bytes():
                number = int(environment.parent.name)
                process = os.pidfd_open(number)
                ended, _, _ = wait_for([process], [], [], timeout)
                os.close(process)
                found += [] if ended else [number]
    return found


def test_a_grid_gives_every_combination_once(recipe):
    recipes = grid_recipes(recipe, GRID)
    combinations = {(r.learning_rate, r.hidden_sizes) for r in recipes}
    assert combinations == set(product([3e-3, 1e-3], [(8,), (6, 4)]))
    assert len(recipes) == len({r.name for r in recipes}) == 4
    assert all(r.name.startswith('tiny_') for r in recipes)
    same = {'name': 'tiny', **{key: getattr(recipe, key) for key in GRID}}
    assert all(replace(r, **same) == recipe for r in recipes)
    assert grid_recipes(recipe, {}) == [replace(recipe, name='tiny_001')]


@pytest.mark.parametrize(('kind', 'count'), [('flat', 36), ('graph', 48)])
def test_the_papers_grids_are_grids_of_recipes(recipe, kind, count):
    assert len(grid_recipes(replace(recipe, kind=kind), PAPER_GRIDS[kind])) == count


def test_bad_grids_are_refused(recipe):
    with pytest.raises(ValueError, match=r"grid: \['depth'\] are no fields of a recipe"):
        grid_recipes(recipe, {'depth': [2, 3], 'seed': [0]})
    with pytest.raises(ValueError, match='latent_size: expected a whole number'):
        grid_recipes(recipe, {'latent_size': [2, 0]})


def test_a_grid_is_read_from_yaml(tmp_path):
    path = tmp_path / 'grid.yaml'
    path.write_text('learning_rate: [3.0e-3, 1.0e-3]\nhidden_sizes: [[8], [6, 4]]\n')
    assert load_grid(path) == GRID


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('learning_rate: [1.0e-3\n', 'expected YAML'),
        ('', 'each with a list of values'),
        ('- 1\n', 'each with a list of values'),
        ('learning_rate: 1.0e-3\n', 'each with a list of values'),
        ('learning_rate: []\n', 'each with a list of values'),
        ('\x00', 'expected YAML'),
        ('[' * 100_000, 'expected YAML'),
    ],
)
def test_files_that_are_no_grid_are_refused(tmp_path, text, message):
    path = tmp_path / 'grid.yaml'
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        load_grid(path)
    assert str(path) in str(caught.value)


def test_a_missing_grid_is_missing(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_grid(tmp_path / 'nothing.yaml')


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        (None, 'expected at least one, and different names'),
        ([{}, {}], 'expected at least one, and different names'),
        ([{}, {'name': 'other', 'network': 'paper_1'}], 'all of one network'),
        ([{}, {'name': 'other', 'extra_simulations': 8}], 'all of one network and its data'),
    ],
)
def test_recipes_that_can_not_be_compared_are_refused(recipe, tmp_path, changes, message):
    recipes = [replace(recipe, **change) for change in changes or []]
    with pytest.raises(ValueError, match=message):
        select(recipes, tmp_path / 'search', tmp_path / 'data')
    assert list(tmp_path.iterdir()) == []


def test_a_search_trains_all_and_orders_them_by_their_validation_error(search, recipe, workplace):
    folder, rows = search
    expected = {r.name: r for r in grid_recipes(recipe, SEARCHED)}
    assert {row['name'] for row in rows} == expected.keys()
    errors = [row['validation_mse'] for row in rows]
    assert errors == sorted(errors)
    for row in rows:
        checkpoint = load_checkpoint(folder / f'{row["name"]}.json')
        assert checkpoint.provenance['recipe'] == expected[row['name']].as_dict()
        autoencoder = checkpoint.autoencoder()
        for split in ('train', 'validation'):
            error = reconstruction_mse(autoencoder, getattr(workplace.dataset, split))
            assert row[f'{split}_mse'] == pytest.approx(error, rel=1e-12)
        assert row['epochs'] == 3
        assert 'test_mse' not in row
        assert row.items() >= expected[row['name']].as_dict().items()


def test_a_search_leaves_no_process_behind(search):
    assert not ray.is_initialized()
    assert still_running(f'DPC_ROS_SEARCH={search[0]}') == []


@pytest.mark.long
def test_a_search_cut_off_by_ctrl_c_says_that_it_can_be_taken_up(workplace, recipe, tmp_path):
    endless = replace(recipe, epochs=1_000_000, schedule='step').as_dict()
    (tmp_path / 'endless.yaml').write_text(yaml.safe_dump(endless))
    (tmp_path / 'grid.yaml').write_text('learning_rate: [1.0e-3, 3.0e-3]\n')
    mark = f'DPC_ROS_SEARCH={tmp_path}'
    options = '--config endless.yaml --grid grid.yaml --output . --parallel 1'
    process = subprocess.Popen(
        [sys.executable, '-m', 'dpc_ros.cli', 'select', *options.split()],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, 'DPC_ROS_SEARCH': str(tmp_path)},
        start_new_session=True,
    )
    folder = tmp_path / 'tiny_grid'
    deadline = time.monotonic() + START_TIMEOUT
    try:
        while process.poll() is None and not any(folder.glob('*.state.safetensors')):
            assert time.monotonic() < deadline, 'gave up waiting for a first state'
            time.sleep(0.05)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)  # as the terminal does
        output, _ = process.communicate(timeout=END_TIMEOUT)
        left = still_running(mark)
    finally:
        process.kill()
        for number in still_running(mark, 0):
            os.kill(number, signal.SIGKILL)
    assert process.returncode == 130, output
    assert output.endswith('the same command takes the search up again\nstopped\n')
    assert any(folder.glob('*.state.safetensors'))
    assert left == []


def test_data_made_without_extra_simulations_are_refused(workplace, tmp_path):
    save_dataset(workplace.dataset, tmp_path / 'grid_plus8.npz')
    with pytest.raises(ValueError, match='holds no extra simulations') as caught:
        dataset_for(load_network(workplace.network), tmp_path, extra_simulations=8)
    assert 'grid_plus8.npz' in str(caught.value)


def test_a_second_search_finds_everything_done(search, recipe, data_folder):
    folder, rows = search
    before = {path: path.stat().st_mtime_ns for path in folder.glob('*.json')}
    assert select(grid_recipes(recipe, SEARCHED), folder, data_folder, parallel=1) == rows
    assert {path: path.stat().st_mtime_ns for path in folder.glob('*.json')} == before


@pytest.mark.long
def test_early_stopping_ends_a_training_that_is_behind(recipe, data_folder, tmp_path):
    good = replace(recipe, name='good', skip=False, epochs=24, batch_size=16)
    bad = replace(good, name='bad', learning_rate=0.0)
    rows = select([good, bad], tmp_path, data_folder, parallel=1, early_stopping=True)
    assert [row['name'] for row in rows] == ['good', 'bad']
    assert (rows[0]['epochs'], rows[0]['train_mse'] is None) == (24, False)
    assert (rows[1]['epochs'], rows[1]['train_mse']) == (20, None)
    assert [path.name for path in tmp_path.glob('*.json')] == ['good.json']
