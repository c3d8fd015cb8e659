"""From a recipe to a checkpoint on disk: data, training, scores, provenance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from dpc_ros import __version__
from dpc_ros.autoencoder.checkpoint import Checkpoint, save_checkpoint
from dpc_ros.autoencoder.recipe import Recipe
from dpc_ros.autoencoder.training import reconstruction_mse, train
from dpc_ros.data import Dataset, load_dataset, make_dataset, save_dataset
from dpc_ros.network import MassSpringNetwork, load_network


def state_path(recipe: Recipe, folder: Path) -> Path:
    """Return where the state of an unfinished training lies."""
    return folder / f'{recipe.name}.state.safetensors'


def train_checkpoint(
    recipe: Recipe,
    folder: Path,
    data_folder: Path,
    data: Path | None = None,
    progress: bool = False,
) -> Path:
    """Train by a recipe and write the checkpoint; an unfinished training is taken up again.

    Args:
        recipe: what to train.
        folder: of the checkpoint and, meanwhile, of the state of the training.
        data_folder: where the data of a network are kept, and made where they are missing.
        data: file of the data, instead of the one in `data_folder`.
        progress: show progress bars.

    Returns:
        the path of the checkpoint's JSON.

    Raises:
        ValueError: the data belong to another network.
    """
    network = load_network(recipe.network)
    dataset = _dataset(network, data or data_folder / f'{network.name}.npz', progress)
    state = state_path(recipe, folder)
    module = train(recipe, dataset, state, progress)
    autoencoder = module.export()
    scores = {
        f'{split}_mse': reconstruction_mse(autoencoder, getattr(dataset, split))
        for split in ('train', 'validation', 'test')
    }
    checkpoint = Checkpoint(
        name=recipe.name,
        architecture=module.architecture,
        tensors=module.tensors(),
        network={'name': network.name, 'digest': network.digest},
        provenance={
            'recipe': recipe.as_dict(),
            'data': dataset.provenance,
            'scores': scores,
            'versions': {
                'dpc_ros': __version__,
                'numpy': np.__version__,
                'torch': torch.__version__,
            },
        },
    )
    path = save_checkpoint(checkpoint, folder)
    state.unlink(missing_ok=True)
    return path


def _dataset(network: MassSpringNetwork, path: Path, progress: bool) -> Dataset:
    if not path.is_file():
        save_dataset(make_dataset(network, progress=progress), path)
    dataset = load_dataset(path)
    digest = dataset.provenance['network_digest']
    if digest != network.digest:
        raise ValueError(
            f'{path} holds data of {dataset.provenance["network"]}@{digest}, the recipe is for '
            f'{network.identifier}: simulate that network, or name its data by --data'
        )
    return dataset
