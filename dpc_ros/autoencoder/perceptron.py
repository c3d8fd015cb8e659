"""A network of affine layers with an optional linear skip, in float64 and with derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder.activations import ACTIVATIONS
from dpc_ros.autoencoder.layers import Layer


class Perceptron:
    """f(x) = Sx + W_L σ(… σ(W₁x + b₁) …) + b_L, linear in its last layer, W_l of any structure.

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
            if after.input_size != before.output_size:
                raise ValueError(
                    f'a layer of {before.output_size} outputs is followed by one of '
                    f'{after.input_size} inputs'
                )
        self.layers = list(layers)
        self.skip = None if skip is None else np.ascontiguousarray(skip, float)
        self.activation = activation
        self._activation = ACTIVATIONS[activation]

    @property
    def input_size(self) -> int:
        """Return the size of x."""
        return self.layers[0].input_size

    @property
    def output_size(self) -> int:
        """Return the size of f(x)."""
        return self.layers[-1].output_size

    def value(self, x: Float[np.ndarray, '*batch inputs']) -> Float[np.ndarray, '*batch outputs']:
        """Return f(x) for any leading dimensions."""
        hidden = x
        for layer in self.layers[:-1]:
            hidden = self._activation.value(layer.value(hidden))
        value = self.layers[-1].value(hidden)
        return value if self.skip is None else value + x @ self.skip.T

    def value_and_jacobian_product(
        self, x: Float[np.ndarray, ' inputs'], tangent: Float[np.ndarray, ' inputs']
    ) -> tuple[Float[np.ndarray, ' outputs'], Float[np.ndarray, ' outputs']]:
        """Return f(x) and (∂f/∂x)·t (forward mode)."""
        return self._forward(x, tangent)

    def value_and_jacobian(
        self, x: Float[np.ndarray, '*batch inputs']
    ) -> tuple[Float[np.ndarray, '*batch outputs'], Float[np.ndarray, '*batch outputs inputs']]:
        """Return f(x) and ∂f/∂x for any leading dimensions."""
        tangents = np.broadcast_to(np.eye(self.input_size), (*x.shape, self.input_size))
        value, products = self._forward(x, tangents)
        return value, products.swapaxes(-1, -2)

    def _forward(self, x: np.ndarray, tangent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Move one tangent along with x, or several: their axis stands before the last."""
        hidden, moved = x, tangent
        for layer in self.layers[:-1]:
            z = layer.value(hidden)
            hidden, slope = self._activation.value_and_first_derivative(z)
            moved = layer.product(moved) * (slope if moved.ndim == z.ndim else slope[..., None, :])
        last = self.layers[-1]
        value, product = last.value(hidden), last.product(moved)
        if self.skip is not None:
            value = value + x @ self.skip.T
            product = product + tangent @ self.skip.T
        return value, product

    def value_and_derivatives(
        self,
        x: Float[np.ndarray, '*batch inputs'],
        direction: Float[np.ndarray, '*batch inputs'],
    ) -> tuple[
        Float[np.ndarray, '*batch outputs'],
        Float[np.ndarray, '*batch outputs inputs'],
        Float[np.ndarray, '*batch outputs'],
    ]:
        """Return f(x), ∂f/∂x and the second derivative of f along a direction, d²f(x + td)/dt².

        One forward pass moves the value, a tangent for each input and the second derivative along:
        σ(z) bends the latter by σ''(z)(ż·ż) with ż the derivative of z along the direction.
        """
        hidden, second = x, np.zeros_like(x)
        moved = np.broadcast_to(np.eye(self.input_size), (*x.shape, self.input_size))
        for layer in self.layers[:-1]:
            z, moved, second = layer.value(hidden), layer.product(moved), layer.product(second)
            along = np.einsum('...i,...ij->...j', direction, moved)
            slope = self._activation.first_derivative(z)
            second = slope * second + self._activation.second_derivative(z) * along**2
            moved = slope[..., None, :] * moved
            hidden = self._activation.value(z)
        last = self.layers[-1]
        value, moved, second = last.value(hidden), last.product(moved), last.product(second)
        jacobian = moved.swapaxes(-1, -2)
        if self.skip is not None:
            value, jacobian = value + x @ self.skip.T, jacobian + self.skip
        return value, jacobian, second

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
            z = layer.value(hidden)
            tangent = layer.product(moved)  # one row a direction
            inputs.append(z)
            tangents.append(tangent)
            hidden = self._activation.value(z)
            moved = self._activation.first_derivative(z) * tangent
        adjoint = weight
        hessian = np.zeros((self.input_size, self.input_size))
        for layer, z, tangent in zip(
            reversed(self.layers[1:]), reversed(inputs), reversed(tangents), strict=True
        ):
            adjoint = layer.adjoint_product(adjoint)
            bend = adjoint * self._activation.second_derivative(z)
            hessian += (tangent * bend) @ tangent.T
            adjoint = adjoint * self._activation.first_derivative(z)
        return hessian
