"""Proportional-derivative laws: the paper's, its authors', and one that rests on an equilibrium."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dpc_ros.control.equilibrium import EquilibriumError, feed_forward
from dpc_ros.control.law import ControlLaw, LawSettings
from dpc_ros.control.targets import Target
from dpc_ros.reduction import CompressedSystem


@dataclass(frozen=True, eq=False)
class PaperSolution:
    """What the paper's law knows of a target.

    Attributes:
        target: ξ̄.
        gradient: ∇V_η(ξ̄) [N].
        left_inverse: Γ⁺(ξ̄).
    """

    target: Float[np.ndarray, ' m']
    gradient: Float[np.ndarray, ' m']
    left_inverse: Float[np.ndarray, '2 m']


@dataclass(frozen=True, eq=False)
class RestingForce:
    """A force, the latent state that it holds the body at, and how a force acts there.

    Attributes:
        target: ξ*.
        feed_forward: u* [N].
        input_field: Γ(ξ*).
    """

    target: Float[np.ndarray, ' m']
    feed_forward: Float[np.ndarray, ' 2']
    input_field: Float[np.ndarray, 'm 2']


class PaperLaw(ControlLaw):
    """u = Γ⁺(ξ̄)[∇V_η(ξ̄) + α(ξ̄ − ξ) − βπ] with π = M_η(ξ)ξ̇ (paper, equation 13).

    Γ has an inverse only where m = 2; elsewhere Γ⁺ is the least-squares left inverse. Near
    singularities it is damped: Γ⁺ = (ΓᵀΓ + λ²I)⁻¹Γᵀ.
    """

    def __init__(self, system: CompressedSystem, settings: LawSettings) -> None:
        super().__init__(system, settings)
        m = system.latent_size
        self._solution = PaperSolution(np.zeros(m), np.zeros(m), np.zeros((2, m)))

    def solve(self, target: Target) -> PaperSolution:
        latent = self._target_latent(target)
        field = self.system.input_field(latent)
        inverse = damped_left_inverse(field, self.settings.inverse_damping)
        return PaperSolution(latent, self.system.potential_gradient(latent), inverse)

    def adopt(self, solution: PaperSolution) -> None:
        self._solution = solution

    def unbounded_force(
        self, latent: Float[np.ndarray, ' m'], latent_velocity: Float[np.ndarray, ' m']
    ) -> Float[np.ndarray, ' 2']:
        settings, solution = self.settings, self._solution
        momentum = self.system.mass_matrix(latent) @ latent_velocity
        feedback = settings.proportional_gain * (solution.target - latent)
        feedback = feedback - settings.derivative_gain * momentum
        return solution.left_inverse @ (solution.gradient + feedback)


class _TransposeFeedback(ControlLaw):
    """u = u* + Γ(ξ*)ᵀ[α(ξ* − ξ) − βξ̇] about a force u* and a latent state ξ* of the target.

    Γᵀ maps the latent error to the work-conjugate of the force, so that the feedback acts like a
    spring and a damper on the actuated mass.
    """

    def __init__(self, system: CompressedSystem, settings: LawSettings) -> None:
        super().__init__(system, settings)
        m = system.latent_size
        self._solution = RestingForce(np.zeros(m), np.zeros(2), np.zeros((m, 2)))

    def adopt(self, solution: RestingForce) -> None:
        self._solution = solution

    def unbounded_force(
        self, latent: Float[np.ndarray, ' m'], latent_velocity: Float[np.ndarray, ' m']
    ) -> Float[np.ndarray, ' 2']:
        settings, solution = self.settings, self._solution
        feedback = settings.proportional_gain * (solution.target - latent)
        feedback = feedback - settings.derivative_gain * latent_velocity
        return solution.feed_forward + solution.input_field.T @ feedback


class TransposeLaw(_TransposeFeedback):
    """u = Γ⁺(ξ̄)∇V_η(ξ̄) + Γ(ξ̄)ᵀ[α(ξ̄ − ξ) − βξ̇], as the paper's authors release it.

    The feed-forward is the paper's, with the damped left inverse.
    """

    def solve(self, target: Target) -> RestingForce:
        latent = self._target_latent(target)
        field = self.system.input_field(latent)
        inverse = damped_left_inverse(field, self.settings.inverse_damping)
        return RestingForce(latent, inverse @ self.system.potential_gradient(latent), field)


class ReducedEquilibriumLaw(_TransposeFeedback):
    """u = u* + Γ(ξ*)ᵀ[α(ξ* − ξ) − βξ̇], with u* the reduced-equilibrium feed-forward, ξ* = ξ_eq(u*).

    u* is the constant force whose static equilibrium in the compressed system is nearest the
    target (docs/control.md); it exists for every m.
    """

    def solve(self, target: Target) -> RestingForce:
        configuration = self._target_configuration(target)
        found = feed_forward(self.system, configuration, self.settings.largest_force)
        return RestingForce(found.latent, found.force, self.system.input_field(found.latent))


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
