"""Integration of many trajectories of one network at once."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Float

from dpc_ros.network import lanes
from dpc_ros.network.integration import Integrator, Trajectory, simulate

LANES = 32  # side by side at most: what fills the vector instructions and fits into the cache
_FEWEST_LANES = 4  # fewer are no faster than one by one


def simulate_many(
    integrators: Sequence[Integrator],
    configurations: Float[np.ndarray, 'many n'],
    velocities: Float[np.ndarray, 'many n'],
    steps: int,
    forces: Float[np.ndarray, 'many n'] | None = None,
    threads: int = 1,
) -> list[Trajectory]:
    """Integrate one body from many starts: the same bits as `simulate` for each, but faster.

    Args:
        integrators: one for each trajectory, of one network, step and method: each has its gravity.
        configurations: q of each at time zero [m].
        velocities: q̇ of each at time zero [m/s].
        steps: number of steps; a trajectory holds one state more.
        forces: external force on each over all steps [N], zero where left out.
        threads: how many cores to use.

    Returns:
        one trajectory each; those that were side by side share memory.

    Raises:
        ValueError: the integrators differ in more than gravity, or the counts do not fit.
    """
    if not len(integrators) == len(configurations) == len(velocities):
        raise ValueError(
            f'expected as many integrators as starts, got {len(integrators)}, '
            f'{len(configurations)} configurations and {len(velocities)} velocities'
        )
    kinds = {(each.mechanics.network.digest, each.step, each.method) for each in integrators}
    if len(kinds) > 1:
        raise ValueError(
            f'integrators: expected one network, step and method, got {len(kinds)} different ones'
        )
    if forces is None:
        forces = np.zeros_like(configurations)
    count = len(integrators)
    if count:
        n = integrators[0].mechanics.network.configuration_size
        shapes = {np.shape(each) for each in (configurations, velocities, forces)}
        if shapes != {(count, n)}:
            raise ValueError(f'expected states and forces of the shape {(count, n)}, got {shapes}')
    # As many as fill the lanes, or as many as there are threads, unless they would be few.
    parts = max(1, -(-count // LANES), min(threads, count // _FEWEST_LANES))

    def run(part: np.ndarray) -> list[Trajectory]:
        own = [integrators[i] for i in part]
        return _simulate_part(own, configurations[part], velocities[part], steps, forces[part])

    chosen = np.array_split(np.arange(count), parts) if count else []
    with ThreadPoolExecutor(threads) as executor:
        return [trajectory for done in executor.map(run, chosen) for trajectory in done]


def _simulate_part(
    integrators: list[Integrator],
    configurations: np.ndarray,
    velocities: np.ndarray,
    steps: int,
    forces: np.ndarray,
) -> list[Trajectory]:
    if len(integrators) < _FEWEST_LANES:
        starts = zip(integrators, configurations, velocities, forces, strict=True)
        return [simulate(each, q, velocity, steps, force) for each, q, velocity, force in starts]
    first = integrators[0]
    network = first.mechanics.arrays
    gravity = np.array([each.mechanics.gravity_vector for each in integrators])
    frames = np.empty((2, len(integrators), steps + 1, configurations.shape[1]))
    frames[:, :, 0] = configurations, velocities
    start = lanes.make_lanes(network, configurations, velocities, forces, gravity)
    lanes.integrate(
        network, start, first.step, first.method == 'rk4', frames[0, :, 1:], frames[1, :, 1:]
    )
    return [Trajectory(first.step, q, velocity) for q, velocity in zip(*frames, strict=True)]
