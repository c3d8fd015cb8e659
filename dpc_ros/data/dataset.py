"""The data of one network: training, validation and test configurations in one file."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from dpc_ros import __version__
from dpc_ros.data.conditions import (
    Condition,
    test_conditions,
    training_conditions,
)
from dpc_ros.data.simulations import DURATION, STEP, simulate_conditions
from dpc_ros.data.thinning import THINNING_DISTANCE, thin
from dpc_ros.files import replacing
from dpc_ros.network import MassSpringNetwork

TEST_STRIDE = 2  # the paper's test set keeps every second step
EXTRA_THINNING = 3.0  # times ε: of many simulations, frames that differ more


@dataclass(frozen=True, eq=False)
class Dataset:
    """Configurations of one network, split by simulation.

    Attributes:
        train: thinned configurations of the training simulations [m].
        validation: thinned configurations of the validation simulations [m].
        test: every second configuration of the test simulations, not thinned [m].
        test_velocity: velocities of the same frames [m/s].
        train_simulation, validation_simulation, test_simulation: number of the simulation that
            each frame comes from.
        provenance: how the data were made: network, conditions, step, thinning, versions.
    """

    train: Float[np.ndarray, 'train n']
    validation: Float[np.ndarray, 'validation n']
    test: Float[np.ndarray, 'test n']
    test_velocity: Float[np.ndarray, 'test n']
    train_simulation: Int[np.ndarray, ' train']
    validation_simulation: Int[np.ndarray, ' validation']
    test_simulation: Int[np.ndarray, ' test']
    provenance: dict[str, Any]


_ARRAYS = (
    'train',
    'validation',
    'test',
    'test_velocity',
    'train_simulation',
    'validation_simulation',
    'test_simulation',
)


def make_dataset(
    network: MassSpringNetwork,
    train_conditions: list[Condition] | None = None,
    held_out_conditions: list[Condition] | None = None,
    extra_conditions: Sequence[Condition] = (),
    thinning_distance: float = THINNING_DISTANCE,
    method: str = 'rk4',
    progress: bool = False,
) -> Dataset:
    """Simulate, thin and split the data of a network as the paper does (section A.1).

    Args:
        network: the body.
        train_conditions: training and validation simulations, the paper's where left out.
        held_out_conditions: test simulations, the paper's where left out.
        extra_conditions: more training and validation simulations, the first from rest.
        thinning_distance: ε [m], applied within each training and validation simulation, and three
            times as large within each extra one.
        method: of integration, a key of `INTEGRATORS`.
        progress: show a progress bar.

    Raises:
        ValueError: a split has no simulation, or a simulation diverges.
    """
    learning = training_conditions() if train_conditions is None else train_conditions
    held_out = test_conditions() if held_out_conditions is None else held_out_conditions
    _check_splits(learning, {'train', 'validation'}, {'train', 'validation'})
    _check_splits(held_out, {'test'}, {'test', 'outside'})
    _check_splits(extra_conditions, set(), {'train', 'validation'})
    frames: dict[str, list[np.ndarray]] = {name: [] for name in _ARRAYS}
    bar = tqdm(
        total=len(learning) + len(extra_conditions) + len(held_out),
        desc=f'simulating {network.name}',
        unit='simulation',
        disable=not progress,
    )
    with bar:
        for conditions, distance in (
            (learning, thinning_distance),
            (extra_conditions, EXTRA_THINNING * thinning_distance),
        ):
            for condition, trajectory in simulate_conditions(network, conditions, method=method):
                kept = thin(trajectory.configuration, distance)
                number = np.full(len(kept), condition.simulation)
                frames[condition.split].append(trajectory.configuration[kept])
                frames[f'{condition.split}_simulation'].append(number)
                bar.update()
        for condition, trajectory in simulate_conditions(network, held_out, method=method):
            if condition.split == 'test':
                kept = np.arange(0, len(trajectory.configuration), TEST_STRIDE)
                frames['test'].append(trajectory.configuration[kept])
                frames['test_velocity'].append(trajectory.velocity[kept])
                frames['test_simulation'].append(np.full(len(kept), condition.simulation))
            bar.update()
    provenance = {
        'network': network.name,
        'network_digest': network.digest,
        'conditions': [asdict(each) for each in (*learning, *extra_conditions, *held_out)],
        'duration_s': DURATION,
        'step_s': STEP,
        'integrator': method,
        'thinning_distance_m': thinning_distance,
        'test_stride': TEST_STRIDE,
        'dpc_ros': __version__,
        'numpy': np.__version__,
    }
    if extra_conditions:
        provenance['extra_thinning_distance_m'] = EXTRA_THINNING * thinning_distance
    return Dataset(
        **{name: np.concatenate(parts) for name, parts in frames.items()}, provenance=provenance
    )


def save_dataset(dataset: Dataset, path: str | Path) -> None:
    """Write a dataset as one `.npz` file; nothing is left half-written."""
    with replacing(path) as partial, partial.open('wb') as file:
        np.savez(
            file,
            provenance=json.dumps(dataset.provenance),
            **{name: getattr(dataset, name) for name in _ARRAYS},
        )


def load_dataset(path: str | Path) -> Dataset:
    """Read a dataset that `save_dataset` wrote.

    Raises:
        ValueError: the file is no dataset.
    """
    try:
        with Path(path).open('rb') as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in _ARRAYS}
            provenance = json.loads(str(file['provenance']))
    except (
        OSError,
        ValueError,
        KeyError,
        EOFError,
        TypeError,
        RecursionError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise ValueError(
            f'{path}: expected a dataset as `dpc simulate` writes it, but {error}'
        ) from error
    return Dataset(**arrays, provenance=provenance)


def _check_splits(conditions: Sequence[Condition], needed: set[str], known: set[str]) -> None:
    splits = {condition.split for condition in conditions}
    if not needed <= splits <= known:
        raise ValueError(
            f'conditions: expected simulations of the splits {sorted(needed)}, got {sorted(splits)}'
        )
