"""Model selection by grid search on Ray Tune: on this machine, or on a cluster by its address."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import ray
import yaml
from ray import tune
from ray.tune.schedulers import ASHAScheduler
from tqdm import tqdm

from dpc_ros.autoencoder.experiment import dataset_for, trained_checkpoint
from dpc_ros.autoencoder.recipe import Recipe
from dpc_ros.network import load_network

_GRACE = 20  # epochs before early stopping may end a training
# Table of section A.2.
PAPER_GRIDS: dict[str, dict[str, list[float]]] = {
    'flat': {
        'learning_rate': [1e-3, 5e-4, 1e-4],
        'weight_decay': [1e-5, 1e-6, 1e-7],
        'step_factor': [0.3, 0.5],
        'step_epochs': [100, 200],
    },
    'graph': {
        'learning_rate': [1e-2, 6e-3, 3e-3, 1e-3],
        'weight_decay': [1e-5, 1e-6, 1e-7],
        'step_factor': [0.7, 0.8],
        'step_epochs': [30, 40],
    },
}


def grid_recipes(recipe: Recipe, grid: Mapping[str, Sequence[Any]]) -> list[Recipe]:
    """Return a recipe with every combination of the values of a grid, named by a number.

    Raises:
        ValueError: a key of the grid is no field of a recipe, or a value is out of its range.
    """
    unknown = sorted(grid.keys() - recipe.as_dict().keys())
    if unknown:
        raise ValueError(f'grid: {unknown} are no fields of a recipe')
    combinations = list(product(*grid.values()))
    return [
        replace(recipe, name=f'{recipe.name}_{number:03d}', **dict(zip(grid, values, strict=True)))
        for number, values in enumerate(combinations, start=1)
    ]


def load_grid(path: str | Path) -> dict[str, list[Any]]:
    """Read a grid from a YAML file: fields of a recipe, each with a list of values.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is not YAML, or a field has no list of values.
    """
    try:
        content = yaml.safe_load(Path(path).read_text())
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f'{path}: expected YAML, but {" ".join(str(error).split())}') from error
    if not isinstance(content, dict) or not all(
        isinstance(values, list) and values for values in content.values()
    ):
        raise ValueError(f'{path}: expected fields of a recipe, each with a list of values')
    return content


def select(
    recipes: Sequence[Recipe],
    folder: Path,
    data_folder: Path,
    address: str | None = None,
    parallel: int | None = None,
    early_stopping: bool = False,
    progress: bool = False,
) -> list[dict[str, Any]]:
    """Train by each recipe and return one row each, the best validation error first.

    Only training and validation data decide. Checkpoints and states of unfinished trainings are
    kept in the folder, so that a search that was cut off goes on where it stopped.

    Args:
        recipes: what to train, all of one network.
        folder: of checkpoints and states; on a cluster, one that all its machines share.
        data_folder: where the data are kept, and made where they are missing; shared likewise.
        address: of a running Ray cluster, none to start one on this machine.
        parallel: trainings at a time, as many as there are cores where left out.
        early_stopping: end trainings early that are behind (ASHA), instead of training all in full.
        progress: show a progress bar.

    Returns:
        the fields of each recipe, and epochs, train_mse (none where it was stopped early) and
        validation_mse.

    Raises:
        ValueError: there is no recipe, names repeat, networks differ, parallel is not positive, or
            a training fails.
        ConnectionError: there is no cluster at the address.
    """
    if not recipes or len({recipe.name for recipe in recipes}) != len(recipes):
        raise ValueError('recipes: expected at least one, and different names')
    if len({(recipe.network, recipe.extra_simulations) for recipe in recipes}) != 1:
        raise ValueError('recipes: expected all of one network and its data')
    if parallel is not None and parallel < 1:
        raise ValueError(f'parallel: expected at least 1 training at a time, got {parallel}')
    folder, data_folder = folder.absolute(), data_folder.absolute()
    # Once, before many trainings would make them side by side.
    first = recipes[0]
    dataset_for(
        load_network(first.network), data_folder, first.extra_simulations, progress=progress
    )
    done = [recipe for recipe in recipes if (folder / f'{recipe.name}.json').is_file()]
    missing = [recipe for recipe in recipes if recipe not in done]
    rows = [_row_of_checkpoint(recipe, folder, data_folder) for recipe in done]
    if missing:
        rows += _search(missing, folder, data_folder, address, parallel, early_stopping, progress)
    return sorted(rows, key=lambda row: row['validation_mse'])


def _search(
    recipes: Sequence[Recipe],
    folder: Path,
    data_folder: Path,
    address: str | None,
    parallel: int | None,
    early_stopping: bool,
    progress: bool,
) -> list[dict[str, Any]]:
    """Run the trainings on the cluster at the address, or on one of this machine's own."""
    started = not ray.is_initialized()
    if started:
        ray.init(
            address, include_dashboard=False, log_to_driver=False, num_cpus=_cpus(address, parallel)
        )
    try:
        return _run(recipes, folder, data_folder, parallel, early_stopping, progress)
    finally:
        if started:
            ray.shutdown()


