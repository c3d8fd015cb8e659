"""One step of the paper's system 2: ours beside MuJoCo and beside numpy with scipy.sparse.

Everyone has the same body, of axial damping and k_s = 0, which MuJoCo's tendons can be, without
contacts and constraints. One step is a call by itself, `…_of_many` is one of many in a call.
"""

import mujoco
import numpy as np
from body_peers import GRAVITY, STEP, mujoco_second, stable_integrators, system_2
from mujoco_body import mujoco_model
from side_by_side import row, side_by_side
from sparse_body import SparseBody

from dpc_ros.network import Integrator, Mechanics, simulate

REPETITIONS = 30
CALLS = 20  # at a stretch
GOAL = 100.0  # times as fast
AGREEMENT = 1e-9  # m, after a second of the same method


def measure():
    """Return a row for each peer."""
    network = system_2()
    integrator = Integrator(Mechanics(network, GRAVITY), STEP)
    rest, still = network.rest_configuration, np.zeros(network.configuration_size)
    _check_agreement(integrator, rest, still)
    middle = simulate(integrator, rest, still, CALLS)  # strained and moving
    q, velocity = middle.configuration[-1], middle.velocity[-1]

    def ours():
        return integrator.advance(q, velocity, still)

    def ours_of_many():
        return simulate(integrator, q, velocity, CALLS)

    rows = []
    for name in dict.fromkeys(['RK4', *stable_integrators(network, STEP)[:1]]):
        model = mujoco_model(network, GRAVITY, STEP, name)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = q, velocity
        peer = f'MuJoCo {name}'

        def step(model=model, data=data):
            mujoco.mj_step(model, data)

        def steps(model=model, data=data):
            mujoco.mj_step(model, data, nstep=CALLS)

        rows.append(row(f'body_step_{name}', peer, *side_by_side(ours, step, REPETITIONS, CALLS)))
        medians = side_by_side(ours_of_many, steps, REPETITIONS)
        medians = [each / CALLS for each in medians]
        goal = GOAL if name == 'RK4' else None
        rows.append(row(f'body_step_of_many_{name}', peer, *medians, goal=goal))
    sparse, state = SparseBody(network, GRAVITY), np.concatenate([q, velocity])
    np.testing.assert_allclose(sparse.rk4_step(state, STEP), np.concatenate(ours()), atol=AGREEMENT)
    medians = side_by_side(ours, lambda: sparse.rk4_step(state, STEP), REPETITIONS, CALLS)
    rows.append(row('body_step_sparse', 'numpy and scipy.sparse', *medians))
    return rows


def _check_agreement(integrator, q, velocity):
    ours = simulate(integrator, q, velocity, round(1.0 / STEP)).configuration[-1]
    peer = mujoco_second(integrator.mechanics.network, STEP, 'RK4')()
    np.testing.assert_allclose(ours, peer, atol=AGREEMENT)
