"""What the rest of the package needs of any autoencoder."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from dpc_ros.autoencoder.compiled import DenseDecoder


# D(ξ), J and J̇ξ̇
Derivatives = tuple[
    Float[np.ndarray, '*batch n'],
    Float[np.ndarray, '*batch n m'],
    Float[np.ndarray, '*batch n'],
]


class Autoencoder(ABC):
    """An encoder E: ℝⁿ → ℝᵐ and a decoder D: ℝᵐ → ℝⁿ with their derivatives, in float64.

    What is annotated with `*batch` takes any leading dimensions, the others take one point.
    """

    @property
    @abstractmethod
    def configuration_size(self) -> int:
        """Return n."""

    @property
    @abstractmethod
    def latent_size(self) -> int:
        """Return m."""

    @abstractmethod
    def encode(self, configuration: Float[np.ndarray, '*batch n']) -> Float[np.ndarray, '*batch m']:
        """Return ξ = E(q)."""

    @abstractmethod
    def decode(self, latent: Float[np.ndarray, '*batch m']) -> Float[np.ndarray, '*batch n']:
        """Return D(ξ) [m]."""

    @abstractmethod
    def encoder_jacobian_vector_product(
        self,
        configuration: Float[np.ndarray, ' n'],
        velocity: Float[np.ndarray, ' n'],
        guess: Float[np.ndarray, ' m'] | None = None,
    ) -> tuple[Float[np.ndarray, ' m'], Float[np.ndarray, ' m']]:
        """Return ξ = E(q) and ξ̇ = J_E(q) q̇ in one pass (paper, section IV).

        An encoder that iterates may start from `guess`, a latent state nearby; others ignore it.
        """

    @abstractmethod
    def decode_with_jacobian(
        self, latent: Float[np.ndarray, '*batch m']
    ) -> tuple[Float[np.ndarray, '*batch n'], Float[np.ndarray, '*batch n m']]:
        """Return D(ξ) [m] and J = ∂D/∂ξ for any leading dimensions."""

    @abstractmethod
    def decode_with_derivatives(
        self,
        latent: Float[np.ndarray, '*batch m'],
        latent_velocity: Float[np.ndarray, '*batch m'],
    ) -> Derivatives:
        """Return D(ξ) [m], J = ∂D/∂ξ and J̇ξ̇, the second derivative of D along ξ̇ [m/s²]."""

    def compiled_decoder(self) -> DenseDecoder | None:
        """Return D for compiled code, where it is made of dense layers; none otherwise."""
        return None

    def decoder_jacobian(self, latent: Float[np.ndarray, ' m']) -> Float[np.ndarray, 'n m']:
        """Return J = ∂D/∂ξ."""
        return self.decode_with_jacobian(latent)[1]

    @abstractmethod
    def decoder_curvature(
        self, latent: Float[np.ndarray, ' m'], weight: Float[np.ndarray, ' n']
    ) -> Float[np.ndarray, 'm m']:
        """Return Σ_i w_i ∂²D_i/∂ξ², the Hessian of w·D(ξ): what chain-rule Hessians need of D."""
