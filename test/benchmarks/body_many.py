"""Many simulations of the paper's system 2, side by side on one core and two.

The peers are one by one, and MuJoCo's own way of many, `mujoco.rollout` with as many threads. That
is on the body that MuJoCo can be.
"""

import mujoco
import numpy as np
from body_peers import GRAVITY, system_2
from mujoco import rollout
from mujoco_body import mujoco_model
from side_by_side import row, side_by_side

from dpc_ros.network import Gravity, Integrator, Mechanics, load_network, simulate, simulate_many

TRAJECTORIES = 32
STEPS = 200
STEP = 0.005  # s
REPETITIONS = 7
CORES = (1, 2)
STEPS_BESIDE_MUJOCO = 50
GOAL_BESIDE_MUJOCO = 100.0  # times as fast
AGREEMENT = 1e-9  # m


def measure():
    """Return the rows for each number of cores; times are of one trajectory, or of a step of it."""
    return [*_beside_one_by_one(), *(_beside_mujoco(cores) for cores in CORES)]


def _beside_one_by_one():
    network = load_network('paper_2')
    draw = np.random.default_rng(0)
    integrators = [
        Integrator(Mechanics(network, Gravity(strength)), STEP)
        for strength in draw.uniform(3.0, 17.0, TRAJECTORIES)
    ]
    q = np.tile(network.rest_configuration, (TRAJECTORIES, 1))
    velocity = np.zeros_like(q)

    def one_by_one():
        starts = zip(integrators, q, velocity, strict=True)
        return [simulate(*start, STEPS) for start in starts]

    rows = []
    for cores in CORES:

        def beside(cores=cores):
            return simulate_many(integrators, q, velocity, STEPS, threads=cores)

        for found, expected in zip(beside(), one_by_one(), strict=True):
            np.testing.assert_array_equal(found.configuration, expected.configuration)
        medians = [
            median / TRAJECTORIES for median in side_by_side(beside, one_by_one, REPETITIONS)
        ]
        rates = {
            'trajectories_per_s': 1.0 / medians[0],
            'one_by_one_per_s': 1.0 / medians[1],
            'force_evaluation_s': medians[0] / (4 * STEPS),
        }
        rows.append(row(f'body_many_{cores}_cores', 'one by one', *medians) | rates)
    return rows


def _beside_mujoco(cores):
    """Return a row of one step of one trajectory."""
    network = system_2()
    integrators = [Integrator(Mechanics(network, GRAVITY), STEP)] * TRAJECTORIES
    q = np.tile(network.rest_configuration, (TRAJECTORIES, 1))
    velocity = np.random.default_rng(0).normal(scale=0.1, size=q.shape)
    model = mujoco_model(network, GRAVITY, STEP, 'RK4')
    threads = [mujoco.MjData(model) for _ in range(cores)]
    start = np.hstack([np.zeros((TRAJECTORIES, 1)), q, velocity])  # time, q, q̇

    def ours():
        return simulate_many(integrators, q, velocity, STEPS_BESIDE_MUJOCO, threads=cores)

    def peer():
        return rollout.rollout(model, threads, start, nstep=STEPS_BESIDE_MUJOCO)[0]

    expected = peer()[:, -1, 1 : 1 + q.shape[1]]
    found = [each.configuration[-1] for each in ours()]
    np.testing.assert_allclose(found, expected, atol=AGREEMENT)
    steps = TRAJECTORIES * STEPS_BESIDE_MUJOCO
    medians = [each / steps for each in side_by_side(ours, peer, REPETITIONS)]
    return row(
        f'body_step_of_many_trajectories_{cores}_cores',
        'MuJoCo RK4, mujoco.rollout',
        *medians,
        goal=GOAL_BESIDE_MUJOCO,
    )
