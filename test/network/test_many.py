"""Trajectories side by side are, bit for bit, those that come one by one."""

from dataclasses import replace

import numpy as np
import pytest

from dpc_ros.network import (
    DAMPING_KINDS,
    INTEGRATORS,
    Gravity,
    Integrator,
    Mechanics,
    simulate,
    simulate_many,
)
from dpc_ros.network.many import LANES

STEP = 0.005  # s
STEPS = 20


def starts(network, random_state, count, method='rk4'):
    """Return integrators, configurations, velocities and forces, each its own."""
    integrators = [
        Integrator(Mechanics(network, Gravity(9.81, -1.0 - 0.1 * k)), STEP, method)
        for k in range(count)
    ]
    states = [random_state(k, network) for k in range(count)]
    configurations, velocities = (np.array(each) for each in zip(*states, strict=True))
    forces = np.random.default_rng(0).normal(scale=0.1, size=configurations.shape)
    return integrators, configurations, velocities, forces


def assert_as_one_by_one(trajectories, integrators, configurations, velocities, forces):
    assert len(trajectories) == len(integrators)
    for k, trajectory in enumerate(trajectories):
        alone = simulate(integrators[k], configurations[k], velocities[k], STEPS, forces[k])
        assert trajectory.step == alone.step
        np.testing.assert_array_equal(trajectory.configuration, alone.configuration)
        np.testing.assert_array_equal(trajectory.velocity, alone.velocity)


@pytest.mark.parametrize('method', INTEGRATORS)
@pytest.mark.parametrize('damping_kind', DAMPING_KINDS)
@pytest.mark.parametrize('body', ['random', 'paper'])
def test_every_lane_is_as_alone(random_network, paper_2, random_state, body, damping_kind, method):
    network = {'random': random_network(0), 'paper': paper_2}[body]
    network = replace(network, damping_kind=damping_kind)
    each = starts(network, random_state, LANES + 5, method)
    assert_as_one_by_one(simulate_many(*each[:3], STEPS, each[3]), *each)


@pytest.mark.parametrize('count', [0, 1, 3, 4, 2 * LANES + 1])
@pytest.mark.parametrize('threads', [1, 2, 3])
def test_the_bits_depend_on_no_number_of_lanes_or_threads(
    random_network, random_state, count, threads
):
    integrators, *states = starts(random_network(1), random_state, max(count, 1))
    each = integrators[:count], *(state[:count] for state in states)
    assert_as_one_by_one(simulate_many(*each[:3], STEPS, each[3], threads=threads), *each)


def test_a_spring_without_length_pulls_with_no_lane(random_network, random_state):
    network = random_network(2)
    network = replace(network, rest_length=np.zeros_like(network.rest_length))
    integrators, configurations, velocities, forces = starts(network, random_state, 5)
    configurations[2] = 1.0  # every mobile mass in one place
    each = integrators, configurations, velocities, np.zeros_like(forces)
    trajectories = simulate_many(*each[:3], STEPS)
    assert np.isfinite(trajectories[2].velocity).all()
    assert_as_one_by_one(trajectories, *each)


def test_a_lane_that_diverges_leaves_the_others_alone(random_network, random_state):
    each = starts(random_network(3), random_state, 5)
    each[2][1] = np.inf
    trajectories = simulate_many(*each[:3], STEPS, each[3])
    assert not np.isfinite(trajectories[1].configuration[-1]).all()
    del trajectories[1]
    assert_as_one_by_one(trajectories, *([part[k] for k in (0, 2, 3, 4)] for part in each))


def test_integrators_of_two_steps_are_refused(random_network, random_state):
    integrators, *states, _ = starts(random_network(4), random_state, 4)
    integrators[3] = Integrator(integrators[3].mechanics, 2 * STEP)
    with pytest.raises(ValueError, match='one network, step and method'):
        simulate_many(integrators, *states, STEPS)
    with pytest.raises(ValueError, match='as many integrators as starts'):
        simulate_many(integrators[:3], *states, STEPS)


def test_states_of_another_body_are_refused(random_network, random_state):
    integrators, *states = starts(random_network(4), random_state, 4)
    configurations, velocities, forces = (each[:, :-2] for each in states)
    with pytest.raises(ValueError, match='states and forces of the shape'):
        simulate_many(integrators, configurations, velocities, STEPS, forces)
