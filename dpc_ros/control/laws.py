"""Control laws: from the latent state to the force on the actuated mass."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import Float

from dpc_ros.control.equilibrium import feed_forward
from dpc_ros.control.saturation import shorten
from dpc_ros.control.targets import Target
from dpc_ros.reduction import CompressedSystem


class ControlLaw(ABC):
    """A map from (ξ, ξ̇) to the force u that regulates the body to a target.

    Args:
        system: the compressed system.
        proportional_gain: α, on the latent error (latents have unit deviation).
        derivative_gain: β, on the latent velocity or momentum.
        largest_force: bound on |u| [N]; longer forces are shortened, their direction kept.

    Raises:
        ValueError: a gain or the bound is negative or not a number.
    """

    def __init__(
        self,
        system: CompressedSystem,
        proportional_gain: float,
        derivative_gain: float,
        largest_force: float = np.inf,
    ) -> None:
        for name, value in {
            'proportional gain': proportional_gain,
            'derivative gain': derivative_gain,
            'largest force': largest_force,
        }.items():
            if not value >= 0:
                raise ValueError(f'{name}: expected a number ≥ 0, got {value}')
        self.system = system
        self.proportional_gain = proportional_gain
        self.derivative_gain = derivative_gain
        self.largest_force = largest_force

    @abstractmethod
    def regulate(self, target: Target) -> None:
        """Take a new target; whatever is slow happens here, not in `force`.

        Raises:
            TargetError: its length does not fit.
        """

    @abstractmethod
    def unbounded_force(
        self, latent: Float[np.ndarray, ' m'], latent_velocity: Float[np.ndarray, ' m']
    ) -> Float[np.ndarray, ' 2']:
        """Return u [N] before saturation."""

    def force(
        self, latent: Float[np.ndarray, ' m'], latent_velocity: Float[np.ndarray, ' m']
    ) -> Float[np.ndarray, ' 2']:
        """Return u [N], its norm bounded by the largest force."""
        return shorten(self.unbounded_force(latent, latent_velocity), self.largest_force)

    def _target_latent(self, target: Target) -> Float[np.ndarray, ' m']:
        autoencoder = self.system.autoencoder
        target.check_sizes(autoencoder.configuration_size, autoencoder.latent_size)
        return target.value if target.is_latent else autoencoder.encode(target.value)


class PaperLaw(ControlLaw):
    """u = Γ⁺(ξ̄)[∇V_η(ξ̄) + α(ξ̄ − ξ) − βπ] with π = M_η(ξ)ξ̇ (paper, equation 13).

    Γ has an inverse only where m = 2; elsewhere Γ⁺ is the least-squares left inverse. Near
    singularities it is damped: Γ⁺ = (ΓᵀΓ + λ²I)⁻¹Γᵀ.

    Args:
        system, proportional_gain, derivative_gain, largest_force: see `ControlLaw`.
        inverse_damping: λ, relative to the largest singular value of Γ(ξ̄).
    """

    def __init__(
        self,
        system: CompressedSystem,
        proportional_gain: float,
        derivative_gain: float,
        largest_force: float = np.inf,
        inverse_damping: float = 0.05,
    ) -> None:
        super().__init__(system, proportional_gain, derivative_gain, largest_force)
        self._inverse_damping = inverse_damping
        self._target = np.zeros(system.latent_size)
        self._gradient = np.zeros(system.latent_size)
        self._left_inverse = np.zeros((2, system.latent_size))

    def regulate(self, target: Target) -> None:
        self._target = self._target_latent(target)
        self._gradient = self.system.potential_gradient(self._target)
        self._left_inverse = damped_left_inverse(
            self.system.input_field(self._target), self._inverse_damping
        )

    def unbounded_force(
        self, latent: Float[np.ndarray, ' m'], latent_velocity: Float[np.ndarray, ' m']
    ) -> Float[np.ndarray, ' 2']:
        momentum = self.system.mass_matrix(latent) @ latent_velocity
        feedback = (
            self.proportional_gain * (self._target - latent) - self.derivative_gain * momentum
        )
        return self._left_inverse @ (self._gradient + feedback)


class ReducedEquilibriumLaw(ControlLaw):
    """u = u* + Γ(ξ*)ᵀ[α(ξ* − ξ) − βξ̇], with u* the reduced-equilibrium feed-forward, ξ* = ξ_eq(u*).

    u* is the constant force whose static equilibrium in the compressed system is nearest the
    target (docs/control.md); it exists for every m. Γᵀ maps the latent error to the work-conjugate
    of the force, so that the feedback acts like a spring and a damper on the actuated mass.
    """

    def __init__(
        self,
        system: CompressedSystem,
        proportional_gain: float,
        derivative_gain: float,
        largest_force: float = np.inf,
    ) -> None:
        super().__init__(system, proportional_gain, derivative_gain, largest_force)
        self._target = np.zeros(system.latent_size)
        self._feed_forward = np.zeros(2)
        self._input_field = np.zeros((system.latent_size, 2))

    def regulate(self, target: Target) -> None:
        autoencoder = self.system.autoencoder
        target.check_sizes(autoencoder.configuration_size, autoencoder.latent_size)
        configuration = autoencoder.decode(target.value) if target.is_latent else target.value
        solution = feed_forward(self.system, configuration, self.largest_force)
        self._target = solution.latent
        self._feed_forward = solution.force
        self._input_field = self.system.input_field(solution.latent)

    def unbounded_force(
        self, latent: Float[np.ndarray, ' m'], latent_velocity: Float[np.ndarray, ' m']
    ) -> Float[np.ndarray, ' 2']:
        feedback = (
            self.proportional_gain * (self._target - latent)
            - self.derivative_gain * latent_velocity
        )
        return self._feed_forward + self._input_field.T @ feedback


def damped_left_inverse(
    input_field: Float[np.ndarray, 'm 2'], damping: float
) -> Float[np.ndarray, '2 m']:
    """Return (ΓᵀΓ + λ²I)⁻¹Γᵀ with λ = damping · (largest singular value of Γ)."""
    largest = np.linalg.norm(input_field, 2)
    normal = input_field.T @ input_field + (damping * largest) ** 2 * np.eye(2)
    return np.linalg.solve(normal, input_field.T)


LAWS: dict[str, type[ControlLaw]] = {
    'paper': PaperLaw,
    'reduced_equilibrium': ReducedEquilibriumLaw,
}


def make_law(
    name: str,
    system: CompressedSystem,
    proportional_gain: float,
    derivative_gain: float,
    largest_force: float = np.inf,
) -> ControlLaw:
    """Return the control law of a name.

    Raises:
        ValueError: there is no such law.
    """
    if name not in LAWS:
        raise ValueError(f'unknown control law {name!r}: choose one of {sorted(LAWS)}')
    return LAWS[name](system, proportional_gain, derivative_gain, largest_force)
