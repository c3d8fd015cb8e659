"""Projection onto the decoder's manifold: an encoder that is exact where the network is not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from dpc_ros.autoencoder.base import Autoencoder, Derivatives
from dpc_ros.autoencoder.encoders import ITERATIONS

if TYPE_CHECKING:
    from dpc_ros.autoencoder.compiled import DenseDecoder

_TOLERANCE = 1e-10  # norm of a step that ends the search, in latent units
_FIRST_DAMPING, _LEAST_DAMPING = 1e-6, 1e-12  # of JᵀJ's mean diagonal
_GROWTH, _DECAY = 10.0, 0.1
_CHUNK = 256  # configurations that are projected at a time


class ProjectionAutoencoder(Autoencoder):
    """ξ = argmin |D(ξ) − q|² in place of a trained encoder, by damped Gauss–Newton.

    D(ξ) is the point of the manifold nearest to q, at least of those around the start; small noise
    normal to the manifold is rejected. It starts from the trained
    encoder's ξ, or from a guess where that is nearer, and takes a bounded number of steps.
    (Levenberg–Marquardt; Nocedal and Wright, Numerical Optimization, section 10.3.)

    Args:
        autoencoder: its decoder is projected on, its encoder gives the start.
        iterations: steps at most.

    Raises:
        ValueError: iterations is not positive.
    """

    def __init__(self, autoencoder: Autoencoder, iterations: int = ITERATIONS) -> None:
        if iterations < 1:
            raise ValueError(f'iterations: expected at least 1, got {iterations}')
        self._autoencoder = autoencoder
        self._iterations = iterations

    @property
    def configuration_size(self) -> int:
        return self._autoencoder.configuration_size

    @property
    def latent_size(self) -> int:
        return self._autoencoder.latent_size

    def encode(self, configuration: Float[np.ndarray, '*batch n']) -> Float[np.ndarray, '*batch m']:
        rows = configuration.reshape(-1, self.configuration_size)
        latent = np.empty((len(rows), self.latent_size))
        for start in range(0, len(rows), _CHUNK):
            part = slice(start, start + _CHUNK)
            latent[part] = self._project(rows[part], self._autoencoder.encode(rows[part]))
        return latent.reshape(*configuration.shape[:-1], self.latent_size)

    def decode(self, latent: Float[np.ndarray, '*batch m']) -> Float[np.ndarray, '*batch n']:
        return self._autoencoder.decode(latent)

    def encoder_jacobian_vector_product(
        self,
        configuration: Float[np.ndarray, ' n'],
        velocity: Float[np.ndarray, ' n'],
        guess: Float[np.ndarray, ' m'] | None = None,
    ) -> tuple[Float[np.ndarray, ' m'], Float[np.ndarray, ' m']]:
        """Return ξ and ξ̇ = (JᵀJ + Σ_i (D_i(ξ) − q_i) ∂²D_i/∂ξ²)⁻¹ Jᵀ q̇.

        The matrix is the Hessian of ½|D(ξ) − q|². Where the search has ended in a strict minimum,
        ξ̇ is the exact derivative of the projection along q̇, by the implicit function theorem.
        Where the Hessian is not positive definite, its Gauss–Newton part stands in for it: the
        least-squares velocity of the manifold.
        """
        start = self._start(configuration, guess)
        latent = self._project(configuration[None], start[None])[0]
        decoded, jacobian = self._autoencoder.decode_with_jacobian(latent)
        bend = self._autoencoder.decoder_curvature(latent, decoded - configuration)
        normal = jacobian.T @ jacobian
        try:
            factor = cho_factor(normal + bend)
        except LinAlgError:
            return latent, np.linalg.lstsq(jacobian, velocity, rcond=None)[0]
        return latent, cho_solve(factor, jacobian.T @ velocity)

    def decode_with_jacobian(
        self, latent: Float[np.ndarray, '*batch m']
    ) -> tuple[Float[np.ndarray, '*batch n'], Float[np.ndarray, '*batch n m']]:
        return self._autoencoder.decode_with_jacobian(latent)

    def decode_with_derivatives(
        self,
        latent: Float[np.ndarray, '*batch m'],
        latent_velocity: Float[np.ndarray, '*batch m'],
    ) -> Derivatives:
        return self._autoencoder.decode_with_derivatives(latent, latent_velocity)

    def compiled_decoder(self) -> DenseDecoder | None:
        return self._autoencoder.compiled_decoder()

    def decoder_curvature(
        self, latent: Float[np.ndarray, ' m'], weight: Float[np.ndarray, ' n']
    ) -> Float[np.ndarray, 'm m']:
        return self._autoencoder.decoder_curvature(latent, weight)

    def _start(
        self, configuration: Float[np.ndarray, ' n'], guess: Float[np.ndarray, ' m'] | None
    ) -> Float[np.ndarray, ' m']:
        encoded = self._autoencoder.encode(configuration)
        if guess is None:
            return encoded
        both = np.stack([encoded, guess])
        distances = np.sum((self._autoencoder.decode(both) - configuration) ** 2, axis=1)
        # So that a guess that is not finite is not taken.
        return guess if distances[1] < distances[0] else encoded

    def _project(
        self, configuration: Float[np.ndarray, 'batch n'], start: Float[np.ndarray, 'batch m']
    ) -> Float[np.ndarray, 'batch m']:
        latent = start.copy()
        decoded, jacobian = self._autoencoder.decode_with_jacobian(latent)
        residual = configuration - decoded
        cost = np.sum(residual**2, axis=1)
        damping = np.full(len(latent), _FIRST_DAMPING)
        moving = np.arange(len(latent))  # the rows that have not converged
        for _ in range(self._iterations):
            if not len(moving):
                break
            normal = np.einsum('bni,bnj->bij', jacobian, jacobian)
            gradient = np.einsum('bni,bn->bi', jacobian, residual)
            scale = damping * np.trace(normal, axis1=1, axis2=2) / self.latent_size
            damped = normal + scale[:, None, None] * np.eye(self.latent_size)
            step = np.linalg.solve(damped, gradient[..., None])[..., 0]
            trial = latent[moving] + step
            new_decoded, new_jacobian = self._autoencoder.decode_with_jacobian(trial)
            new_residual = configuration[moving] - new_decoded
            new_cost = np.sum(new_residual**2, axis=1)
            better = new_cost <= cost
            latent[moving[better]] = trial[better]
            residual[better], jacobian[better] = new_residual[better], new_jacobian[better]
            cost = np.where(better, new_cost, cost)
            damping = np.where(
                better, np.maximum(damping * _DECAY, _LEAST_DAMPING), damping * _GROWTH
            )
            on = np.sum(step**2, axis=1) > _TOLERANCE**2
            moving, residual, jacobian = moving[on], residual[on], jacobian[on]
            cost, damping = cost[on], damping[on]
        return latent
