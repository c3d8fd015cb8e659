"""From a recipe to a checkpoint on disk: data, training, scores, provenance."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from dpc_ros import __version__
from dpc_ros.autoencoder.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from dpc_ros.autoencoder.recipe import Recipe
from dpc_ros.autoencoder.training import reconstruction_mse, train
from dpc_ros.data import Dataset, extra_conditions, load_dataset, make_dataset, save_dataset
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
    on_epoch: Callable[[int, float], None] | None = None,
) -> Path:
    """Train by a recipe and write the checkpoint; an unfinished training is taken up again.

    Args:
        recipe: what to train.
        folder: of the checkpoint and, meanwhile, of the state of the training.
        data_folder: where the data of a network are kept, and made where they are missing.
        data: file of the data, instead of the one in `data_folder`.
        progress: show progress bars.
        on_epoch: as of `train`.

    Returns:
        the path of the checkpoint's JSON.

    Raises:
        ValueError: the data belong to another network.
    """
    network = load_network(recipe.network)
    dataset = dataset_for(network, data_folder, recipe.extra_simulations, data, progress)
    state = state_path(recipe, folder)
    module = train(recipe, network, dataset, state, progress, on_epoch)
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


def trained_checkpoint(
    recipe: Recipe,
    folder: Path,
    data_folder: Path,
    progress: bool = False,
    on_epoch: Callable[[int, float], None] | None = None,
) -> Checkpoint:
    """Return the checkpoint of a recipe from a folder; it is trained where it isn't there yet.

    Raises:
        ValueError: the folder holds a checkpoint of that name by another recipe or of another
            body, or the data belong to another network.
    """
    path = folder / f'{recipe.name}.json'
    if not path.is_file():
        train_checkpoint(recipe, folder, data_folder, progress=progress, on_epoch=on_epoch)
    checkpoint = load_checkpoint(path)
    checkpoint.check_network(load_network(recipe.network))
    try:
        stored = Recipe(**checkpoint.provenance['recipe'])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f'{path}: expected a recipe that this dpc_ros knows, but {error!r}: move the file away'
        ) from error
    if stored != recipe:
        raise ValueError(
            f'{path} was trained by another recipe than the one asked for: {stored} is not '
            f'{recipe}: move the file away, or train in another folder'
        )
    return checkpoint


def dataset_for(
    network: MassSpringNetwork,
    data_folder: Path,
    extra_simulations: int = 0,
    data: Path | None = None,
    progress: bool = False,
) -> Dataset:
    """Return the data of a network, simulated where their file is missing.

    Args:
        network: the body.
        data_folder: where the data of a network are kept.
        extra_simulations: how many train beside the paper's.
        data: file of the data, instead of the one in `data_folder`.
        progress: show progress bars.

    Raises:
        ValueError: the file holds data of another network.
    """
    name = f'{network.name}_plus{extra_simulations}' if extra_simulations else network.name
    path = data or data_folder / f'{name}.npz'
    if not path.is_file():
        extra = extra_conditions(extra_simulations)
        save_dataset(make_dataset(network, extra_conditions=extra, progress=progress), path)
    dataset = load_dataset(path)
    digest = dataset.provenance['network_digest']
    if digest != network.digest:
        raise ValueError(
            f'{path} holds data of {dataset.provenance["network"]}@{digest}, the recipe is for '
            f'{network.identifier}: simulate that network, or name its data by --data'
        )
    if extra_simulations and 'extra_thinning_distance_m' not in dataset.provenance:
        raise ValueError(
            f'{path} holds no extra simulations as a recipe with extra_simulations has them: move '
            'it away, and they are made anew'
        )
    return dataset
