"""Activation functions with their first and second derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import expit

Array = Float[np.ndarray, '...']


class Activation(NamedTuple):
    """A scalar function σ applied to each unit, and its derivatives."""

    value: Callable[[Array], Array]
    first_derivative: Callable[[Array], Array]
    second_derivative: Callable[[Array], Array]
    value_and_first_derivative: Callable[[Array], tuple[Array, Array]]


def _silu_with_first(z: Array) -> tuple[Array, Array]:
    s = expit(z)
    return z * s, s * (1.0 + z * (1.0 - s))


def _silu_second(z: Array) -> Array:
    s = expit(z)
    return s * (1.0 - s) * (2.0 + z * (1.0 - 2.0 * s))


def _elu_with_first(z: Array) -> tuple[Array, Array]:
    below = np.minimum(z, 0)
    return np.where(z > 0, z, np.expm1(below)), np.exp(below)


ACTIVATIONS = {
    'elu': Activation(
        value=lambda z: np.where(z > 0, z, np.expm1(np.minimum(z, 0))),
        first_derivative=lambda z: np.exp(np.minimum(z, 0)),
        second_derivative=lambda z: np.where(z > 0, 0.0, np.exp(np.minimum(z, 0))),
        value_and_first_derivative=_elu_with_first,
    ),
    'silu': Activation(
        value=lambda z: z * expit(z),
        first_derivative=lambda z: _silu_with_first(z)[1],
        second_derivative=_silu_second,
        value_and_first_derivative=_silu_with_first,
    ),
}
