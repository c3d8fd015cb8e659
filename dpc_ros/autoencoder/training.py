"""Training of an autoencoder by a recipe: one loop, resumable, the best validation epoch kept."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from tqdm import tqdm

from dpc_ros.autoencoder.architecture import FlatArchitecture
from dpc_ros.autoencoder.base import Autoencoder
from dpc_ros.autoencoder.flat_module import FlatModule
from dpc_ros.autoencoder.recipe import Recipe
from dpc_ros.data import Dataset

SAVE_INTERVAL = 10  # epochs between two states on disk
_EPOCHS_PER_SEED = 1_000_000  # so that no two epochs of two seeds share their batches


def train(
    recipe: Recipe,
    dataset: Dataset,
    state_path: str | Path | None = None,
    progress: bool = False,
) -> FlatModule:
    """Train a flat autoencoder on the reconstruction error (paper, section II and A.2).

    The loss is the mean square error of D(E(q)) against q. Initial weights follow from the seed,
    the batches of an epoch from seed and epoch, so that a resumed training repeats an unbroken one.

    Args:
        recipe: what to train.
        dataset: configurations; only training and validation are looked at.
        state_path: file of the state of an unfinished training: read where it exists, written
            every `SAVE_INTERVAL` epochs, removed at the end.
        progress: show a progress bar with training and validation error.

    Returns:
        the module with the weights of the best validation epoch and normalised latents.

    Raises:
        ValueError: the state on disk is damaged, of another recipe or on other data, or no epoch
            had a finite validation error.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(recipe.seed)
        module = FlatModule(_architecture(recipe, dataset))
    if recipe.skip:
        module.fit_normalisation(dataset.train)
    train_set = torch.from_numpy(dataset.train).float()
    validation_set = torch.from_numpy(dataset.validation).float()
    optimizer = torch.optim.Adam(module.parameters(), weight_decay=recipe.weight_decay)
    steps_per_epoch = -(-len(train_set) // recipe.batch_size)
    state = _TrainingState(recipe, dataset, module, optimizer, state_path)

    bar = tqdm(
        range(state.epoch, recipe.epochs),
        initial=state.epoch,
        total=recipe.epochs,
        desc=f'training {recipe.name}',
        unit='epoch',
        disable=not progress,
    )
    for epoch in bar:
        generator = torch.Generator().manual_seed(recipe.seed * _EPOCHS_PER_SEED + epoch)
        order = torch.randperm(len(train_set), generator=generator)
        module.train()
        total = 0.0
        for k, batch in enumerate(order.split(recipe.batch_size)):
            for group in optimizer.param_groups:
                group['lr'] = recipe.learning_rate_at(epoch * steps_per_epoch + k, steps_per_epoch)
            q = train_set[batch]
            loss = torch.nn.functional.mse_loss(module(q), q)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            total += loss.item() * len(batch)
        module.eval()
        with torch.no_grad():
            validation = torch.nn.functional.mse_loss(module(validation_set), validation_set).item()
        state.finish_epoch(epoch, validation)
        bar.set_postfix(
            train=f'{total / len(train_set):.2e}',
            validation=f'{validation:.2e}',
            best=f'{state.best_validation:.2e}',
        )
    state.restore_best()
    module.normalise_latents(dataset.train)
    return module


def reconstruction_mse(
    autoencoder: Autoencoder, configurations: Float[np.ndarray, 'frames n']
) -> float:
    """Return the mean of (D(E(q)) − q)² over coordinates and frames [m²]."""
    difference = autoencoder.decode(autoencoder.encode(configurations)) - configurations
    return float(np.mean(difference**2))


def _architecture(recipe: Recipe, dataset: Dataset) -> FlatArchitecture:
    return FlatArchitecture(
        configuration_size=dataset.train.shape[1],
        latent_size=recipe.latent_size,
        hidden_sizes=recipe.hidden_sizes,
        activation=recipe.activation,
        skip=recipe.skip,
    )


class _TrainingState:
    """Where a training stands: epoch, weights, Adam's moments, best weights; on disk and in memory.

    Raises:
        ValueError: the file on disk is damaged, or of another recipe or on other data.
    """

    def __init__(
        self,
        recipe: Recipe,
        dataset: Dataset,
        module: FlatModule,
        optimizer: torch.optim.Adam,
        path: str | Path | None,
    ) -> None:
        self.epoch = 0
        self.best_validation = float('inf')
        self._best = {key: value.clone() for key, value in module.state_dict().items()}
        self._name = recipe.name
        # through JSON, so that it compares with what a file gives back
        self._identity = json.loads(json.dumps([recipe.as_dict(), dataset.provenance]))
        self._module = module
        self._optimizer = optimizer
        self._path = None if path is None else Path(path)
        if self._path is not None and self._path.exists():
            self._load()

    def finish_epoch(self, epoch: int, validation: float) -> None:
        """Note the error of an epoch, keep its weights if they are the best, save now and then."""
        self.epoch = epoch + 1
        if validation < self.best_validation:
            self.best_validation = validation
            self._best = {key: value.clone() for key, value in self._module.state_dict().items()}
        if self._path is not None and (epoch + 1) % SAVE_INTERVAL == 0:
            self._save()

    def restore_best(self) -> None:
        """Put the best weights into the module and remove the file.

        Raises:
            ValueError: no epoch had a finite validation error.
        """
        if not np.isfinite(self.best_validation):
            raise ValueError(
                f'training {self._name}: the validation error was not finite in any epoch: '
                'is the learning rate too high, or a configuration not finite?'
            )
        self._module.load_state_dict(self._best)
        if self._path is not None:
            self._path.unlink(missing_ok=True)

    def _save(self) -> None:
        assert self._path is not None
        tensors = {f'module.{key}': value for key, value in self._module.state_dict().items()}
        tensors |= {f'best.{key}': value for key, value in self._best.items()}
        for i, moments in self._optimizer.state_dict()['state'].items():
            tensors |= {f'adam.{i}.{key}': value for key, value in moments.items()}
        metadata = {
            'identity': json.dumps(self._identity),
            'epoch': str(self.epoch),
            'best_validation': repr(self.best_validation),
        }
        self._path.parent.mkdir(parents=True, exist_ok=True)
        partial = self._path.with_name(self._path.name + '.partial')
        save_file({key: value.contiguous() for key, value in tensors.items()}, partial, metadata)
        os.replace(partial, self._path)

    def _load(self) -> None:
        try:
            with safe_open(str(self._path), framework='pt') as file:
                metadata = file.metadata()
                tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
            identity = json.loads(metadata['identity'])
        except (SafetensorError, KeyError, TypeError, ValueError) as error:
            raise ValueError(
                f'{self._path}: expected the state of an unfinished training, but {error}: '
                'remove the file'
            ) from error
        if identity != self._identity:
            raise ValueError(
                f'{self._path} is an unfinished training by another recipe or on other data: '
                'finish that one, or remove the file'
            )
        self.epoch = int(metadata['epoch'])
        self.best_validation = float(metadata['best_validation'])
        self._module.load_state_dict(_part(tensors, 'module.'))
        self._best = _part(tensors, 'best.')
        moments: dict[int, dict[str, torch.Tensor]] = {}
        for key, value in _part(tensors, 'adam.').items():
            i, name = key.split('.', 1)
            moments.setdefault(int(i), {})[name] = value
        state = self._optimizer.state_dict()
        self._optimizer.load_state_dict({**state, 'state': moments})


def _part(tensors: dict[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    return {
        key.removeprefix(prefix): value for key, value in tensors.items() if key.startswith(prefix)
    }
