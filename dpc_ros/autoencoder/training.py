"""Training of an autoencoder by a recipe: one loop, resumable, the best validation epoch kept."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from tqdm import tqdm

from dpc_ros.autoencoder.architecture import FlatArchitecture
from dpc_ros.autoencoder.base import Autoencoder
from dpc_ros.autoencoder.flat_module import FlatModule
from dpc_ros.autoencoder.recipe import Recipe
from dpc_ros.data import Dataset
from dpc_ros.files import replacing

SAVE_INTERVAL = 10  # epochs between two states on disk
_EPOCHS_PER_SEED = 1_000_000  # so that no two epochs of two seeds share their batches
_SHOWN = 3  # tensors named in an error


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
        state_path: file of the state of the training: read where it exists, written every
            `SAVE_INTERVAL` epochs and when the training ends or is cut off, by Ctrl-C for example,
            always as it was after a whole epoch. It is left for the caller to remove.
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
    try:
        for epoch in bar:
            generator = torch.Generator().manual_seed(recipe.seed * _EPOCHS_PER_SEED + epoch)
            order = torch.randperm(len(train_set), generator=generator)
            module.train()
            total = 0.0
            for k, batch in enumerate(order.split(recipe.batch_size)):
                for group in optimizer.param_groups:
                    group['lr'] = recipe.learning_rate_at(
                        epoch * steps_per_epoch + k, steps_per_epoch
                    )
                q = train_set[batch]
                loss = torch.nn.functional.mse_loss(module(q), q)
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                total += loss.item() * len(batch)
            module.eval()
            with torch.no_grad():
                validation = torch.nn.functional.mse_loss(
                    module(validation_set), validation_set
                ).item()
            state.finish_epoch(epoch, validation)
            bar.set_postfix(
                train=f'{total / len(train_set):.2e}',
                validation=f'{validation:.2e}',
                best=f'{state.best_validation:.2e}',
            )
    finally:
        state.save()
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
        self._epochs = recipe.epochs
        self._finished: tuple[dict[str, torch.Tensor], dict[str, str]] | None = None
        if self._path is not None and self._path.exists():
            self._load()

    def finish_epoch(self, epoch: int, validation: float) -> None:
        """Note the error of an epoch, keep its weights if they are the best, save now and then."""
        self.epoch = epoch + 1
        if validation < self.best_validation:
            self.best_validation = validation
            self._best = {key: value.clone() for key, value in self._module.state_dict().items()}
        if self._path is None:
            return
        self._finished = self._snapshot()
        if self.epoch % SAVE_INTERVAL == 0:
            self.save()

    def restore_best(self) -> None:
        """Put the best weights into the module.

        Raises:
            ValueError: no epoch had a finite validation error.
        """
        if not np.isfinite(self.best_validation):
            raise ValueError(
                f'training {self._name}: the validation error was not finite in any epoch: '
                'is the learning rate too high, or a configuration not finite?'
            )
        self._module.load_state_dict(self._best)

    def save(self) -> None:
        """Write the state after the last whole epoch of this training, if there was one."""
        if self._path is None or self._finished is None:
            return
        with replacing(self._path) as partial:
            partial.write_bytes(save(*self._finished))

    def _snapshot(self) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
        tensors = {f'module.{key}': value for key, value in self._module.state_dict().items()}
        tensors |= {f'best.{key}': value for key, value in self._best.items()}
        for i, moments in self._optimizer.state_dict()['state'].items():
            tensors |= {f'adam.{i}.{key}': value for key, value in moments.items()}
        metadata = {
            'identity': json.dumps(self._identity),
            'epoch': str(self.epoch),
            'best_validation': repr(self.best_validation),
        }
        # Copies: the next epoch goes on with the tensors themselves.
        return {key: value.clone().contiguous() for key, value in tensors.items()}, metadata

    def _load(self) -> None:
        try:
            with safe_open(str(self._path), framework='pt') as file:
                metadata = file.metadata()
                tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
            identity = json.loads(metadata['identity'])
            epoch, best_validation = int(metadata['epoch']), float(metadata['best_validation'])
        except (SafetensorError, KeyError, TypeError, ValueError, RecursionError) as error:
            raise self._damaged(repr(error)) from error
        if identity != self._identity:
            raise ValueError(
                f'{self._path} is an unfinished training by another recipe or on other data: '
                'finish that one, or remove the file'
            )
        shapes = {key: tuple(value.shape) for key, value in tensors.items()}
        wrong = sorted({key for key, _ in shapes.items() ^ self._shapes().items()})
        if wrong:
            raise self._damaged(
                f'these tensors are missing, unknown or misshapen: {wrong[:_SHOWN]}'
            )
        if not 0 < epoch <= self._epochs:
            raise self._damaged(f'its epoch is {epoch}')
        self.epoch = epoch
        self.best_validation = best_validation
        self._module.load_state_dict(_part(tensors, 'module.'))
        self._best = _part(tensors, 'best.')
        moments: dict[int, dict[str, torch.Tensor]] = {}
        for key, value in _part(tensors, 'adam.').items():
            i, name = key.split('.', 1)
            moments.setdefault(int(i), {})[name] = value
        state = self._optimizer.state_dict()
        self._optimizer.load_state_dict({**state, 'state': moments})

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        shapes: dict[str, tuple[int, ...]] = {}
        for key, value in self._module.state_dict().items():
            shapes[f'module.{key}'] = shapes[f'best.{key}'] = tuple(value.shape)
        for i, parameter in enumerate(self._module.parameters()):
            shapes[f'adam.{i}.step'] = ()
            shapes[f'adam.{i}.exp_avg'] = shapes[f'adam.{i}.exp_avg_sq'] = tuple(parameter.shape)
        return shapes

    def _damaged(self, reason: str) -> ValueError:
        return ValueError(
            f'{self._path}: expected the state of an unfinished training, but {reason}: '
            'remove the file'
        )


def _part(tensors: dict[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    return {
        key.removeprefix(prefix): value for key, value in tensors.items() if key.startswith(prefix)
    }
