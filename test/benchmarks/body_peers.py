"""The body that benchmarks and their peers share, and a second of it by each of them."""

from dataclasses import replace

import mujoco
import numpy as np
from mujoco_body import mujoco_model
from scipy.integrate import solve_ivp
from side_by_side import shortest

from dpc_ros.network import Gravity, Integrator, Mechanics, load_network, simulate

GRAVITY = Gravity(9.81)
STEP = 0.005  # s, the paper's
SECOND = 1.0  # s
STABLE = 1.0  # m of error after a second; what is unstable has moved far off, or is not finite
INTEGRATORS = ('RK4', 'Euler', 'implicit', 'implicitfast')  # MuJoCo's

mujoco.set_mju_user_warning(lambda _: None)  # that a step is too long shows in the numbers


def system_2():
    """Return the paper's system 2 with what MuJoCo can be: axial damping, k_s = 0."""
    return replace(load_network('paper_2'), damping_kind='axial', background_stiffness=0.0)


def our_second(network, step, method):
    """Return a function that simulates a second from rest and returns q at its end."""
    integrator = Integrator(Mechanics(network, GRAVITY), step, method)
    rest, still = network.rest_configuration, np.zeros(network.configuration_size)
    return lambda: simulate(integrator, rest, still, round(SECOND / step)).configuration[-1]


def mujoco_second(network, step, integrator):
    """Return the same of MuJoCo."""
    model = mujoco_model(network, GRAVITY, step, integrator)
    data = mujoco.MjData(model)

    def run():
        mujoco.mj_resetData(model, data)
        mujoco.mj_step(model, data, nstep=round(SECOND / step))
        return data.qpos.copy()

    return run


def scipy_second(body, network, method, tolerance):
    """Return the same of scipy's integrators, whose step follows the tolerance."""
    rest = network.rest_configuration
    start = np.concatenate([rest, np.zeros_like(rest)])

    def run():
        found = solve_ivp(
            body.slope, (0.0, SECOND), start, method, [SECOND], rtol=tolerance, atol=tolerance
        )
        return found.y[: len(rest), -1]

    return run


def stable_integrators(network, step):
    """Return the names of MuJoCo's that are stable at a step, the fastest first."""
    expected = our_second(network, step, 'rk4')()
    times = {}
    for name in INTEGRATORS:
        run = mujoco_second(network, step, name)
        if np.abs(run() - expected).max() < STABLE:
            times[name] = shortest(run)
    return sorted(times, key=times.get)
