"""A linear-quadratic regulator about the best static equilibrium."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_continuous_are

from dpc_ros.control.constant_force import (
    ConstantForce,
    StaticBound,
    nearest_equilibrium,
    static_bound,
)
from dpc_ros.control.equilibrium import EquilibriumError, FeedForward, feed_forward
from dpc_ros.control.law import ControlLaw, LawSettings
from dpc_ros.control.saturation import shorten
from dpc_ros.control.targets import Target
from dpc_ros.reduction import CompressedSystem

_LEAST_WEIGHT = 1e-9  # of each latent and its velocity, so that every mode is observed


@dataclass(frozen=True, eq=False)
class RegulatorSolution:
    """What the regulator knows of a target.

    Attributes:
        target: ξ*.
        feed_forward: u* [N].
        goal: D(ξ*) [m].
        latent_gain: K_p.
        velocity_gain: K_d + cΓ*ᵀ.
        slope: S.
        integrator: (S̃ᵀS̃)⁻¹S̃ᵀ.
    """

    target: Float[np.ndarray, ' m']
    feed_forward: Float[np.ndarray, ' 2']
    goal: Float[np.ndarray, ' n']
    latent_gain: Float[np.ndarray, '2 m']
    velocity_gain: Float[np.ndarray, '2 m']
    slope: Float[np.ndarray, 'm 2']
    integrator: Float[np.ndarray, '2 n']


class QuadraticRegulator(ControlLaw):
    """u = u* + v + K_p(ξ* + Sv − ξ) − (K_d + cΓ*ᵀ)ξ̇, with gains of a latent Riccati equation.

    (u*, q*) is the static equilibrium of the full body nearest to the target, searched from the
    reduced-equilibrium feed-forward, from rest and from the target; ξ* = E(q*).
    K minimises
    ∫ mean((Jδξ)²) + w·mean((Jξ̇)²) + R|δu|² dt for the compressed system linearised there:
    M_η δξ̈ + Δ ξ̇ + Jᵀ∇²V(q*)J δξ = Γ δu (Anderson and Moore, Optimal Control, section 3.3).
    c damps the actuated mass, collocated with the force. v integrates the error along the two
    directions S = ∂ξ_eq/∂u that a constant force can move the equilibrium in:
    v̇ = k(S̃ᵀS̃)⁻¹S̃ᵀ(D(ξ*) − D(ξ)) with S̃ = JS. It waits after a new target, and
    while the force is saturated it does not push beyond the bound any further.
    """

    def __init__(self, system: CompressedSystem, settings: LawSettings) -> None:
        super().__init__(system, settings)
        m, n = system.latent_size, system.autoencoder.configuration_size
        gain = np.zeros((2, m))
        self._solution = RegulatorSolution(
            np.zeros(m), np.zeros(2), np.zeros(n), gain, gain, np.zeros((m, 2)), np.zeros((2, n))
        )
        self._constant = np.zeros(2)  # u* + v
        self._since_target = 0.0

    @property
    def feed_forward(self) -> Float[np.ndarray, ' 2']:
        """The constant force u* of the target [N]."""
        return self._solution.feed_forward

    def solve(self, target: Target) -> RegulatorSolution:
        configuration = self._target_configuration(target)
        settings, system = self.settings, self.system
        autoencoder, mechanics = system.autoencoder, system.mechanics
        reduced: FeedForward | EquilibriumError
        try:
            reduced = feed_forward(system, configuration, settings.largest_force)
        except EquilibriumError as error:
            reduced = error
        found = self._equilibrium(configuration, reduced)
        if found is None:  # the body itself has none near: the compressed one stands in
            if isinstance(reduced, EquilibriumError):
                raise reduced
            force, latent = reduced.force, reduced.latent
            stiffness = system.potential_hessian(latent, force)
        else:
            force, latent = found.force, autoencoder.encode(found.configuration)
            jacobian = autoencoder.decoder_jacobian(latent)
            stiffness = jacobian.T @ mechanics.potential_hessian(found.configuration) @ jacobian
        try:
            gain = self._gain(latent, stiffness)
            field = system.input_field(latent)
            slope = np.linalg.solve(stiffness, field)
            moved = autoencoder.decoder_jacobian(latent) @ slope
            integrator = np.linalg.lstsq(moved, np.eye(len(moved)), rcond=None)[0]
        except np.linalg.LinAlgError as error:
            raise EquilibriumError(f'no regulator about the equilibrium: {error}') from error
        m = system.latent_size
        return RegulatorSolution(
            target=latent,
            feed_forward=force,
            goal=autoencoder.decode(latent),
            latent_gain=gain[:, :m],
            velocity_gain=gain[:, m:] + settings.collocated_damping * field.T,
            slope=slope,
            integrator=integrator,
        )

    def adopt(self, solution: RegulatorSolution) -> None:
        self._solution = solution
        self._constant = solution.feed_forward
        self._since_target = 0.0

    def unbounded_force(
        self, latent: Float[np.ndarray, ' m'], latent_velocity: Float[np.ndarray, ' m']
    ) -> Float[np.ndarray, ' 2']:
        solution = self._solution
        integral = self._constant - solution.feed_forward
        error = solution.target + solution.slope @ integral - latent
        feedback = solution.latent_gain @ error
        return self._constant + feedback - solution.velocity_gain @ latent_velocity

    def advance(self, latent: Float[np.ndarray, ' m'], elapsed: float) -> None:
        self._since_target += elapsed
        gain, largest = self.settings.integral_gain, self.settings.largest_force
        if not gain or self._since_target < self.settings.integral_delay:
            return
        error = self._solution.goal - self.system.autoencoder.decode(latent)
        change = gain * elapsed * (self._solution.integrator @ error)
        if not change @ self.excess > 0:
            self._constant = shorten(self._constant + change, largest)

    def restart(self) -> None:
        super().restart()
        self._constant = self._solution.feed_forward
        self._since_target = 0.0

    def carry_on(self, before: ControlLaw) -> None:
        super().carry_on(before)
        if isinstance(before, QuadraticRegulator):
            integral = before._constant - before.feed_forward
            self._since_target = before._since_target
            if integral.any():
                largest = self.settings.largest_force
                self._constant = shorten(self.feed_forward + integral, largest)

    def _equilibrium(
        self, target: Float[np.ndarray, ' n'], reduced: FeedForward | EquilibriumError
    ) -> StaticBound | None:
        """Return the body's equilibrium nearest to the target of several searches, if there is any.

        One begins at the reduced equilibrium, where there is one, the others are those of
        `static_bound`: from rest, from the target, and from random forces where more than two are
        asked for.
        """
        system, largest = self.system, self.settings.largest_force
        body = ConstantForce(system.mechanics, system.actuated_mass)
        found = []
        with suppress(EquilibriumError):
            if isinstance(reduced, FeedForward):
                start = system.autoencoder.decode(reduced.latent)
                found.append(nearest_equilibrium(body, target, reduced.force, start, largest))
        with suppress(EquilibriumError):
            starts = self.settings.equilibrium_starts
            found.append(
                static_bound(system.mechanics, system.actuated_mass, target, largest, starts)
            )
        return min(found, key=lambda each: each.rms, default=None)

    def _gain(
        self, latent: Float[np.ndarray, ' m'], stiffness: Float[np.ndarray, 'm m']
    ) -> Float[np.ndarray, '2 2*m']:
        """Return K of δu = −K(δξ, ξ̇), by the continuous algebraic Riccati equation."""
        state_matrix, input_matrix = self.linearised(latent, stiffness)
        jacobian = self.system.autoencoder.decoder_jacobian(latent)
        spread = jacobian.T @ jacobian / len(jacobian)
        m = len(latent)
        weight = _LEAST_WEIGHT * np.eye(2 * m)
        weight[:m, :m] += spread
        weight[m:, m:] += self.settings.velocity_weight * spread
        force_weight = self.settings.force_weight
        riccati = solve_continuous_are(state_matrix, input_matrix, weight, force_weight * np.eye(2))
        return input_matrix.T @ riccati / force_weight

    def linearised(
        self, latent: Float[np.ndarray, ' m'], stiffness: Float[np.ndarray, 'm m']
    ) -> tuple[Float[np.ndarray, '2*m 2*m'], Float[np.ndarray, '2*m 2']]:
        """Return A and B of d/dt (δξ, ξ̇) = A(δξ, ξ̇) + Bδu at a latent state at rest."""
        system, m = self.system, len(latent)
        mass_matrix = system.mass_matrix(latent)
        terms = np.hstack([stiffness, system.damping_matrix(latent), system.input_field(latent)])
        divided = np.linalg.solve(mass_matrix, terms)
        above = np.hstack([np.zeros((m, m)), np.eye(m)])
        state_matrix = np.vstack([above, -divided[:, : 2 * m]])
        return state_matrix, np.vstack([np.zeros((m, 2)), divided[:, 2 * m :]])
