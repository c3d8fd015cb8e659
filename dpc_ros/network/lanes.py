"""Compiled integration of many trajectories of one network, side by side in SIMD lanes.

The trajectories are the last, contiguous index of every array, so that loops over them become
vector instructions. A lane does the arithmetic of the kernels of one trajectory in the same order:
it gives the same bits.
"""

import numpy as np
from numba import njit


def make_lanes(network, configuration, velocity, force, gravity):
    """Return the arguments of `integrate` that hold the start of each trajectory.

    Both coordinates of a mass make one row, (x of every lane, y of every lane).

    Args:
        network: `NetworkArrays`.
        configuration: (lanes, n) [m].
        velocity: (lanes, n) [m/s].
        force: external, held over all steps, (lanes, n) [N].
        gravity: (lanes, 2) [m/s²].
    """
    lanes, n = configuration.shape
    fixed = np.repeat(network.fixed_position.ravel(), lanes)
    mobile, masses = (n // 2, 2 * lanes), (-1, 2 * lanes)
    return (
        np.concatenate([configuration.T.ravel(), fixed]).reshape(masses),
        np.concatenate([velocity.T.ravel(), np.zeros_like(fixed)]).reshape(masses),
        np.ascontiguousarray(force.T).reshape(mobile),
        np.ascontiguousarray(gravity.T).ravel(),
    )


@njit(cache=True, nogil=True)
def integrate(network, lanes, step, runge_kutta, configurations, velocities):
    """Move the lanes on and write each of their next frames.

    Args:
        network: `NetworkArrays`.
        lanes: as `make_lanes` returns them; the state moves on.
        step: time between two frames [s].
        runge_kutta: take classical steps of order four, else those of symplectic Euler.
        configurations: (lanes, frames, n) [m].
        velocities: the same [m/s].
    """
    position, velocity, held, field = lanes
    count, frames, n = configurations.shape
    force, pull = np.zeros(position.shape), np.empty(2 * count)
    size = n * count  # of what moves
    scratch = np.empty((4, size))
    q, v = position.reshape(-1)[:size], velocity.reshape(-1)[:size]
    a, f = force.reshape(-1)[:size], held.reshape(-1)
    for frame in range(frames):
        for stage in range(4 if runge_kutta else 1):
            for i in range(size):
                a[i] = f[i]
            _add_springs(network, position, velocity, force, pull)
            _divide_by_mass(network, field, force)
            if runge_kutta:
                _runge_kutta(stage, step, q, v, a, scratch)
            else:
                _symplectic_euler(step, q, v, a)
        for i in range(n):
            for lane in range(count):
                configurations[lane, frame, i] = q[i * count + lane]
                velocities[lane, frame, i] = v[i * count + lane]


@njit(cache=True, error_model='numpy', nogil=True)
def _add_springs(network, position, velocity, force, pull):
    """Add what springs and dampers pull with to the force of each mass [N].

    Each loop reads and writes few arrays, or the compiler would not run it in parallel lanes.
    """
    # Unsigned, so that no index has to be looked at for counting from the end.
    both = np.uintp(pull.shape[0])
    lanes = both // np.uintp(2)
    background = network.background_stiffness
    for j in range(network.first.shape[0]):
        first, second = np.uintp(network.first[j]), np.uintp(network.second[j])
        stiffness, rest_length = network.stiffness[j], network.rest_length[j]
        damping = network.damping[j]
        x, y = network.background_vector[0, j], network.background_vector[1, j]
        for i in range(lanes):
            dx = position[first, i] - position[second, i]
            dy = position[first, lanes + i] - position[second, lanes + i]
            square = dx * dx + dy * dy
            inverse = 1.0 / np.sqrt(square)
            inverse = inverse if square > 0.0 else 0.0
            density = stiffness * (1.0 - rest_length * inverse)
            if network.axial:
                wx = velocity[first, i] - velocity[second, i]
                wy = velocity[first, lanes + i] - velocity[second, lanes + i]
                density += damping * (dx * wx + dy * wy) * (inverse * inverse)
            pull[i] = density * dx + background * (dx - x)
            pull[lanes + i] = density * dy + background * (dy - y)
        if not network.axial:
            for i in range(both):
                pull[i] += damping * (velocity[first, i] - velocity[second, i])
        for i in range(both):
            force[first, i] -= pull[i]
        for i in range(both):
            force[second, i] += pull[i]


@njit(cache=True, error_model='numpy', nogil=True)
def _divide_by_mass(network, field, force):
    """Turn the forces on the mobile masses [N] into their accelerations [m/s²]."""
    for mass in range(np.uintp(network.mobile_mass.shape[0])):
        weight = network.mobile_mass[mass]
        for i in range(np.uintp(field.shape[0])):
            force[mass, i] = force[mass, i] / weight + field[i]


@njit(cache=True, error_model='numpy', nogil=True)
def _runge_kutta(stage, step, q, v, a, scratch):
    """Move q and q̇ on from the start of a step to its next stage, or from the fourth to its end."""
    q0, v0, slope, rise = scratch[0], scratch[1], scratch[2], scratch[3]
    if stage == 3:
        sixth = step / 6.0
        for i in range(a.shape[0]):
            q[i] = q0[i] + sixth * (slope[i] + v[i])
        for i in range(a.shape[0]):
            v[i] = v0[i] + sixth * (rise[i] + a[i])
        return
    if stage == 0:
        for i in range(a.shape[0]):
            q0[i], v0[i] = q[i], v[i]
        for i in range(a.shape[0]):
            slope[i], rise[i] = v[i], a[i]
    else:
        for i in range(a.shape[0]):
            slope[i] += 2.0 * v[i]
        for i in range(a.shape[0]):
            rise[i] += 2.0 * a[i]
    length = step if stage == 2 else 0.5 * step
    for i in range(a.shape[0]):
        q[i] = q0[i] + length * v[i]
    for i in range(a.shape[0]):
        v[i] = v0[i] + length * a[i]


@njit(cache=True, error_model='numpy', nogil=True)
def _symplectic_euler(step, q, v, a):
    """Move q and q̇ on by a step."""
    for i in range(a.shape[0]):
        v[i] = v[i] + step * a[i]
    for i in range(a.shape[0]):
        q[i] = q[i] + step * v[i]
