"""The terms of the compressed system M_η ξ̈ + … + Δ ξ̇ + ∇V_η(ξ) = Γ u (paper, section II)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder import Autoencoder
from dpc_ros.network import Mechanics


class CompressedSystem:
    """A body's mechanics pulled back to latent coordinates by a decoder D with Jacobian J.

    Args:
        mechanics: the body in its field of gravity.
        autoencoder: its encoder and decoder.
        actuated_mass: number of the mass that carries the input force.

    Raises:
        ValueError: autoencoder and body differ in size.
        NetworkError: the actuated mass does not exist or is fixed.
    """

    def __init__(self, mechanics: Mechanics, autoencoder: Autoencoder, actuated_mass: int) -> None:
        if autoencoder.configuration_size != mechanics.configuration_size:
            raise ValueError(
                f'the autoencoder takes {autoencoder.configuration_size} coordinates, '
                f'{mechanics.network.name} has {mechanics.configuration_size}'
            )
        self.mechanics = mechanics
        self.autoencoder = autoencoder
        self.actuated_mass = actuated_mass
        self.full_input_field = mechanics.input_field(actuated_mass)
        isotropic = mechanics.network.damping_kind == 'isotropic'
        rest = mechanics.network.rest_configuration
        self._constant_damping = mechanics.damping_matrix(rest) if isotropic else None

    @property
    def latent_size(self) -> int:
        """Return m."""
        return self.autoencoder.latent_size

    def mass_matrix(self, latent: Float[np.ndarray, ' m']) -> Float[np.ndarray, 'm m']:
        """Return M_η = JᵀMJ."""
        jacobian = self.autoencoder.decoder_jacobian(latent)
        return jacobian.T @ (self.mechanics.mass_diagonal[:, None] * jacobian)

    def damping_matrix(self, latent: Float[np.ndarray, ' m']) -> Float[np.ndarray, 'm m']:
        """Return Δ = JᵀC(D(ξ))J (the paper prints JᵀC)."""
        decoded, jacobian = self.autoencoder.decode_with_jacobian(latent)
        damping = self._constant_damping
        if damping is None:
            damping = self.mechanics.damping_matrix(decoded)
        return jacobian.T @ damping @ jacobian

    def input_field(self, latent: Float[np.ndarray, ' m']) -> Float[np.ndarray, 'm 2']:
        """Return Γ = JᵀG."""
        return self.autoencoder.decoder_jacobian(latent).T @ self.full_input_field

    def potential(
        self, latent: Float[np.ndarray, ' m'], force: Float[np.ndarray, ' 2'] | None = None
    ) -> float:
        """Return V_η(ξ) = V(D(ξ)) [J], minus uᵀGᵀD(ξ) under a constant force u [N]."""
        configuration = self.autoencoder.decode(latent)
        energy = self.mechanics.potential(configuration)
        if force is not None:
            energy -= float(force @ (self.full_input_field.T @ configuration))
        return energy

    def potential_gradient(
        self, latent: Float[np.ndarray, ' m'], force: Float[np.ndarray, ' 2'] | None = None
    ) -> Float[np.ndarray, ' m']:
        """Return ∇V_η(ξ) = Jᵀ∇V(D(ξ)), minus Γu under a constant force u [N]."""
        configuration, jacobian = self.autoencoder.decode_with_jacobian(latent)
        return jacobian.T @ self._full_gradient(configuration, force)

    def potential_hessian(
        self, latent: Float[np.ndarray, ' m'], force: Float[np.ndarray, ' 2'] | None = None
    ) -> Float[np.ndarray, 'm m']:
        """Return ∇²V_η(ξ) = Jᵀ∇²V J + Σ_i (∇V − Gu)_i ∂²D_i/∂ξ²."""
        configuration, jacobian = self.autoencoder.decode_with_jacobian(latent)
        gradient = self._full_gradient(configuration, force)
        projected = jacobian.T @ self.mechanics.potential_hessian(configuration) @ jacobian
        return projected + self.autoencoder.decoder_curvature(latent, gradient)

    def _full_gradient(
        self, configuration: Float[np.ndarray, ' n'], force: Float[np.ndarray, ' 2'] | None
    ) -> Float[np.ndarray, ' n']:
        gradient = self.mechanics.potential_gradient(configuration)
        return gradient if force is None else gradient - self.full_input_field @ force
