"""A multilayer perceptron with an optional linear skip, evaluated in float64 with derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder.activations import ACTIVATIONS


@dataclass(frozen=True, eq=False)
class Layer:
    """An affine map x ↦ Wx + b."""

    weight: Float[np.ndarray, 'outputs inputs']
    bias: Float[np.ndarray, ' outputs']


class Perceptron:
    """f(x) = Sx + W_L σ(… σ(W₁x + b₁) …) + b_L, linear in its last layer.

    Args:
        layers: the affine maps from input to output.
        activation: name of σ, a key of `ACTIVATIONS`.
        skip: S, or none.

    Raises:
        ValueError: the sizes of the layers do not follow on one another.
    """

    def __init__(
        self,
        layers: Sequence[Layer],
        activation: str,
        skip: Float[np.ndarray, 'outputs inputs'] | None = None,
    ) -> None:
        for before, after in pairwise(layers):
            if after.weight.shape[1] != before.weight.shape[0]:
                raise ValueError(
                    f'a layer of {before.weight.shape[0]} outputs is followed by one of '
                    f'{after.weight.shape[1]} inputs'
                )
        self.layers = [
            Layer(np.ascontiguousarray(each.weight, float), np.ascontiguousarray(each.bias, float))
            for each in layers
        ]
        self.skip = None if skip is None else np.ascontiguousarray(skip, float)
        self._activation = ACTIVATIONS[activation]

    @property
    def input_size(self) -> int:
        """Return the size of x."""
        return self.layers[0].weight.shape[1]

    @property
    def output_size(self) -> int:
        """Return the size of f(x)."""
        return self.layers[-1].weight.shape[0]

    def value(self, x: Float[np.ndarray, '*batch inputs']) -> Float[np.ndarray, '*batch outputs']:
        """Return f(x) for any leading dimensions."""
        hidden = x
        for layer in self.layers[:-1]:
            hidden = self._activation.value(hidden @ layer.weight.T + layer.bias)
        last = self.layers[-1]
        value = hidden @ last.weight.T + last.bias
        return value if self.skip is None else value + x @ self.skip.T

    def value_and_jacobian_product(
        self, x: Float[np.ndarray, ' inputs'], tangent: Float[np.ndarray, inputs * directions]
    ) -> tuple[Float[np.ndarray, ' outputs'], Float[np.ndarray, outputs * directions]]:
        """Return f(x) and (∂f/∂x)·t for one tangent or for several as columns (forward mode)."""
        hidden, moved = x, tangent
        for layer in self.layers[:-1]:
            z = layer.weight @ hidden + layer.bias
            slope = self._activation.first_derivative(z)
            moved = (layer.weight @ moved) * (slope if tangent.ndim == 1 else slope[:, None])
            hidden = self._activation.value(z)
        last = self.layers[-1]
        value = last.weight @ hidden + last.bias
        product = last.weight @ moved
        if self.skip is not None:
            value = value + self.skip @ x
            product = product + self.skip @ tangent
        return value, product

    def jacobian(self, x: Float[np.ndarray, ' inputs']) -> Float[np.ndarray, 'outputs inputs']:
        """Return ∂f/∂x."""
        return self.value_and_jacobian_product(x, np.eye(self.input_size))[1]

    def curvature(
        self, x: Float[np.ndarray, ' inputs'], weight: Float[np.ndarray, ' outputs']
    ) -> Float[np.ndarray, 'inputs inputs']:
        """Return the Hessian of w·f at x.

        Only activations bend: with z_l the input of layer l's activation and a_l the derivative of
        w·f by its output, the Hessian is Σ_l (∂z_l/∂x)ᵀ diag(a_l σ''(z_l)) (∂z_l/∂x): one forward
        pass with tangents, one backward pass.
        """
        hidden, moved = x, np.eye(self.input_size)
        inputs, tangents = [], []
        for layer in self.layers[:-1]:
            z = layer.weight @ hidden + layer.bias
            tangent = layer.weight @ moved
            inputs.append(z)
            tangents.append(tangent)
            hidden = self._activation.value(z)
            moved = self._activation.first_derivative(z)[:, None] * tangent
        adjoint = weight
        hessian = np.zeros((self.input_size, self.input_size))
        for layer, z, tangent in zip(
            reversed(self.layers[1:]), reversed(inputs), reversed(tangents), strict=True
        ):
            adjoint = adjoint @ layer.weight
            bend = adjoint * self._activation.second_derivative(z)
            hessian += tangent.T @ (bend[:, None] * tangent)
            adjoint = adjoint * self._activation.first_derivative(z)
        return hessian
