"""Integration of a network in time at a fixed step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dpc_ros.network import kernels
from dpc_ros.network.mechanics import Mechanics

INTEGRATORS: dict[str, Callable] = {
    'rk4': kernels.rk4,
    'symplectic_euler': kernels.symplectic_euler,
}


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States of a body at equal steps of time, the first at time zero.

    Attributes:
        step: time between two states [s].
        configuration: q of each state [m].
        velocity: q̇ of each state [m/s].
    """

    step: float
    configuration: Float[np.ndarray, 'frames n']
    velocity: Float[np.ndarray, 'frames n']

    @property
    def time(self) -> Float[np.ndarray, ' frames']:
        """Time of each state [s]."""
        return self.step * np.arange(len(self.configuration))


class Integrator:
    """One fixed step of a body, by the method of that name.

    Args:
        mechanics: the body in its field of gravity.
        step: time step [s], > 0.
        method: a key of `INTEGRATORS`.

    Raises:
        ValueError: unknown method, or a step that is not positive.
    """

    def __init__(self, mechanics: Mechanics, step: float, method: str = 'rk4') -> None:
        if method not in INTEGRATORS:
            raise ValueError(f'unknown integrator {method!r}: choose one of {sorted(INTEGRATORS)}')
        if not (np.isfinite(step) and step > 0):
            raise ValueError(f'step: expected a time > 0 s, got {step}')
        self.mechanics = mechanics
        self.step = float(step)
        self.method = method
        self._kernel = INTEGRATORS[method]
        # New memory at each step costs time. Threads may share it: the kernels keep the GIL.
        self._work = kernels.workspace(mechanics.arrays)

    def advance(
        self,
        configuration: Float[np.ndarray, ' n'],
        velocity: Float[np.ndarray, ' n'],
        force: Float[np.ndarray, ' n'],
    ) -> tuple[Float[np.ndarray, ' n'], Float[np.ndarray, ' n']]:
        """Return (q, q̇) one step later, the external force [N] held over the step."""
        frames = np.empty((2, 2, len(configuration)))
        frames[:, 0] = configuration, velocity
        self.fill(frames[0], frames[1], force)
        return frames[0, 1], frames[1, 1]

    def fill(
        self,
        configurations: Float[np.ndarray, 'frames n'],
        velocities: Float[np.ndarray, 'frames n'],
        force: Float[np.ndarray, ' n'],
    ) -> None:
        """Fill the states from the second on, each a step after the one before it.

        Args:
            configurations: q of each state, the first one given [m].
            velocities: q̇ of each state, the first one given [m/s].
            force: external force, held over all steps [N].

        Raises:
            ValueError: their shapes do not fit each other and the body.
        """
        n = self.mechanics.network.configuration_size
        fits = configurations.shape == velocities.shape == (len(configurations), n)
        if not fits or force.shape != (n,):
            raise ValueError(
                f'expected states (frames, {n}) and a force of {n}, got {configurations.shape}, '
                f'{velocities.shape} and {force.shape}'
            )
        self._kernel(
            self.mechanics.arrays,
            self.mechanics.gravity_vector,
            force,
            self.step,
            self._work,
            configurations,
            velocities,
        )


def simulate(
    integrator: Integrator,
    configuration: Float[np.ndarray, ' n'],
    velocity: Float[np.ndarray, ' n'],
    steps: int,
    force: Float[np.ndarray, ' n'] | None = None,
) -> Trajectory:
    """Integrate a body over a number of steps under a constant external force.

    Args:
        integrator: the body and its method.
        configuration: q at time zero [m].
        velocity: q̇ at time zero [m/s].
        steps: number of steps; the trajectory holds one state more.
        force: external force [N], zero where left out.
    """
    if force is None:
        force = np.zeros_like(configuration)
    configurations = np.empty((steps + 1, len(configuration)))
    velocities = np.empty_like(configurations)
    configurations[0], velocities[0] = configuration, velocity
    integrator.fill(configurations, velocities, force)
    return Trajectory(integrator.step, configurations, velocities)
