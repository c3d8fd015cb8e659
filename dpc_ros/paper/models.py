"""Trained autoencoders for the experiments: taken from a folder, trained where they are missing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from dpc_ros.autoencoder import Autoencoder, Checkpoint, with_encoder
from dpc_ros.autoencoder.experiment import dataset_for, trained_checkpoint
from dpc_ros.data import Dataset
from dpc_ros.data.conditions import test_conditions
from dpc_ros.data.dataset import TEST_STRIDE
from dpc_ros.data.simulations import DURATION, STEP
from dpc_ros.data.thinning import THINNING_DISTANCE
from dpc_ros.network import load_network
from dpc_ros.paper.recipes import Model

_AS_THE_PAPER = {
    'duration_s': DURATION,
    'step_s': STEP,
    'integrator': 'rk4',
    'thinning_distance_m': THINNING_DISTANCE,
    'test_stride': TEST_STRIDE,
}
# Normalisation is a change of units and no parameter of the model; neither is the graph.
_NO_PARAMETERS = {
    'configuration_mean',
    'configuration_scale',
    'latent_mean',
    'latent_scale',
    'pod_scale',
    'edges',
}


@dataclass(frozen=True)
class Workshop:
    """Where the experiments keep their data and trainings.

    Attributes:
        data: folder of simulated data.
        training: folder of checkpoints and of states of unfinished trainings.
        results: folder of the files of measured numbers, that some experiments go on from.
        progress: show progress bars.
        law: of another package, that the control experiment is to add; empty runs all of this one.
        law_options: what it takes, as YAML.
    """

    data: Path
    training: Path
    results: Path
    progress: bool = True
    law: str = ''
    law_options: str = ''

    def trained(self, model: Model, system: str, latent_size: int) -> Trained:
        """Return the best of a model's trainings by validation error; all are run if need be."""
        checkpoints = [
            trained_checkpoint(recipe, self.training, self.data, self.progress)
            for recipe in model.candidates(system, latent_size)
        ]
        for checkpoint in checkpoints:
            _check_data(checkpoint.name, checkpoint.provenance['data'])
        best = min(checkpoints, key=lambda each: each.provenance['scores']['validation_mse'])
        return Trained(model, system, latent_size, best)

    def dataset(self, system: str) -> Dataset:
        """Return the paper's data of a system."""
        return _paper_dataset(self, system)


@dataclass(frozen=True)
class Trained:
    """A model on one system at one latent size, with its checkpoint."""

    model: Model
    system: str
    latent_size: int
    checkpoint: Checkpoint

    def autoencoder(self, encoder: str = 'network') -> Autoencoder:
        """Return the autoencoder, with the trained encoder or with the projection."""
        return with_encoder(self.checkpoint.autoencoder(), encoder)

    def columns(self, encoder: str = 'network') -> dict[str, Any]:
        """Return the columns that say which model a row is about."""
        return {
            'system': self.system,
            'model': self.model.name,
            'encoder': encoder,
            'recipe': self.model.recipe,
            'latent_size': self.latent_size,
            'training_data': self.model.training_data,
            'checkpoint': self.checkpoint.identifier,
            'parameters': parameters(self.checkpoint),
        }


def parameters(checkpoint: Checkpoint) -> int:
    """Return how many numbers a checkpoint's maps are made of: weights and POD basis."""
    return sum(
        value.size for name, value in checkpoint.tensors.items() if name not in _NO_PARAMETERS
    )


def in_batches(frames: np.ndarray, size: int) -> Iterator[np.ndarray]:
    """Yield consecutive batches; the last may be smaller."""
    for start in range(0, len(frames), size):
        yield frames[start : start + size]


@lru_cache(maxsize=1)  # a quarter of a gigabyte each
def _paper_dataset(workshop: Workshop, system: str) -> Dataset:
    dataset = dataset_for(load_network(system), workshop.data, progress=workshop.progress)
    _check_data(f'the data of {system} in {workshop.data}', dataset.provenance)
    return dataset


def _check_data(what: str, provenance: dict[str, Any]) -> None:
    """Make sure that data were made as the paper's: same step, integrator, thinning, test."""
    found = {key: provenance[key] for key in _AS_THE_PAPER}
    held_out = [each for each in provenance['conditions'] if each['split'] in ('test', 'outside')]
    papers = [asdict(condition) for condition in test_conditions()]
    if found != _AS_THE_PAPER or held_out != papers:
        raise ValueError(
            f'{what}: expected data by the defaults of `dpc simulate`, {_AS_THE_PAPER}, and the '
            f'test conditions of the paper, got {found}: move them away'
        )