def _run(
    recipes: Sequence[Recipe],
    folder: Path,
    data_folder: Path,
    parallel: int | None,
    early_stopping: bool,
    progress: bool,
) -> list[dict[str, Any]]:
    # Tune's own handler would end the search on Ctrl-C as if it were done.
    os.environ['TUNE_DISABLE_SIGINT_HANDLER'] = '1'
    by_name = {recipe.name: recipe for recipe in recipes}
    scheduler = None
    if early_stopping:
        longest = max(recipe.epochs for recipe in recipes)
        # Not stopped at its last epoch: its checkpoint is still to be written.
        scheduler = ASHAScheduler(
            'epochs', max_t=longest, grace_period=min(_GRACE, longest), stop_last_trials=False
        )
    with tqdm(total=len(recipes), desc='selecting', unit='training', disable=not progress) as bar:
        grid = tune.Tuner(
            tune.with_resources(
                tune.with_parameters(_train, folder=folder, data_folder=data_folder), {'cpu': 1}
            ),
            param_space={'recipe': tune.grid_search([r.as_dict() for r in recipes])},
            tune_config=tune.TuneConfig(
                metric='validation_mse',
                mode='min',
                scheduler=scheduler,
                max_concurrent_trials=parallel,
            ),
            run_config=tune.RunConfig(
                name='trials',
                storage_path=str(folder / 'ray'),
                verbose=0,
                callbacks=[_Progress(bar)],
            ),
        ).fit()
    if grid.errors:
        raise ValueError(f'{len(grid.errors)} trainings failed, the first with: {grid.errors[0]}')
    rows = []
    for i in range(len(grid)):
        metrics = grid[i].metrics or {}
        recipe = by_name[metrics['config']['recipe']['name']]
        rows.append(_row(recipe, metrics))
    return rows


def _row(recipe: Recipe, metrics: Mapping[str, Any]) -> dict[str, Any]:
    return {
        **recipe.as_dict(),
        'epochs': metrics['epochs'],
        'train_mse': metrics.get('train_mse'),
        'validation_mse': metrics['validation_mse'],
    }


def _row_of_checkpoint(recipe: Recipe, folder: Path, data_folder: Path) -> dict[str, Any]:
    checkpoint = trained_checkpoint(recipe, folder, data_folder)
    return _row(recipe, {'epochs': recipe.epochs, **checkpoint.provenance['scores']})


def _train(config: dict[str, Any], folder: Path, data_folder: Path) -> None:
    """Train one recipe in a process of Ray."""
    recipe = Recipe(**config['recipe'])

    def report(epoch: int, validation: float) -> None:
        tune.report({'epochs': epoch + 1, 'validation_mse': validation})

    checkpoint = trained_checkpoint(recipe, folder, data_folder, on_epoch=report)
    scores = checkpoint.provenance['scores']
    tune.report(
        {
            'epochs': recipe.epochs,
            'validation_mse': scores['validation_mse'],
            'train_mse': scores['train_mse'],
        }
    )


class _Progress(tune.Callback):
    """Counts finished trainings and shows the best."""

    def __init__(self, bar: tqdm) -> None:
        self._bar = bar
        self._best = float('inf')

    def on_trial_complete(self, iteration: int, trials: list, trial: Any, **info: Any) -> None:
        self._best = min(self._best, trial.last_result.get('validation_mse', self._best))
        self._bar.set_postfix(best=f'{self._best:.2e}')
        self._bar.update()


def _cpus(address: str | None, parallel: int | None) -> int | None:
    """Return the cores that a cluster on this machine offers; none leaves it to Ray."""
    return parallel if address is None else None
