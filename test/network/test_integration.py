"""The integrators have the orders that they claim, and energy does what physics says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import simpson, solve_ivp

from dpc_ros.network import (
    DAMPING_KINDS,
    INTEGRATORS,
    Gravity,
    Integrator,
    Mechanics,
    load_network,
    simulate,
)
from dpc_ros.network.kernels import acceleration

RELATIVE_TOLERANCE = 1e-9  # of the reference: its own error is far below the bounds tested here
TWO_STEPS = (0.004, 0.002)  # s


def run(mechanics, q, velocity, step, duration, method='rk4', force=None):
    integrator = Integrator(mechanics, step, method)
    return simulate(integrator, q, velocity, round(duration / step), force)


def reference(mechanics, q, velocity, times):
    """Return q at the times by scipy's Dormand–Prince method of order eight."""
    n = len(q)
    zero = np.zeros(n)

    def slope(_, state):
        moved = acceleration(mechanics.arrays, mechanics.gravity_vector, state[:n], state[n:], zero)
        return np.concatenate([state[n:], moved])

    solution = solve_ivp(
        slope,
        (times[0], times[-1]),
        np.concatenate([q, velocity]),
        method='DOP853',
        rtol=RELATIVE_TOLERANCE,
        atol=RELATIVE_TOLERANCE,
        t_eval=times,
    )
    assert solution.success
    return solution.y[:n].T


@pytest.mark.parametrize(('method', 'order'), [('rk4', 4), ('symplectic_euler', 1)])
def test_order_of_convergence(small_mechanics, random_state, method, order):
    q, velocity = random_state(0, small_mechanics.network)
    force = 0.1 * np.ones_like(q)
    ends = []
    for step in (0.002, 0.001, 0.0005):
        last = run(small_mechanics, q, velocity, step, 0.2, method, force)
        ends.append(np.concatenate([last.configuration[-1], last.velocity[-1]]))
    ratio = np.linalg.norm(ends[0] - ends[1]) / np.linalg.norm(ends[1] - ends[2])
    assert np.log2(ratio) == pytest.approx(order, abs=0.2)


@pytest.mark.parametrize('method', INTEGRATORS)
def test_converges_to_the_exact_flow(small_mechanics, random_state, method):
    q, velocity = random_state(1, small_mechanics.network)
    trajectory = run(small_mechanics, q, velocity, 1e-4, 0.2, method)
    exact = reference(small_mechanics, q, velocity, trajectory.time)
    tolerance = {'rk4': 1e-8, 'symplectic_euler': 5e-3}[method]
    np.testing.assert_allclose(trajectory.configuration, exact, atol=tolerance)


@pytest.mark.parametrize(
    ('system', 'simulations'),
    [('paper_2', 7), ('paper_5', 4), *((f'paper_{i}', 2) for i in (1, 3, 4))],
)
def test_paper_simulations_are_near_the_exact_flow(system, simulations, paper_trajectories):
    network = load_network(system)
    for condition, trajectory in paper_trajectories(network)[:simulations]:
        mechanics = Mechanics(network, condition.gravity)
        start = trajectory.configuration[0], trajectory.velocity[0]
        error = trajectory.configuration - reference(mechanics, *start, trajectory.time)
        assert np.sqrt(np.mean(error**2)) <= 1e-6  # m
        assert np.abs(error).max() <= 2e-4  # m


def test_energy_falls_under_damping(mechanics, paper_2, random_state):
    q, velocity = random_state(0, paper_2)
    trajectory = run(mechanics, q, velocity, 0.001, 1.0)
    energy = np.array(
        [
            mechanics.total_energy(*state)
            for state in zip(trajectory.configuration, trajectory.velocity, strict=True)
        ]
    )
    assert np.diff(energy).max() <= 1e-9 * energy[0]
    assert energy[-1] < energy[0]


