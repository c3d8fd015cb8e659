"""A body moves as its integrator says, with forces where they are put."""

import numpy as np
import pytest

from dpc_ros.network import Body, Integrator, NetworkError

MASS = 13


@pytest.fixture
def integrator(small_mechanics):
    return Integrator(small_mechanics, 0.005, 'symplectic_euler')


def test_starts_at_rest_and_goes_back_to_its_start(integrator, small_network, random_state):
    body = Body(integrator, MASS)
    np.testing.assert_array_equal(body.configuration, small_network.rest_configuration)
    np.testing.assert_array_equal(body.velocity, 0)
    q, velocity = random_state(0, small_network)
    body = Body(integrator, MASS, q, velocity)
    body.advance(np.array([1.0, 2.0]))
    assert not np.array_equal(body.configuration, q)
    body.reset()
    np.testing.assert_array_equal(body.configuration, q)
    np.testing.assert_array_equal(body.velocity, velocity)


def test_without_a_force_it_falls_as_the_integrator_says(integrator, random_state):
    q, velocity = random_state(1, integrator.mechanics.network)
    body = Body(integrator, MASS, q, velocity)
    body.advance(np.zeros(2))
    expected = integrator.advance(q, velocity, np.zeros_like(q))
    np.testing.assert_array_equal([body.configuration, body.velocity], expected)


def test_the_force_enters_at_the_actuated_mass_only(integrator, small_network):
    pushed, free = Body(integrator, MASS), Body(integrator, MASS)
    force = np.array([0.3, -0.7])
    pushed.advance(force)
    free.advance(np.zeros(2))
    # Symplectic Euler: the velocity changes by step · force / mass within the step.
    change = (pushed.velocity - free.velocity).reshape(-1, 2)
    at = small_network.mobile == MASS
    expected = integrator.step * force / small_network.mass[MASS]
    np.testing.assert_allclose(change[at][0], expected, rtol=1e-9)
    np.testing.assert_array_equal(change[~at], 0)


def test_external_forces_enter_at_their_masses_and_add_up(integrator, small_network):
    push, pull = np.array([0.5, 0.1]), np.array([-0.2, 0.4])
    pushed = Body(integrator, MASS)
    pushed.advance(pull, {MASS: push, 5: push})
    force = np.zeros((len(small_network.mobile), 2))
    force[small_network.mobile == MASS] = push + pull
    force[small_network.mobile == 5] = push
    rest = small_network.rest_configuration
    expected = integrator.advance(rest, np.zeros_like(rest), force.ravel())
    np.testing.assert_array_equal([pushed.configuration, pushed.velocity], expected)


@pytest.mark.parametrize(('mass', 'message'), [(0, 'mass 0 of grid is fixed'), (15, 'no mass 15')])
def test_actuated_and_pushed_masses_have_to_be_mobile(integrator, mass, message):
    with pytest.raises(NetworkError, match=message):
        Body(integrator, mass)
    with pytest.raises(NetworkError, match=message):
        Body(integrator, MASS).advance(np.zeros(2), {mass: np.zeros(2)})


def test_a_start_of_another_body_is_refused(integrator, small_network):
    short = np.zeros(small_network.configuration_size - 2)
    with pytest.raises(ValueError, match='configuration: expected 24 values, got 22'):
        Body(integrator, MASS, short)
    with pytest.raises(ValueError, match='velocity: expected 24 values, got 22'):
        Body(integrator, MASS, velocity=short)
