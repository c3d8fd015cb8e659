"""Training of an autoencoder by a recipe: one loop, resumable, the best validation epoch kept."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from tqdm import tqdm

from dpc_ros.autoencoder.base import Autoencoder
from dpc_ros.autoencoder.module import AutoencoderModule
from dpc_ros.autoencoder.modules import untrained_module
from dpc_ros.autoencoder.recipe import Recipe
from dpc_ros.data import Dataset
from dpc_ros.files import replacing
from dpc_ros.network import MassSpringNetwork

SAVE_INTERVAL = 10  # epochs between two states on disk
_EPOCHS_PER_SEED = 1_000_000  # so that no two epochs of two seeds share their batches
_SHOWN = 3  # tensors named in an error


def _adam(parameters: Iterable[torch.nn.Parameter], recipe: Recipe) -> torch.optim.Optimizer:
    return torch.optim.Adam(parameters, weight_decay=recipe.weight_decay)


def _adamw(parameters: Iterable[torch.nn.Parameter], recipe: Recipe) -> torch.optim.Optimizer:
    # Gradients of an error of 1e-6 m² are small: not to be drowned in the default of 1e-8.
    return torch.optim.AdamW(parameters, weight_decay=recipe.weight_decay, eps=1e-12)


_OPTIMIZERS = {'adam': _adam, 'adamw': _adamw}


def train(
    recipe: Recipe,
    network: MassSpringNetwork,
    dataset: Dataset,
    state_path: str | Path | None = None,
    progress: bool = False,
    on_epoch: Callable[[int, float], None] | None = None,
) -> AutoencoderModule:
    """Train an autoencoder on the reconstruction error (paper, section II and A.2).

    The loss is the mean square error of D(E(q)) against q. Initial weights follow from the seed,
    the batches of an epoch from seed and epoch, so that a resumed training repeats an unbroken one.

    Args:
        recipe: what to train.
        network: the body.
        dataset: configurations; only training and validation are looked at.
        state_path: file of the state of the training: read where it exists, written every
            `SAVE_INTERVAL` epochs and when the training ends or is cut off, by Ctrl-C for example,
            always as it was after a whole epoch. It is left for the caller to remove.
        progress: show a progress bar with training and validation error.
        on_epoch: called after each epoch with its number and the best validation error so far;
            what it raises ends the training, whose state is kept.

    Returns:
        the module with the weights of the best validation epoch and normalised latents.

    Raises:
        ValueError: the state on disk is damaged, of another recipe or on other data, or no epoch
            had a finite validation error.
    """
    module = untrained_module(recipe, network)
    module.fit_normalisation(dataset.train)
    if any(True for _ in module.parameters()):
        _descend(module, recipe, dataset, state_path, progress, on_epoch)
    module.normalise_latents(dataset.train)
    return module


def _descend(
    module: AutoencoderModule,
    recipe: Recipe,
    dataset: Dataset,
    state_path: str | Path | None,
    progress: bool,
    on_epoch: Callable[[int, float], None] | None,
) -> None:
    """Lower the reconstruction error by Adam and leave the best weights in the module."""
    train_set, validation_set = _Frames(module, dataset.train), _Frames(module, dataset.validation)
    optimizer = _OPTIMIZERS[recipe.optimizer](module.parameters(), recipe)
    steps_per_epoch = -(-len(train_set.features) // recipe.batch_size)
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
            order = torch.randperm(len(train_set.features), generator=generator)
            module.train()
            total = 0.0
            for k, batch in enumerate(order.split(recipe.batch_size)):
                for group in optimizer.param_groups:
                    group['lr'] = recipe.learning_rate_at(
                        epoch * steps_per_epoch + k, steps_per_epoch
                    )
                q = train_set.features[batch]
                noise = torch.randn(q.shape, generator=generator) if recipe.input_noise else 0.0
                loss = train_set.mse(q, recipe.input_noise * noise)
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                total += loss.item() * len(batch)
            module.eval()
            validation = validation_set.total_mse(recipe.batch_size)
            state.finish_epoch(epoch, validation)
            bar.set_postfix(
                train=f'{total / len(order) + train_set.lost:.2e}',
                validation=f'{validation:.2e}',
                best=f'{state.best_validation:.2e}',
            )
            if on_epoch is not None:
                on_epoch(epoch, state.best_validation)
    finally:
        state.save()
    state.restore_best()


class _Frames:
    """Configurations as the networks see them, in float32, and the error made on them."""

    def __init__(
        self, module: AutoencoderModule, configurations: Float[np.ndarray, 'frames n']
    ) -> None:
        exact = torch.from_numpy(configurations)
        self._module = module
        self._scale = float(module.configuration_scale)
        self._unit = self._scale**2 / exact.shape[1]  # m² a coordinate
        self.features = module.features(exact).float()
        self.lost = module.lost_by_features(exact)

    def mse(self, features: torch.Tensor, noise: torch.Tensor | float = 0.0) -> torch.Tensor:
        """Return the mean square error of D(E(q + noise)) on a batch [m²], as features see it."""
        error = self._module.reconstruct(features + noise / self._scale) - features
        return (error**2).sum() * (self._unit / len(features))

    @torch.no_grad()
    def total_mse(self, batch_size: int) -> float:
        """Return the mean square error over all frames [m²]."""
        total = sum(
            self.mse(batch).item() * len(batch) for batch in self.features.split(batch_size)
        )
        return total / len(self.features) + self.lost


def reconstruction_mse(
    autoencoder: Autoencoder, configurations: Float[np.ndarray, 'frames n']
) -> float:
    """Return the mean of (D(E(q)) − q)² over coordinates and frames [m²]."""
    difference = autoencoder.decode(autoencoder.encode(configurations)) - configurations
    return float(np.mean(difference**2))


class _TrainingState:
    """Where a training stands: epoch, weights, Adam's moments, best weights; on disk and in memory.

    Raises:
        ValueError: the file on disk is damaged, or of another recipe or on other data.
    """

    def __init__(
        self,
        recipe: Recipe,
        dataset: Dataset,
        module: AutoencoderModule,
        optimizer: torch.optim.Optimizer,
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
        wrong = sorted({key for key, _ in shapes.items() ^ self._shapes(shapes.keys()).items()})
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

    def _shapes(self, stored: Collection[str]) -> dict[str, tuple[int, ...]]:
        """Return what has to be stored; a parameter that nothing moves has no moments."""
        shapes: dict[str, tuple[int, ...]] = {}
        for key, value in self._module.state_dict().items():
            shapes[f'module.{key}'] = shapes[f'best.{key}'] = tuple(value.shape)
        for i, parameter in enumerate(self._module.parameters()):
            size = tuple(parameter.shape)
            moments = {'step': (), 'exp_avg': size, 'exp_avg_sq': size}
            if any(f'adam.{i}.{key}' in stored for key in moments):
                shapes |= {f'adam.{i}.{key}': shape for key, shape in moments.items()}
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
