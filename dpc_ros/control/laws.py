"""Proportional-derivative laws: the paper's, its authors', and one that rests on an equilibrium."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from dpc_ros.control.equilibrium import EquilibriumError, feed_forward
from dpc_ros.control.law import ControlLaw, LawSettings
from dpc_ros.control.targets import Target
from dpc_ros.reduction import CompressedSystem


class PaperLaw(ControlLaw):
    """u = Γ⁺(ξ̄)[∇V_η(ξ̄) + α(ξ̄ − ξ) − βπ] with π = M_η(ξ)ξ̇ (paper, equation 13).

    Γ has an inverse only where m = 2; elsewhere Γ⁺ is the least-squares left inverse. Near
    singularities it is damped: Γ⁺ = (ΓᵀΓ + λ²I)⁻¹Γᵀ.
    """

    def __init__(self, system: CompressedSystem, settings: LawSettings) -> None:
        super().__init__(system, settings)
        self._target = np.zeros(system.latent_size)
        self._gradient = np.zeros(system.latent_size)
        self._left_inverse = np.zeros((2, system.latent_size))

    def regulate(self, target: Target) -> None:
        latent = self._target_latent(target)
        field = self.system.input_field(latent)
        self._left_inverse = damped_left_inverse(field, self.settings.inverse_damping)
        self._gradient = self.system.potential_gradient(latent)
        self._target = latent

    def unbounded_force(
        self, latent: Float[np.ndarray, ' m'], latent_velocity: Float[np.ndarray, ' m']
    ) -> Float[np.ndarray, ' 2']:
        settings = self.settings
        momentum = self.system.mass_matrix(latent) @ latent_velocity
        feedback = settings.proportional_gain * (self._target - latent)
        feedback = feedback - settings.derivative_gain * momentum
        return self._left_inverse @ (self._gradient + feedback)


class _TransposeFeedback(ControlLaw):
    """u = u* + Γ(ξ*)ᵀ[α(ξ* − ξ) − βξ̇] about a force u* and a latent state ξ* of the target.

    Γᵀ maps the latent error to the work-conjugate of the force, so that the feedback acts like a
    spring and a damper on the actuated mass.
    """

    def __init__(self, system: CompressedSystem, settings: LawSettings) -> None:
        super().__init__(system, settings)
        self._target = np.zeros(system.latent_size)
        self._feed_forward = np.zeros(2)
        self._input_field = np.zeros((system.latent_size, 2))

    def unbounded_force(
        self, latent: Float[np.ndarray, ' m'], latent_velocity: Float[np.ndarray, ' m']
    ) -> Float[np.ndarray, ' 2']:
        settings = self.settings
        feedback = settings.proportional_gain * (self._target - latent)
        feedback = feedback - settings.derivative_gain * latent_velocity
        return self._feed_forward + self._input_field.T @ feedback


class TransposeLaw(_TransposeFeedback):
    """u = Γ⁺(ξ̄)∇V_η(ξ̄) + Γ(ξ̄)ᵀ[α(ξ̄ − ξ) − βξ̇], as the paper's authors release it.

    The feed-forward is the paper's, with the damped left inverse.
    """

    def regulate(self, target: Target) -> None:
        latent = self._target_latent(target)
        field = self.system.input_field(latent)
        inverse = damped_left_inverse(field, self.settings.inverse_damping)
        self._feed_forward = inverse @ self.system.potential_gradient(latent)
        self._target, self._input_field = latent, field


class ReducedEquilibriumLaw(_TransposeFeedback):
    """u = u* + Γ(ξ*)ᵀ[α(ξ* − ξ) − βξ̇], with u* the reduced-equilibrium feed-forward, ξ* = ξ_eq(u*).

    u* is the constant force whose static equilibrium in the compressed system is nearest the
    target (docs/control.md); it exists for every m.
    """

    def regulate(self, target: Target) -> None:
        configuration = self._target_configuration(target)
        solution = feed_forward(self.system, configuration, self.settings.largest_force)
        self._target = solution.latent
        self._feed_forward = solution.force
        self._input_field = self.system.input_field(solution.latent)


def damped_left_inverse(
    input_field: Float[np.ndarray, 'm 2'], damping: float
) -> Float[np.ndarray, '2 m']:
    """Return (ΓᵀΓ + λ²I)⁻¹Γᵀ with λ = damping · (largest singular value of Γ).

    Raises:
        EquilibriumError: Γ is singular, and nothing is damped.
    """
    largest = np.linalg.norm(input_field, 2)
    normal = input_field.T @ input_field + (damping * largest) ** 2 * np.eye(2)
    try:
        return np.linalg.solve(normal, input_field.T)
    except np.linalg.LinAlgError as error:
        raise EquilibriumError(f'the input field has no left inverse: {error}') from error
