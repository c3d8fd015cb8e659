"""A training recipe: everything that, with the data, determines an autoencoder."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import yaml

from dpc_ros.autoencoder.activations import ACTIVATIONS
from dpc_ros.autoencoder.architecture import check_pod_size
from dpc_ros.autoencoder.kinds import check_kind
from dpc_ros.resources import find_resource

OPTIMIZERS = ('adam', 'adamw')
_WARM_UP = 0.3  # fraction of a one-cycle schedule in which the learning rate rises
_FIRST_DIVISOR = 25.0
_LAST_DIVISOR = 1e4
_WHOLE_NUMBERS = {
    'latent_size': 1,
    'channels': 1,
    'convolutions': 2,
    'node_features': 1,
    'epochs': 1,
    'batch_size': 1,
    'step_epochs': 1,
    'extra_simulations': 0,
    'seed': 0,
}


@dataclass(frozen=True)
class Recipe:
    """How one autoencoder is trained; defaults are the paper's for system 2 (section A.2).

    Attributes:
        name: of the checkpoint that comes out.
        network: name or path of the body.
        kind: of the autoencoder: `flat`, `graph`, `pod`, or one that a package registers.
        latent_size: m.
        hidden_sizes: units of a flat encoder's hidden layers, mirrored by the decoder.
        channels: of a node between the convolutions of a graph autoencoder.
        convolutions: of a graph encoder, and as many of its decoder.
        node_features: of a node between node-wise and graph-level projection.
        activation: `elu` (paper) or `silu`.
        skip: centre and scale the data and add linear POD maps around both networks.
        pod_size: how many POD coordinates flat networks read and write, zero for all n.
        options: keyword arguments of a registered autoencoder's class.
        extra_simulations: how many simulations under random gravity train beside the paper's.
        input_noise: deviation of normal noise on what is encoded in training [m]; the loss is
            against the true configuration, so that the encoder learns to reject noise.
        epochs: passes over the training configurations.
        batch_size: configurations per step of Adam.
        optimizer: `adam`, where the weight decay is part of the gradient (L2 regularisation), or
            `adamw`, where it shrinks the weights themselves.
        learning_rate: of the optimizer; the peak of a one-cycle schedule.
        weight_decay: λ.
        schedule: `step` multiplies the rate by `step_factor` every `step_epochs`; `one_cycle`
            rises to the peak over three tenths of the steps and falls to nearly zero (cosine).
        step_epochs: epochs between two reductions.
        step_factor: γ.
        seed: of initial weights and batches.

    Raises:
        ValueError: a value is out of its range.
    """

    name: str
    network: str
    kind: str = 'flat'
    latent_size: int = 5
    hidden_sizes: tuple[int, ...] = (300, 200, 100)
    channels: int = 50
    convolutions: int = 4
    node_features: int = 10
    activation: str = 'elu'
    skip: bool = False
    pod_size: int = 0
    options: dict[str, Any] = field(default_factory=dict)
    extra_simulations: int = 0
    input_noise: float = 0.0
    epochs: int = 500
    batch_size: int = 256
    optimizer: str = 'adam'
    learning_rate: float = 1e-3
    weight_decay: float = 1e-5
    schedule: str = 'step'
    step_epochs: int = 200
    step_factor: float = 0.3
    seed: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not re.fullmatch(r'\w[\w.-]*', self.name):
            raise ValueError(f'name: expected one word that can name a file, got {self.name!r}')
        if not isinstance(self.network, str):
            raise ValueError(f'network: expected a name or a path, got {self.network!r}')
        check_kind(self.kind)
        sizes = self.hidden_sizes
        if not isinstance(sizes, list | tuple) or not all(_is_whole(s, 1) for s in sizes):
            raise ValueError(f'hidden_sizes: expected whole numbers ≥ 1, got {sizes!r}')
        object.__setattr__(self, 'hidden_sizes', tuple(sizes))
        if self.activation not in ACTIVATIONS:
            raise ValueError(
                f'activation {self.activation!r}: expected one of {sorted(ACTIVATIONS)}'
            )
        if not isinstance(self.skip, bool):
            raise ValueError(f'skip: expected true or false, got {self.skip!r}')
        for key, least in _WHOLE_NUMBERS.items():
            value = getattr(self, key)
            if not _is_whole(value, least):
                raise ValueError(f'{key}: expected a whole number ≥ {least}, got {value!r}')
        for key in ('learning_rate', 'weight_decay', 'step_factor', 'input_noise'):
            value = getattr(self, key)
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ValueError(f'{key}: expected a number (YAML: 1.0e-3), got {value!r}')
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f'{key}: expected a finite number ≥ 0, got {value}')
        check_pod_size(self.pod_size, self.skip, self.latent_size, math.inf)
        if not isinstance(self.options, dict) or not _is_json(self.options):
            raise ValueError(
                f'options: expected names and values that JSON can hold, got {self.options!r}'
            )
        if self.optimizer not in OPTIMIZERS:
            raise ValueError(f'optimizer {self.optimizer!r}: expected one of {OPTIMIZERS}')
        if self.schedule not in SCHEDULES:
            raise ValueError(f'schedule {self.schedule!r}: expected one of {sorted(SCHEDULES)}')

    def learning_rate_at(self, step: int, steps_per_epoch: int) -> float:
        """Return the learning rate of a step of Adam, counted from zero over all epochs."""
        return SCHEDULES[self.schedule](self, step, steps_per_epoch)

    def as_dict(self) -> dict[str, Any]:
        """Return the recipe as plain JSON data."""
        return {**asdict(self), 'hidden_sizes': list(self.hidden_sizes)}


def load_recipe(name_or_path: str | Path) -> Recipe:
    """Read a recipe from a YAML file, or a shipped one by its name.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is not YAML, a key is unknown or missing, or a value is out of range.
    """
    path = find_resource(name_or_path, 'training', '.yaml')
    try:
        content = yaml.safe_load(path.read_text())
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        one_line = ' '.join(str(error).split())
        raise ValueError(f'{path}: expected YAML, but {one_line}') from error
    if not isinstance(content, dict):
        raise ValueError(f'{path}: expected keys and values, got a {type(content).__name__}')
    known = {each.name for each in fields(Recipe)}
    unknown = sorted(str(key) for key in content.keys() - known)
    if unknown:
        raise ValueError(f'{path}: unknown keys {unknown}, a recipe has {sorted(known)}')
    try:
        return Recipe(**content)
    except (TypeError, ValueError) as error:
        raise ValueError(f'{path}: {error}') from error


def _is_json(value: Any) -> bool:
    try:
        return json.loads(json.dumps(value, allow_nan=False)) == value
    except (RecursionError, TypeError, ValueError):
        return False


def _is_whole(value: Any, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def _step_schedule(recipe: Recipe, step: int, steps_per_epoch: int) -> float:
    epoch = step // steps_per_epoch
    return recipe.learning_rate * recipe.step_factor ** (epoch // recipe.step_epochs)


def _one_cycle_schedule(recipe: Recipe, step: int, steps_per_epoch: int) -> float:
    first = recipe.learning_rate / _FIRST_DIVISOR
    last = first / _LAST_DIVISOR
    progress = step / max(recipe.epochs * steps_per_epoch - 1, 1)
    if progress < _WARM_UP:
        return _cosine(first, recipe.learning_rate, progress / _WARM_UP)
    return _cosine(recipe.learning_rate, last, (progress - _WARM_UP) / (1 - _WARM_UP))


def _cosine(start: float, end: float, progress: float) -> float:
    return end + (start - end) * 0.5 * (1.0 + math.cos(math.pi * progress))


SCHEDULES: dict[str, Callable[[Recipe, int, int], float]] = {
    'step': _step_schedule,
    'one_cycle': _one_cycle_schedule,
}
