"""Time per mass of a force evaluation and of a step, from 200 to 20,000 masses.

The bodies are square grids that hang from their upper side. The peer of each is the smallest: a
ratio of one says that the time is proportional to the number of masses.
"""

import statistics
import time

import numpy as np
from numba import njit
from side_by_side import row

from dpc_ros.network import Gravity, Integrator, MassSpringNetwork, Mechanics, simulate
from dpc_ros.network.kernels import accelerate, workspace

SIDES = (14, 45, 141)  # masses
SPACING = 0.3  # m
STEP = 0.005  # s
STRAIN = 0.01  # m
REPETITIONS = 15
GOAL = 1 / 1.3  # flat within this
MASSES = 40000  # in all the evaluations of a stretch


def grid(side):
    """Return a square grid with both diagonals in each cell, with the paper's springs."""
    number = np.arange(side * side).reshape(side, side)
    ends = (
        (number[:, :-1], number[:, 1:]),
        (number[:-1], number[1:]),
        (number[:-1, :-1], number[1:, 1:]),
        (number[:-1, 1:], number[1:, :-1]),
    )
    springs = np.concatenate([np.column_stack([a.ravel(), b.ravel()]) for a, b in ends])
    rest = SPACING * np.column_stack([number.ravel() % side, -(number.ravel() // side)])
    length = np.linalg.norm(rest[springs[:, 0]] - rest[springs[:, 1]], axis=1)
    return MassSpringNetwork(
        name='grid',
        mass=np.full(side * side, 1 / 205),
        fixed=number[0],
        rest_position=rest,
        springs=springs,
        stiffness=np.full(len(springs), 50.0),
        rest_length=length,
        damping=np.full(len(springs), 0.1),
        background_stiffness=0.2,
        background_rest_fraction=1 / 205,
    )


@njit
def evaluate(network, gravity, state, work, result, count):
    """Evaluate the forces some times in a row."""
    q, velocity, force = state
    for _ in range(count):
        accelerate(network, gravity, q, velocity, force, work, result)


def measure():
    """Return two rows for each body."""
    bodies = [_functions(grid(side)) for side in SIDES]
    rows = []
    for which, name in enumerate(('force', 'step')):
        times = [[] for _ in bodies]
        for repetition in range(1 + REPETITIONS):  # in turns
            for seconds, (network, *functions) in zip(times, bodies, strict=True):
                begin = time.perf_counter()
                calls = functions[which]()
                seconds.append((time.perf_counter() - begin) / calls / len(network.mass))
                if repetition == 0:
                    seconds.clear()  # to warm up
        medians = [statistics.median(seconds) for seconds in times]
        for (network, *_), median in zip(bodies, medians, strict=True):
            masses = len(network.mass)
            peer = f'{len(bodies[0][0].mass)} masses, for each'
            size = {'masses': masses, 'springs': len(network.springs)}
            measured = row(f'body_{name}_{masses}_masses', peer, median, medians[0], goal=GOAL)
            rows.append(measured | size)
    return rows


def _functions(network):
    """Return the network, and a function for each measurement: it returns how often it did it."""
    mechanics = Mechanics(network, Gravity(9.81))
    integrator = Integrator(mechanics, STEP)
    count = max(1, MASSES // len(network.mass))
    n = network.configuration_size
    strain = np.random.default_rng(0).normal(scale=STRAIN, size=n)
    q, velocity, force = network.rest_configuration + strain, np.zeros(n), np.zeros(n)
    work, result = workspace(mechanics.arrays), np.empty(n)

    def forces():
        state = q, velocity, force
        evaluate(mechanics.arrays, mechanics.gravity_vector, state, work, result, count)
        return count

    def steps():
        simulate(integrator, q, velocity, count, force)
        return count

    return network, forces, steps
