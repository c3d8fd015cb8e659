"""The compressed Hamiltonian system M_η ξ̈ + … + Δ ξ̇ + ∇V_η(ξ) = Γ u (paper, section II)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder import Autoencoder
from dpc_ros.network import Mechanics
from dpc_ros.reduction import kernels


class CompressedSystem:
    """A body's mechanics pulled back to latent coordinates by a decoder D with Jacobian J.

    Its state is (ξ, ξ̇), or (ξ, π) with the momentum π = M_η ξ̇. What is annotated with `*batch`
    takes any leading dimensions, the others take one state.

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
        self._decoder = autoencoder.compiled_decoder()
        self._place = 2 * mechanics.network.mobile_index(actuated_mass)

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

    def momentum(
        self, latent: Float[np.ndarray, '*batch m'], velocity: Float[np.ndarray, '*batch m']
    ) -> Float[np.ndarray, '*batch m']:
        """Return π = M_η(ξ)ξ̇."""
        jacobian = self.autoencoder.decode_with_jacobian(latent)[1]
        full = np.einsum('...ia,...a->...i', jacobian, velocity)
        return np.einsum('...ia,...i->...a', jacobian, self.mechanics.mass_diagonal * full)

    def latent_velocity(
        self, latent: Float[np.ndarray, ' m'], momentum: Float[np.ndarray, ' m']
    ) -> Float[np.ndarray, ' m']:
        """Return ξ̇ = M_η(ξ)⁻¹π."""
        return np.linalg.solve(self.mass_matrix(latent), momentum)

    def kinetic_energy(
        self, latent: Float[np.ndarray, ' m'], velocity: Float[np.ndarray, ' m']
    ) -> float:
        """Return ½ ξ̇ᵀM_η ξ̇ = ½ πᵀM_η⁻¹π [J]."""
        return self.mechanics.kinetic_energy(self.autoencoder.decoder_jacobian(latent) @ velocity)

    def total_energy(
        self, latent: Float[np.ndarray, ' m'], velocity: Float[np.ndarray, ' m']
    ) -> float:
        """Return the Hamiltonian η = ½ πᵀM_η⁻¹π + V_η(ξ) [J] (paper, section II)."""
        return self.kinetic_energy(latent, velocity) + self.potential(latent)

    def power(
        self,
        latent: Float[np.ndarray, ' m'],
        velocity: Float[np.ndarray, ' m'],
        force: Float[np.ndarray, ' 2'] | None = None,
    ) -> float:
        """Return η̇ = −ξ̇ᵀΔξ̇ + ξ̇ᵀΓu [W], what damping takes and the force u [N] gives."""
        configuration, jacobian = self.autoencoder.decode_with_jacobian(latent)
        full = jacobian @ velocity
        external = -self.mechanics.damping_force(configuration, full)
        if force is not None:
            external += self.full_input_field @ force
        return float(full @ external)

    def acceleration(
        self,
        latent: Float[np.ndarray, '*batch m'],
        velocity: Float[np.ndarray, '*batch m'],
        force: Float[np.ndarray, ' 2'] | Float[np.ndarray, '*batch 2'] | None = None,
    ) -> Float[np.ndarray, '*batch m']:
        """Return ξ̈ = M_η⁻¹[Γu − JᵀM(J̇ξ̇) − Δξ̇ − ∇V_η] under a force u [N].

        It is M_η⁻¹JᵀM(q̈ − J̇ξ̇), the nearest in the metric of M to the acceleration q̈ that the body
        has at (D(ξ), Jξ̇) (Gauss's principle of least constraint). Compiled for dense decoders.

        Raises:
            ValueError: state or force have other shapes.
            LinAlgError: the mass matrix is singular, or its values are not finite.
        """
        rows = [
            self._rows('latent', latent, (*latent.shape[:-1], self.latent_size)),
            self._rows('velocity', velocity, latent.shape),
            self._rows('force', np.zeros(2) if force is None else force, (*latent.shape[:-1], 2)),
        ]
        if self._decoder is None:
            accelerations = self._accelerations(*rows)
        else:
            body = (self.mechanics.arrays, self.mechanics.gravity_vector, self._place)
            accelerations = kernels.accelerations(self._decoder, *body, *rows)
        return accelerations.reshape(latent.shape)

    def momentum_rate(
        self,
        latent: Float[np.ndarray, ' m'],
        velocity: Float[np.ndarray, ' m'],
        force: Float[np.ndarray, ' 2'] | None = None,
    ) -> Float[np.ndarray, ' m']:
        """Return π̇ = J̇ᵀMJξ̇ − ∇V_η − Δξ̇ + Γu under a force u [N], with ξ̇ = M_η⁻¹π."""
        configuration, jacobian = self.autoencoder.decode_with_jacobian(latent)
        full = jacobian @ velocity
        # J̇ᵀw = Σ_i w_i (∂²D_i/∂ξ²) ξ̇
        bend = self.autoencoder.decoder_curvature(latent, self.mechanics.mass_diagonal * full)
        static = self._full_gradient(configuration, force)
        return bend @ velocity - jacobian.T @ (
            static + self.mechanics.damping_force(configuration, full)
        )

    @staticmethod
    def _rows(what: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """Return one row for each state, as the kernel takes them: it checks no bounds."""
        value = np.asarray(value)
        if value.shape != shape:  # `broadcast_to` takes as long as a tenth of an acceleration
            try:
                value = np.broadcast_to(value, shape)
            except ValueError:
                raise ValueError(f'{what}: expected the shape {shape}, got {value.shape}') from None
        # A copy: read-only ones would be compiled for anew.
        return np.array(value.reshape(-1, shape[-1]), float, order='C')

    def _accelerations(
        self,
        latent: Float[np.ndarray, 'batch m'],
        velocity: Float[np.ndarray, 'batch m'],
        force: Float[np.ndarray, 'batch 2'],
    ) -> Float[np.ndarray, 'batch m']:
        """Return ξ̈ for a decoder of any kind; the kernel's reference."""
        decoded, jacobian, bend = self.autoencoder.decode_with_derivatives(latent, velocity)
        full = np.einsum('bia,ba->bi', jacobian, velocity)
        states = zip(decoded, full, force @ self.full_input_field.T, strict=True)
        difference = np.stack([self.mechanics.acceleration(*state) for state in states]) - bend
        weighted = self.mechanics.mass_diagonal[:, None] * jacobian
        mass_matrix = np.einsum('bia,bic->bac', jacobian, weighted)
        right = np.einsum('bia,bi->ba', weighted, difference)
        return np.linalg.solve(mass_matrix, right[..., None])[..., 0]

    def _full_gradient(
        self, configuration: Float[np.ndarray, ' n'], force: Float[np.ndarray, ' 2'] | None
    ) -> Float[np.ndarray, ' n']:
        gradient = self.mechanics.potential_gradient(configuration)
        return gradient if force is None else gradient - self.full_input_field @ force
