"""Static equilibria of the full body, and the best that a constant force can do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.control import ConstantForce, EquilibriumError, nearest_equilibrium, static_bound
from dpc_ros.network import (
    Integrator,
    MassSpringNetwork,
    Mechanics,
    NetworkError,
    simulate,
)

MASS = 14
FORCE = np.array([0.8, -0.5])


@pytest.fixture(scope='module')
def body(small_mechanics):
    return ConstantForce(small_mechanics, MASS)


@pytest.fixture(scope='module')
def rest(small_network):
    return small_network.rest_configuration


@given(st.floats(-2, 2), st.floats(-2, 2))
def test_an_equilibrium_balances_all_forces_and_is_stable(body, rest, x, y):
    force = np.array([x, y])
    q = body.equilibrium(force, rest)
    gradient = body.mechanics.potential_gradient(q)
    np.testing.assert_allclose(gradient, body.input_field @ force, atol=1e-8)
    assert body.is_stable(q)


def test_the_body_stays_in_its_equilibrium(body, rest):
    q = body.equilibrium(FORCE, rest)
    run = simulate(
        Integrator(body.mechanics, 0.005), q, np.zeros_like(q), 200, body.input_field @ FORCE
    )
    np.testing.assert_allclose(run.configuration, np.broadcast_to(q, run.configuration.shape))


def test_a_saddle_is_left(body, small_network):
    """Turned inside out, one of the masses sits where the potential has no minimum."""
    q = small_network.rest_configuration.copy()
    place = 2 * small_network.mobile_index(13)
    q[place + 1] += 0.55
    stable = body.equilibrium(np.zeros(2), q)
    assert body.is_stable(stable)


def test_a_rod_that_is_pressed_along_its_axis_is_never_called_stable():
    """It stays straight by symmetry, and would buckle."""
    rod = MassSpringNetwork(
        name='rod',
        mass=np.ones(2),
        fixed=np.array([0]),
        rest_position=np.array([[0.0, 0.0], [1.0, 0.0]]),
        springs=np.array([[0, 1]]),
        stiffness=np.array([10.0]),
        rest_length=np.array([1.0]),
        damping=np.array([0.1]),
        background_stiffness=0.2,
        background_rest_fraction=0.0,
    )
    body, pressed = ConstantForce(Mechanics(rod), 1), np.array([-3.0, 0.0])
    with pytest.raises(EquilibriumError, match='not stable'):
        body.equilibrium(pressed, rod.rest_configuration)
    askew = rod.rest_configuration + np.array([0.0, 0.01])
    assert body.is_stable(body.equilibrium(pressed, askew))


def test_slope_is_the_derivative_of_the_equilibrium(body, rest, central_difference):
    q = body.equilibrium(FORCE, rest)
    expected = central_difference(lambda force: body.equilibrium(force, q), FORCE, 1e-4)
    np.testing.assert_allclose(body.slope(q), expected, atol=1e-6)


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_what_a_force_holds_is_found_again(body, rest, x, y):
    force = np.array([x, y])
    target = body.equilibrium(force, rest)
    found = nearest_equilibrium(body, target, np.zeros(2), rest)
    np.testing.assert_allclose(found.force, force, atol=1e-4)
    assert found.rms < 1e-6


def test_the_bound_is_where_the_distance_is_stationary(small_mechanics, body, rest):
    target = rest + np.random.default_rng(0).normal(scale=0.02, size=rest.size)
    bound = static_bound(small_mechanics, MASS, target, starts=3)
    slope, residual = body.slope(bound.configuration), bound.configuration - target
    assert np.abs(slope.T @ residual).max() < 1e-5 * np.abs(slope).max()
    assert bound.rms == pytest.approx(np.sqrt(np.mean(residual**2)))
    scale = np.mean((rest - target) ** 2)
    assert bound.nmse == pytest.approx(np.mean(residual**2) / scale)


def test_no_other_force_is_better(small_mechanics, body, rest):
    target = body.equilibrium(FORCE, rest) + 0.01
    bound = static_bound(small_mechanics, MASS, target, starts=4)
    for change in np.random.default_rng(1).normal(scale=0.3, size=(20, 2)):
        q = body.equilibrium(bound.force + change, bound.configuration)
        assert np.mean((q - target) ** 2) >= bound.rms**2 * (1 - 1e-9)


def test_the_bound_heeds_the_largest_force(small_mechanics, body, rest):
    target = body.equilibrium(2.0 * FORCE, rest)
    bound = static_bound(small_mechanics, MASS, target, largest_force=0.5, starts=3)
    assert np.linalg.norm(bound.force) <= 0.5 + 1e-12
    free = static_bound(small_mechanics, MASS, target, starts=3)
    assert free.nmse < bound.nmse
    for angle in np.linspace(0, 2 * np.pi, 24):  # no other force of that length is better
        force = 0.5 * np.array([np.cos(angle), np.sin(angle)])
        q = body.equilibrium(force, bound.configuration)
        assert np.mean((q - target) ** 2) >= bound.rms**2 * (1 - 1e-9)


def test_more_starts_are_never_worse(small_mechanics, body, rest):
    target = body.equilibrium(FORCE, rest) + 0.02
    few, many = (static_bound(small_mechanics, MASS, target, starts=n) for n in (2, 5))
    assert many.rms <= few.rms


def test_the_target_rest_needs_no_force(mechanics, paper_2):
    unforced = static_bound(mechanics, 162, paper_2.rest_configuration, starts=2)
    assert unforced.rms > 1e-3  # its springs are not relaxed there
    assert unforced.nmse == np.inf  # of a body that begins at its target


@pytest.mark.parametrize('bad', [np.nan, np.inf])
def test_bad_forces_and_starts_are_refused(body, rest, bad):
    with pytest.raises(EquilibriumError, match='expected a finite force and start'):
        body.equilibrium(np.array([bad, 0.0]), rest)
    with pytest.raises(EquilibriumError, match='expected a finite force and start'):
        body.equilibrium(FORCE, np.full_like(rest, bad))


def test_bad_searches_are_refused(small_mechanics, rest):
    with pytest.raises(ValueError, match='starts: expected at least 2, got 1'):
        static_bound(small_mechanics, MASS, rest, starts=1)
    with pytest.raises(ValueError, match='target: expected 24 finite numbers'):
        static_bound(small_mechanics, MASS, rest[:-2])
    with pytest.raises(NetworkError, match='mass 0 of grid is fixed'):
        static_bound(small_mechanics, 0, rest)
    with pytest.raises(ValueError, match='largest force: expected a number'):
        static_bound(small_mechanics, MASS, rest, largest_force=-1.0)