@pytest.mark.parametrize('kind', DAMPING_KINDS)
def test_energy_lost_is_the_work_of_the_dampers(small_network, random_state, kind):
    network = replace(small_network, damping_kind=kind)
    mechanics = Mechanics(network, Gravity(3.0))
    trajectory = run(mechanics, *random_state(6, network), 0.0005, 0.4)
    states = list(zip(trajectory.configuration, trajectory.velocity, strict=True))
    power = [velocity @ mechanics.damping_force(q, velocity) for q, velocity in states]
    lost = mechanics.total_energy(*states[0]) - mechanics.total_energy(*states[-1])
    assert lost == pytest.approx(simpson(power, dx=trajectory.step), rel=1e-5)


@pytest.mark.parametrize(('method', 'order'), [('rk4', 4), ('symplectic_euler', 1)])
def test_energy_is_kept_without_damping_to_the_order(small_network, random_state, method, order):
    undamped = replace(small_network, damping=np.zeros_like(small_network.damping))
    mechanics = Mechanics(undamped, Gravity(3.0))
    q, velocity = random_state(2, undamped)
    start = mechanics.total_energy(q, velocity)
    errors = []
    for step in TWO_STEPS:
        trajectory = run(mechanics, q, velocity, step, 0.4, method)
        states = zip(trajectory.configuration, trajectory.velocity, strict=True)
        errors.append(max(abs(mechanics.total_energy(*state) - start) for state in states))
    assert errors[0] / errors[1] > 0.8 * 2**order
    assert errors[1] < 0.1 * start


def test_a_body_comes_to_rest_at_an_equilibrium(small_mechanics, small_network, random_state):
    q, velocity = random_state(3, small_network)
    trajectory = run(small_mechanics, q, velocity, 0.005, 60.0)
    np.testing.assert_allclose(trajectory.velocity[-1], 0, atol=1e-8)
    gradient = small_mechanics.potential_gradient(trajectory.configuration[-1])
    np.testing.assert_allclose(gradient, 0, atol=1e-8)


def test_trajectory_starts_at_time_zero_and_steps_by_the_integrator(small_mechanics, random_state):
    q, velocity = random_state(4, small_mechanics.network)
    force = np.linspace(-1, 1, len(q))
    integrator = Integrator(small_mechanics, 0.005)
    trajectory = simulate(integrator, q, velocity, 3, force)
    assert trajectory.configuration.shape == trajectory.velocity.shape == (4, len(q))
    np.testing.assert_allclose(trajectory.time, [0, 0.005, 0.010, 0.015])
    for k in range(4):
        np.testing.assert_array_equal(trajectory.configuration[k], q)
        np.testing.assert_array_equal(trajectory.velocity[k], velocity)
        q, velocity = integrator.advance(q, velocity, force)


def test_inputs_are_left_alone(small_mechanics, random_state):
    q, velocity = random_state(5, small_mechanics.network)
    force = np.ones_like(q)
    copies = q.copy(), velocity.copy(), force.copy()
    for method in INTEGRATORS:
        Integrator(small_mechanics, 0.005, method).advance(q, velocity, force)
    for value, copy in zip((q, velocity, force), copies, strict=True):
        np.testing.assert_array_equal(value, copy)


@pytest.mark.parametrize('step', [0.0, -0.1, np.nan, np.inf])
def test_step_has_to_be_positive(small_mechanics, step):
    with pytest.raises(ValueError, match='step: expected a time > 0 s, got'):
        Integrator(small_mechanics, step)


def test_unknown_method_names_the_known_ones(small_mechanics):
    with pytest.raises(ValueError, match=r"'euler'.*rk4.*symplectic_euler"):
        Integrator(small_mechanics, 0.005, 'euler')


def test_states_of_another_body_are_refused(small_mechanics):
    n = small_mechanics.network.configuration_size - 2
    with pytest.raises(ValueError, match='expected states'):
        Integrator(small_mechanics, 0.005).fill(np.zeros((3, n)), np.zeros((3, n)), np.zeros(n))
