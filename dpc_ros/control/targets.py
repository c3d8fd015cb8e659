"""Targets: the configuration, or the latent state, that the body is to reach."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dpc_ros.data import simulate_conditions
from dpc_ros.data.conditions import training_conditions
from dpc_ros.data.simulations import STEP
from dpc_ros.network import MassSpringNetwork

_SYNTAX = (
    'expected `simulation:<number>@<step>` (a state of a training or validation simulation, for '
    'example simulation:1@400), `rest`, or the path of a JSON file with "configuration" or "latent"'
)


class TargetError(ValueError):
    """A target that can't be used: what was expected, what came, what to do."""


@dataclass(frozen=True, eq=False)
class Target:
    """A configuration q̄ [m] or a latent state ξ̄ to reach; exactly one of the two is given.

    Raises:
        TargetError: none or both are given, or a value is not finite.
    """

    configuration: Float[np.ndarray, ' n'] | None = None
    latent: Float[np.ndarray, ' m'] | None = None

    def __post_init__(self) -> None:
        if (self.configuration is None) == (self.latent is None):
            raise TargetError('target: expected either a configuration or a latent state')
        bad = np.flatnonzero(~np.isfinite(self.value))
        if len(bad):
            raise TargetError(
                f'target: expected finite numbers, but number {bad[0]} is {self.value[bad[0]]}'
            )

    @property
    def is_latent(self) -> bool:
        """Whether it is a latent state."""
        return self.latent is not None

    @property
    def value(self) -> Float[np.ndarray, ' k']:
        """The one of the two that is given."""
        value = self.configuration if self.latent is None else self.latent
        assert value is not None
        return value

    def check_sizes(self, configuration_size: int, latent_size: int) -> None:
        """Make sure that the target fits a body and its autoencoder.

        Raises:
            TargetError: its length differs.
        """
        what, size = 'configuration', configuration_size
        if self.is_latent:
            what, size = 'latent', latent_size
        if self.value.shape != (size,):
            raise TargetError(f'target {what}: expected {size} values, got {self.value.size}')


def load_target(specification: str, network: MassSpringNetwork) -> Target:
    """Return the target that a user names.

    Args:
        specification: `simulation:<number>@<step>`, `rest`, or the path of a JSON file.
        network: the body.

    Raises:
        TargetError: the specification can't be read, names no state, or holds no valid target.
    """
    if specification == 'rest':
        return Target(configuration=network.rest_configuration)
    if specification.startswith('simulation:'):
        return _simulated_target(specification, network)
    return _target_from_file(specification)


def _simulated_target(specification: str, network: MassSpringNetwork) -> Target:
    try:
        simulation, step = (int(part) for part in specification[len('simulation:') :].split('@'))
    except ValueError:
        raise TargetError(f'target {specification!r}: {_SYNTAX}') from None
    conditions = training_conditions()
    numbers = [condition.simulation for condition in conditions]
    if simulation not in numbers:
        raise TargetError(f'target {specification!r}: expected one of the simulations {numbers}')
    last = numbers.index(simulation)
    first = max(i for i in range(last + 1) if conditions[i].start == 'rest')
    for condition, trajectory in simulate_conditions(network, conditions[first : last + 1]):
        if condition.simulation == simulation:
            steps = len(trajectory.configuration) - 1
            if not 0 <= step <= steps:
                raise TargetError(
                    f'target {specification!r}: expected a step of 0 to {steps} ({STEP} s each)'
                )
            return Target(configuration=trajectory.configuration[step])
    raise AssertionError('the simulation is among the conditions')


def _target_from_file(specification: str) -> Target:
    path = Path(os.path.expanduser(specification))  # leaves the `~` of an unknown user
    if not path.is_file():
        raise TargetError(f'target {specification!r}: no such file; {_SYNTAX}')
    try:
        content = json.loads(path.read_text())
        keys = {'configuration', 'latent'} & content.keys()
        values = {key: _numbers(content[key]) for key in keys}
    except (AttributeError, OverflowError, RecursionError, TypeError, ValueError) as error:
        raise TargetError(f'target {specification!r}: {_SYNTAX}, but {error}') from error
    if len(keys) != 1 or any(value.ndim != 1 for value in values.values()):
        raise TargetError(f'target {specification!r}: {_SYNTAX}, one list of numbers')
    return Target(**values)


def _numbers(values: Any) -> np.ndarray:
    """Return an array, but not of what numpy would make numbers of: truth values and texts."""
    for value in values:
        if isinstance(value, bool | str):
            raise TypeError(f'{value!r} is no number')
    return np.array(values, dtype=float)
