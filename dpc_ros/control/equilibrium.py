"""Static equilibria of the compressed system and the constant force that comes nearest a target."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dpc_ros.control.force_search import next_force
from dpc_ros.control.saturation import shorten
from dpc_ros.reduction import CompressedSystem

_TOLERANCE = 1e-7  # N per latent unit, on the gradient of the potential at an equilibrium
_RESOLUTION = 1e-12  # relative decrease that the potential still resolves in float64
_NEWTON_ITERATIONS = 100
_LARGEST_FORCE_STEP = 0.5  # N between two equilibria of one continuation
_FORCE_TOLERANCE = 1e-7  # N
_HAND_STIFFNESS = 100.0  # N/m, of what pulls a mass, where bodies give way by 0.1 to 1 m/N
_SEARCH_ITERATIONS = 100
_SMALLEST_CURVATURE = 1e-6  # relative to the largest, below which Newton's step is regularised


class EquilibriumError(ValueError):
    """No static equilibrium was found."""


@dataclass(frozen=True, eq=False)
class FeedForward:
    """A constant force and what it holds.

    Attributes:
        force: u* [N].
        latent: ξ_eq(u*), the stable static equilibrium of the compressed system under it.
        distance: from what was wanted [m]: for a configuration q̄ the root mean square of
            D(ξ_eq(u*)) − q̄ over the coordinates.
    """

    force: Float[np.ndarray, ' 2']
    latent: Float[np.ndarray, ' m']
    distance: float


def reduced_equilibrium(
    system: CompressedSystem,
    force: Float[np.ndarray, ' 2'],
    start: Float[np.ndarray, ' m'],
) -> Float[np.ndarray, ' m']:
    """Return a stable static equilibrium ξ of the compressed system under a constant force.

    Minimises V_η(ξ) − uᵀGᵀD(ξ) from `start` by Newton steps with backtracking, in which negative
    curvature counts by its absolute value: a minimum comes out, never a saddle.

    Args:
        system: the compressed system.
        force: u [N].
        start: latent to begin from; the equilibrium of a nearby force.

    Raises:
        EquilibriumError: no convergence within the bound on iterations, or a force or start that
            is not finite.
    """
    if not (np.isfinite(force).all() and np.isfinite(start).all()):
        raise EquilibriumError(f'expected a finite force and start, got {force} N and {start}')
    latent = _minimum(
        lambda xi: system.potential(xi, force),
        lambda xi: system.potential_gradient(xi, force),
        lambda xi: system.potential_hessian(xi, force),
        start,
    )
    residual = np.abs(system.potential_gradient(latent, force)).max()
    if not residual <= _TOLERANCE:  # also where it is not a number
        raise EquilibriumError(
            f'no static equilibrium under the force {np.round(force, 3).tolist()} N: the gradient '
            f'of the potential stays at {residual:.1e}; is the force beyond the training data?'
        )
    return latent


def pulled_equilibrium(
    system: CompressedSystem,
    position: Float[np.ndarray, ' 2'],
    start: Float[np.ndarray, ' m'],
    largest_force: float = np.inf,
) -> FeedForward:
    """Return the static equilibrium to which the actuated mass is pulled by its hand.

    A stiff spring joins the mass to the position. What it pulls with where all is at rest is the
    force u; the equilibrium is that under u alone, so that a constant force holds it, and the mass
    is as near to the position as the spring is stiff and the force may be strong.

    Args:
        system: the compressed system.
        position: where the mass is wanted [m].
        start: latent to begin from: that of rest, or what was found for a position nearby.
        largest_force: bound on |u| [N].

    Returns:
        force, equilibrium, and the distance of the mass from the position [m].

    Raises:
        EquilibriumError: no convergence, or a position or start that is not finite.
    """
    if not (np.isfinite(position).all() and np.isfinite(start).all()):
        raise EquilibriumError(f'expected a finite position and start, got {position} and {start}')

    def away(latent: np.ndarray) -> np.ndarray:
        return position - system.full_input_field.T @ system.autoencoder.decode(latent)

    def pull(latent: np.ndarray) -> np.ndarray:
        return _HAND_STIFFNESS * away(latent)

    def energy(latent: np.ndarray) -> float:
        return system.potential(latent) + 0.5 * _HAND_STIFFNESS * float(np.sum(away(latent) ** 2))

    def hessian(latent: np.ndarray) -> np.ndarray:
        field = system.input_field(latent)
        return system.potential_hessian(latent, pull(latent)) + _HAND_STIFFNESS * field @ field.T

    latent = _minimum(energy, lambda xi: system.potential_gradient(xi, pull(xi)), hessian, start)
    force = shorten(pull(latent), largest_force)
    latent = reduced_equilibrium(system, force, latent)
    return FeedForward(force, latent, float(np.linalg.norm(away(latent))))


def _minimum(
    value: Callable[[np.ndarray], float],
    gradient: Callable[[np.ndarray], np.ndarray],
    hessian: Callable[[np.ndarray], np.ndarray],
    start: Float[np.ndarray, ' m'],
) -> Float[np.ndarray, ' m']:
    """Return where Newton steps with backtracking end, a minimum where they converge."""
    latent = np.array(start, dtype=float)
    for _ in range(_NEWTON_ITERATIONS):
        present, slope = value(latent), gradient(latent)
        direction = _newton_direction(slope, hessian(latent))
        decrease = -float(slope @ direction)
        if decrease <= _RESOLUTION * max(abs(present), 1.0):
            return latent + direction
        scale = 1.0
        while value(latent + scale * direction) > present - 1e-4 * scale * decrease:
            scale *= 0.5
        latent = latent + scale * direction
    return latent


def _newton_direction(
    gradient: Float[np.ndarray, ' m'], hessian: Float[np.ndarray, 'm m']
) -> Float[np.ndarray, ' m']:
    curvature, modes = np.linalg.eigh(hessian)
    curvature = np.maximum(np.abs(curvature), _SMALLEST_CURVATURE * np.abs(curvature).max())
    return -modes @ ((modes.T @ gradient) / curvature)


def feed_forward(
    system: CompressedSystem, target: Float[np.ndarray, ' n'], largest_force: float = np.inf
) -> FeedForward:
    """Return u* = argmin_u |D(ξ_eq(u)) − q̄|, with ξ_eq(u) continued from rest (docs/control.md).

    Levenberg–Marquardt over the two components of the force (`next_force`). Each trial's
    equilibrium continues from the present one, and no step is longer than a bound, so that the
    search follows one branch of stable equilibria from the unforced one. Its slope is
    ∂ξ_eq/∂u = (∇²V_η)⁻¹Γ.

    Args:
        system: the compressed system.
        target: q̄ [m].
        largest_force: bound on |u| [N].

    Raises:
        EquilibriumError: the body has no stable unforced equilibrium near rest.
    """
    rest = system.autoencoder.encode(system.mechanics.network.rest_configuration)
    force = np.zeros(2)
    latent = reduced_equilibrium(system, force, rest)
    residual = system.autoencoder.decode(latent) - target
    damping = 1e-3
    for _ in range(_SEARCH_ITERATIONS):
        slope = _equilibrium_slope(system, latent, force)
        trial = next_force(force, slope, residual, damping, _LARGEST_FORCE_STEP, largest_force)
        if np.linalg.norm(trial - force) < _FORCE_TOLERANCE:
            break
        try:
            trial_latent = reduced_equilibrium(system, trial, latent)
        except EquilibriumError:
            damping *= 4.0
            continue
        trial_residual = system.autoencoder.decode(trial_latent) - target
        if trial_residual @ trial_residual < residual @ residual:
            force, latent, residual = trial, trial_latent, trial_residual
            damping = max(damping / 4.0, 1e-9)
        else:
            damping *= 4.0
    return FeedForward(force, latent, float(np.sqrt(np.mean(residual**2))))


def _equilibrium_slope(
    system: CompressedSystem, latent: Float[np.ndarray, ' m'], force: Float[np.ndarray, ' 2']
) -> Float[np.ndarray, 'n 2']:
    jacobian = system.autoencoder.decoder_jacobian(latent)
    hessian = system.potential_hessian(latent, force)
    return jacobian @ np.linalg.solve(hessian, system.input_field(latent))
