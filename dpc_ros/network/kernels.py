"""Compiled loops over springs and masses.

Positions stand in one array of all masses with the mobile ones first, so that its head *is* the
configuration. Every kernel is pure float64 without reassociation: the same input gives the same
bits in every process of one machine.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

CHUNK = 256  # springs whose part of a workspace stays in the nearest cache


class NetworkArrays(NamedTuple):
    """What the kernels need of a network; masses renumbered, mobile first."""

    first: np.ndarray  # (springs,) int64, mass at one end
    second: np.ndarray  # (springs,) int64, mass at the other end
    stiffness: np.ndarray  # (springs,) [N/m]
    rest_length: np.ndarray  # (springs,) [m]
    damping: np.ndarray  # (springs,) [N s/m]
    background_vector: np.ndarray  # (2, springs) c d⁰ [m]
    background_stiffness: float  # k_s [N/m]
    mobile_mass: np.ndarray  # (mobile,) [kg]
    fixed_position: np.ndarray  # (fixed, 2) [m]
    axial: bool  # dampers resist only the change of their spring's length


@njit(cache=True)
def place(network, configuration):
    """Return the positions of all masses, (masses, 2), for a configuration (n,)."""
    mobile = network.mobile_mass.shape[0]
    fixed = network.fixed_position.shape[0]
    position = np.empty((mobile + fixed, 2))
    for i in range(mobile):
        position[i, 0] = configuration[2 * i]
        position[i, 1] = configuration[2 * i + 1]
    for i in range(fixed):
        position[mobile + i, 0] = network.fixed_position[i, 0]
        position[mobile + i, 1] = network.fixed_position[i, 1]
    return position


@njit(cache=True)
def elastic_energy(network, configuration):
    """Σ ½k(|d| − l)² + ½k_s Σ |d − c d⁰|² [J]."""
    position = place(network, configuration)
    energy = 0.0
    for j in range(network.first.shape[0]):
        a, b = network.first[j], network.second[j]
        dx = position[a, 0] - position[b, 0]
        dy = position[a, 1] - position[b, 1]
        stretch = np.sqrt(dx * dx + dy * dy) - network.rest_length[j]
        bx = dx - network.background_vector[0, j]
        by = dy - network.background_vector[1, j]
        energy += 0.5 * network.stiffness[j] * stretch * stretch
        energy += 0.5 * network.background_stiffness * (bx * bx + by * by)
    return energy


@njit(cache=True)
def gravitational_energy(network, gravity, configuration):
    """−Σ m g·x over the mobile masses [J]."""
    energy = 0.0
    for i in range(network.mobile_mass.shape[0]):
        work = gravity[0] * configuration[2 * i] + gravity[1] * configuration[2 * i + 1]
        energy -= network.mobile_mass[i] * work
    return energy


@njit(cache=True)
def kinetic_energy(network, velocity):
    """½ q̇ᵀMq̇ [J]."""
    energy = 0.0
    for i in range(network.mobile_mass.shape[0]):
        square = velocity[2 * i] * velocity[2 * i] + velocity[2 * i + 1] * velocity[2 * i + 1]
        energy += 0.5 * network.mobile_mass[i] * square
    return energy


@njit(cache=True)
def potential_gradient(network, gravity, configuration):
    """∇V(q), (n,) [N]."""
    position = place(network, configuration)
    mobile = network.mobile_mass.shape[0]
    gradient = np.empty(2 * mobile)
    for i in range(mobile):
        gradient[2 * i] = -network.mobile_mass[i] * gravity[0]
        gradient[2 * i + 1] = -network.mobile_mass[i] * gravity[1]
    for j in range(network.first.shape[0]):
        a, b = network.first[j], network.second[j]
        dx = position[a, 0] - position[b, 0]
        dy = position[a, 1] - position[b, 1]
        fx, fy = _spring_gradient(network, j, dx, dy)
        if a < mobile:
            gradient[2 * a] += fx
            gradient[2 * a + 1] += fy
        if b < mobile:
            gradient[2 * b] -= fx
            gradient[2 * b + 1] -= fy
    return gradient


@njit(cache=True, inline='always')
def _spring_gradient(network, j, dx, dy):
    length = np.sqrt(dx * dx + dy * dy)
    pull = 0.0
    if length > 0.0:
        pull = network.stiffness[j] * (1.0 - network.rest_length[j] / length)
    fx = pull * dx + network.background_stiffness * (dx - network.background_vector[0, j])
    fy = pull * dy + network.background_stiffness * (dy - network.background_vector[1, j])
    return fx, fy


@njit(cache=True)
def potential_hessian(network, configuration):
    """∇²V(q), (n, n) dense [N/m]."""
    position = place(network, configuration)
    mobile = network.mobile_mass.shape[0]
    hessian = np.zeros((2 * mobile, 2 * mobile))
    block = np.empty((2, 2))
    for j in range(network.first.shape[0]):
        a, b = network.first[j], network.second[j]
        dx = position[a, 0] - position[b, 0]
        dy = position[a, 1] - position[b, 1]
        length = np.sqrt(dx * dx + dy * dy)
        along = 0.0
        across = network.stiffness[j]
        if length > 0.0:
            across = network.stiffness[j] * (1.0 - network.rest_length[j] / length)
            along = network.stiffness[j] * network.rest_length[j] / (length * length * length)
        diagonal = across + network.background_stiffness
        block[0, 0] = diagonal + along * dx * dx
        block[0, 1] = along * dx * dy
        block[1, 0] = block[0, 1]
        block[1, 1] = diagonal + along * dy * dy
        for r in range(2):
            for c in range(2):
                if a < mobile:
                    hessian[2 * a + r, 2 * a + c] += block[r, c]
                if b < mobile:
                    hessian[2 * b + r, 2 * b + c] += block[r, c]
                if a < mobile and b < mobile:
                    hessian[2 * a + r, 2 * b + c] -= block[r, c]
                    hessian[2 * b + r, 2 * a + c] -= block[r, c]
    return hessian


@njit(cache=True)
def damping_force(network, configuration, velocity):
    """C(q) q̇, (n,) [N]."""
    position = place(network, configuration)
    mobile = network.mobile_mass.shape[0]
    force = np.zeros(2 * mobile)
    for j in range(network.first.shape[0]):
        a, b = network.first[j], network.second[j]
        dx = position[a, 0] - position[b, 0]
        dy = position[a, 1] - position[b, 1]
        wx, wy = _relative_velocity(velocity, mobile, a, b)
        fx, fy = _damper_force(network, j, dx, dy, wx, wy)
        if a < mobile:
            force[2 * a] += fx
            force[2 * a + 1] += fy
        if b < mobile:
            force[2 * b] -= fx
            force[2 * b + 1] -= fy
    return force


@njit(cache=True, inline='always')
def _relative_velocity(velocity, mobile, a, b):
    wx = 0.0
    wy = 0.0
    if a < mobile:
        wx += velocity[2 * a]
        wy += velocity[2 * a + 1]
    if b < mobile:
        wx -= velocity[2 * b]
        wy -= velocity[2 * b + 1]
    return wx, wy


@njit(cache=True, inline='always')
def _damper_force(network, j, dx, dy, wx, wy):
    """Return d w, or d n nᵀw of an axial damper; a spring of no length has no direction n."""
    fx = network.damping[j] * wx
    fy = network.damping[j] * wy
    if network.axial:
        square = dx * dx + dy * dy
        along = 0.0
        if square > 0.0:
            along = (dx * fx + dy * fy) / square
        fx = along * dx
        fy = along * dy
    return fx, fy


@njit(cache=True)
def damping_matrix(network, configuration):
    """C(q), (n, n) dense [N s/m]."""
    position = place(network, configuration)
    mobile = network.mobile_mass.shape[0]
    matrix = np.zeros((2 * mobile, 2 * mobile))
    block = np.empty((2, 2))
    for j in range(network.first.shape[0]):
        a, b = network.first[j], network.second[j]
        dx = position[a, 0] - position[b, 0]
        dy = position[a, 1] - position[b, 1]
        block[0, 0], block[0, 1] = _damper_force(network, j, dx, dy, 1.0, 0.0)
        block[1, 0], block[1, 1] = _damper_force(network, j, dx, dy, 0.0, 1.0)
        block[1, 0] = block[0, 1]  # equal but for rounding
        for r in range(2):
            for c in range(2):
                if a < mobile:
                    matrix[2 * a + r, 2 * a + c] += block[r, c]
                if b < mobile:
                    matrix[2 * b + r, 2 * b + c] += block[r, c]
                if a < mobile and b < mobile:
                    matrix[2 * a + r, 2 * b + c] -= block[r, c]
                    matrix[2 * b + r, 2 * a + c] -= block[r, c]
    return matrix


class Workspace(NamedTuple):
    """What evaluations of the acceleration and steps fill; made once for many."""

    state: np.ndarray  # (masses, 4), place [m] and velocity [m/s] of each
    force: np.ndarray  # (masses, 2) [N]
    ends: np.ndarray  # (4, chunk), d of some springs [m] and its rate [m/s]
    force_density: np.ndarray  # (chunk,) force by length [N/m]
    pull: np.ndarray  # (2, chunk), force of each on its second end [N]
    stages: np.ndarray  # (5, n), of a step: q, q̇ and q̈ of a stage, sums of q̇ and q̈ over all


@njit(cache=True)
def workspace(network):
    """Return a workspace for a network."""
    mobile = network.mobile_mass.shape[0]
    masses = mobile + network.fixed_position.shape[0]
    state = np.zeros((masses, 4))
    state[mobile:, :2] = network.fixed_position
    return Workspace(
        state,
        np.zeros((masses, 2)),
        np.empty((4, CHUNK)),
        np.empty(CHUNK),
        np.empty((2, CHUNK)),
        np.empty((5, 2 * mobile)),
    )


@njit(cache=True, error_model='numpy')
def accelerate(network, gravity, configuration, velocity, force, work, result):
    """Fill `result` (n,) with q̈ = M⁻¹(−∇V(q) − C(q) q̇ + f) [m/s²]; f is the force (n,) [N].

    What goes by spring is gathered first, so that the arithmetic runs over whole arrays: of a chunk
    of springs at a time, which the nearest cache holds.
    """
    mobile = network.mobile_mass.shape[0]
    for i in range(mobile):
        for axis in range(2):
            work.state[i, axis] = configuration[2 * i + axis]
            work.state[i, 2 + axis] = velocity[2 * i + axis]
            work.force[i, axis] = force[2 * i + axis]
    springs = network.first.shape[0]
    for begin in range(0, springs, CHUNK):
        # Unsigned, so that no index has to be looked at for counting from the end.
        start, count = np.uintp(begin), np.uintp(min(CHUNK, springs - begin))
        for j in range(count):
            a, b = np.uintp(network.first[start + j]), np.uintp(network.second[start + j])
            for part in range(4):
                work.ends[part, j] = work.state[a, part] - work.state[b, part]
        _pull(network, start, count, work)
        for j in range(count):
            a, b = np.uintp(network.first[start + j]), np.uintp(network.second[start + j])
            for axis in range(2):
                work.force[a, axis] -= work.pull[axis, j]
                work.force[b, axis] += work.pull[axis, j]
    for i in range(mobile):
        mass = network.mobile_mass[i]
        result[2 * i] = work.force[i, 0] / mass + gravity[0]
        result[2 * i + 1] = work.force[i, 1] / mass + gravity[1]


@njit(cache=True, error_model='numpy')
def _pull(network, start, count, work):
    """Fill `work.pull` with the force of each spring of a chunk [N], from d and its rate.

    Each loop reads and writes few arrays, or the compiler would not run it in parallel lanes.
    """
    d, rate = work.ends[:2], work.ends[2:]
    force_density, pull = work.force_density, work.pull
    for j in range(count):
        square = d[0, j] * d[0, j] + d[1, j] * d[1, j]
        inverse = 1.0 / np.sqrt(square)
        inverse = inverse if square > 0.0 else 0.0
        density = network.stiffness[start + j] * (1.0 - network.rest_length[start + j] * inverse)
        if network.axial:
            along = d[0, j] * rate[0, j] + d[1, j] * rate[1, j]
            density += network.damping[start + j] * along * (inverse * inverse)
        force_density[j] = density
    for axis in range(2):
        for j in range(count):
            moved = d[axis, j] - network.background_vector[axis, start + j]
            pull[axis, j] = force_density[j] * d[axis, j] + network.background_stiffness * moved
    if not network.axial:
        for axis in range(2):
            for j in range(count):
                pull[axis, j] += network.damping[start + j] * rate[axis, j]


@njit(cache=True)
def acceleration(network, gravity, configuration, velocity, force):
    """q̈ = M⁻¹(−∇V(q) − C(q) q̇ + f), (n,) [m/s²], with f the external force (n,) [N]."""
    result = np.empty_like(configuration)
    accelerate(network, gravity, configuration, velocity, force, workspace(network), result)
    return result


@njit(cache=True)
def rk4(network, gravity, force, step, work, configurations, velocities):
    """Fill the states (frames, n) from the second on: classical Runge–Kutta steps of order four.

    The force (n,) [N] is held over all of them.
    """
    half = 0.5 * step
    sixth = step / 6.0
    n = configurations.shape[1]
    q, v, a = work.stages[0], work.stages[1], work.stages[2]
    slope, rise = work.stages[3], work.stages[4]
    for k in range(configurations.shape[0] - 1):
        configuration, velocity = configurations[k], velocities[k]
        accelerate(network, gravity, configuration, velocity, force, work, a)
        for i in range(n):
            slope[i], rise[i] = velocity[i], a[i]
            q[i], v[i] = configuration[i] + half * velocity[i], velocity[i] + half * a[i]
        for length in (half, step):
            accelerate(network, gravity, q, v, force, work, a)
            for i in range(n):
                slope[i] += 2.0 * v[i]
                rise[i] += 2.0 * a[i]
                q[i] = configuration[i] + length * v[i]
                v[i] = velocity[i] + length * a[i]
        accelerate(network, gravity, q, v, force, work, a)
        for i in range(n):
            configurations[k + 1, i] = configuration[i] + sixth * (slope[i] + v[i])
            velocities[k + 1, i] = velocity[i] + sixth * (rise[i] + a[i])


@njit(cache=True)
def symplectic_euler(network, gravity, force, step, work, configurations, velocities):
    """Fill the states (frames, n) from the second on: symplectic Euler steps of order one.

    Velocity first, then position with the new velocity; the force (n,) [N] is held over all steps.
    """
    rise = work.stages[2]
    for k in range(configurations.shape[0] - 1):
        accelerate(network, gravity, configurations[k], velocities[k], force, work, rise)
        for i in range(configurations.shape[1]):
            velocities[k + 1, i] = velocities[k, i] + step * rise[i]
            configurations[k + 1, i] = configurations[k, i] + step * velocities[k + 1, i]
