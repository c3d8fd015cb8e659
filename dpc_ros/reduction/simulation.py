"""Simulation of the compressed system at a fixed step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from dpc_ros.reduction.compressed_system import CompressedSystem

_TOLERANCE = 1e-13  # of an implicit step's latent velocity, relative, at which its search ends
_RESIDUAL = 1e-11  # of the momenta in an implicit step, relative, at which it is solved


class DivergenceError(ValueError):
    """A compressed simulation that left every bound: the step is too long, or the decoder fails."""


class UnsolvedStepError(DivergenceError):
    """An implicit step whose equation was not solved."""


@dataclass(frozen=True, eq=False)
class LatentTrajectory:
    """States of the compressed system at equal steps of time, the first at time zero.

    Attributes:
        step: time between two states [s].
        latent: ξ of each state.
        velocity: ξ̇ of each state [1/s].
    """

    step: float
    latent: Float[np.ndarray, 'frames *batch m']
    velocity: Float[np.ndarray, 'frames *batch m']

    @property
    def time(self) -> Float[np.ndarray, ' frames']:
        """Time of each state [s]."""
        return self.step * np.arange(len(self.latent))


def simulate_compressed(
    system: CompressedSystem,
    latent: Float[np.ndarray, '*batch m'],
    velocity: Float[np.ndarray, '*batch m'],
    step: float,
    steps: int,
    force: Float[np.ndarray, ' 2'] | Float[np.ndarray, 'steps 2'] | None = None,
    method: str = 'rk4',
    progress: bool = False,
) -> LatentTrajectory:
    """Integrate the compressed system over a number of steps.

    Args:
        system: the compressed system in its field of gravity.
        latent: ξ at time zero, of one trajectory or of several.
        velocity: ξ̇ at time zero [1/s].
        step: time step [s], > 0.
        steps: number of steps; the trajectory holds one state more.
        force: u [N] on the actuated mass, constant or held over each step; zero where left out.
        method: a key of `METHODS`: `rk4`, the classical Runge–Kutta method of order four on
            (ξ, ξ̇), or `implicit_midpoint` on (ξ, π), symplectic and symmetric in time where
            nothing damps (Hairer, Lubich, Wanner, Geometric Numerical Integration, II.1, VI.4).
        progress: show a progress bar.

    Raises:
        ValueError: unknown method, a step that is not positive, states or forces of another shape
            or not finite.
        DivergenceError: a state is no longer finite, or an implicit step was not solved.
    """
    check_method(method)
    if not (np.isfinite(step) and step > 0):
        raise ValueError(f'step: expected a time > 0 s, got {step}')
    if not isinstance(steps, int | np.integer) or steps < 0:
        raise ValueError(f'steps: expected a whole number ≥ 0, got {steps!r}')
    latent, velocity = np.asarray(latent, float), np.asarray(velocity, float)
    if latent.shape[-1:] != (system.latent_size,) or velocity.shape != latent.shape:
        raise ValueError(
            f'state: expected {system.latent_size} latents and as many velocities, got the shapes '
            f'{latent.shape} and {velocity.shape}'
        )
    forces = np.zeros(2) if force is None else np.asarray(force, float)
    if forces.shape not in ((2,), (steps, 2)):
        raise ValueError(
            f'force: expected u, or one for each of {steps} steps, got the shape {forces.shape}'
        )
    forces = np.broadcast_to(forces, (steps, 2))
    if not all(np.isfinite(values).all() for values in (latent, velocity, forces)):
        raise ValueError('state and force: expected finite numbers')
    latents = np.empty((steps + 1, *latent.shape))
    velocities = np.empty_like(latents)
    latents[0], velocities[0] = latent, velocity
    advance = METHODS[method]
    for k in tqdm(range(steps), desc='simulating', unit='step', disable=not progress):
        try:
            with np.errstate(all='ignore'):  # what is not finite is told below
                state = advance(system, latents[k], velocities[k], forces[k], step)
        except np.linalg.LinAlgError as error:
            raise _diverged(k, step) from error
        except UnsolvedStepError as error:
            raise UnsolvedStepError(f'at {k * step:g} s: {error}') from None
        latents[k + 1], velocities[k + 1] = state
        if not np.isfinite(state).all():
            raise _diverged(k, step)
    return LatentTrajectory(float(step), latents, velocities)


def check_method(method: str) -> None:
    """Make sure that there is a method of a name.

    Raises:
        ValueError: there is none.
    """
    if method not in METHODS:
        raise ValueError(f'unknown method {method!r}: choose one of {sorted(METHODS)}')


def _diverged(k: int, step: float) -> DivergenceError:
    return DivergenceError(
        f'the compressed simulation diverged at {k * step:g} s with steps of {step:g} s: take '
        'shorter steps, or a decoder that knows the configurations that it comes to'
    )


State = tuple[np.ndarray, np.ndarray]


def rk4_step(
    system: CompressedSystem,
    latent: Float[np.ndarray, '*batch m'],
    velocity: Float[np.ndarray, '*batch m'],
    force: Float[np.ndarray, ' 2'],
    step: float,
) -> State:
    """Return the state after one classical Runge–Kutta step of order four; nothing is checked.

    Args:
        system: the compressed system.
        latent: ξ before it, of one trajectory or of several.
        velocity: ξ̇ before it [1/s].
        force: u [N], held over the step.
        step: its length [s].

    Raises:
        LinAlgError: the mass matrix is singular, or its values are not finite.
    """
    forces = np.broadcast_to(force, (*latent.shape[:-1], 2))

    def acceleration(xi: np.ndarray, xi_dot: np.ndarray) -> np.ndarray:
        return system.acceleration(xi, xi_dot, forces)

    half = 0.5 * step
    a1 = acceleration(latent, velocity)
    v2 = velocity + half * a1
    a2 = acceleration(latent + half * velocity, v2)
    v3 = velocity + half * a2
    a3 = acceleration(latent + half * v2, v3)
    v4 = velocity + step * a3
    a4 = acceleration(latent + step * v3, v4)
    return (
        latent + step / 6.0 * (velocity + 2.0 * v2 + 2.0 * v3 + v4),
        velocity + step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
    )


def _implicit_midpoint_step(
    system: CompressedSystem,
    latent: Float[np.ndarray, '*batch m'],
    velocity: Float[np.ndarray, '*batch m'],
    force: Float[np.ndarray, ' 2'],
    step: float,
) -> State:
    if latent.ndim > 1:
        each = [
            _implicit_midpoint_step(system, *state, force, step)
            for state in zip(latent, velocity, strict=True)
        ]
        latents, velocities = zip(*each, strict=True)
        return np.stack(latents), np.stack(velocities)
    momentum = system.momentum(latent, velocity)
    middle = _middle_velocity(system, latent, velocity, momentum, force, step)
    half_way = latent + 0.5 * step * middle
    new_latent = latent + step * middle
    new_momentum = 2.0 * system.momentum(half_way, middle) - momentum
    return new_latent, system.latent_velocity(new_latent, new_momentum)


def _middle_velocity(
    system: CompressedSystem,
    latent: Float[np.ndarray, ' m'],
    velocity: Float[np.ndarray, ' m'],
    momentum: Float[np.ndarray, ' m'],
    force: Float[np.ndarray, ' 2'],
    step: float,
) -> Float[np.ndarray, ' m']:
    """Solve M_η(ξ + ½hv)v = π + ½hπ̇(ξ + ½hv, v) for the velocity v at the middle of a step.

    By Powell's hybrid method from the velocity that the acceleration foretells.

    Raises:
        UnsolvedStepError: no convergence, or no solution: there need not be one for a long step.
    """
    from scipy.optimize import root  # slow to import, and the nodes need none of it

    half = 0.5 * step

    def lack(v: np.ndarray) -> np.ndarray:
        point = latent + half * v
        rate = system.momentum_rate(point, v, force)
        return momentum + half * rate - system.momentum(point, v)

    start = velocity + half * system.acceleration(latent, velocity, force)
    solution = root(lack, start, method='hybr', options={'xtol': _TOLERANCE})
    moved = half * np.abs(system.momentum_rate(latent, velocity, force)).max()
    # Not by its own judgement: at rounding it finds that it makes no progress.
    if not np.abs(solution.fun).max() <= _RESIDUAL * (np.abs(momentum).max() + moved):
        raise UnsolvedStepError(
            f'an implicit step of {step:g} s was not solved: take shorter ones, or rk4 (where the '
            'decoder bends much within a step there may be no solution)'
        )
    return solution.x


METHODS: dict[str, Callable[..., State]] = {
    'rk4': rk4_step,
    'implicit_midpoint': _implicit_midpoint_step,
}
