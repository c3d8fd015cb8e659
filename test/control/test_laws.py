"""Control laws are their formulas, within the bound on the force."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dpc_ros.control import (
    LAWS,
    PaperLaw,
    ReducedEquilibriumLaw,
    Target,
    TargetError,
    feed_forward,
    make_law,
)
from dpc_ros.control.laws import damped_left_inverse

ALPHA, BETA = 0.7, 1.3


def vectors(size, bound=2.0):
    return arrays(float, size, elements=st.floats(-bound, bound))


@pytest.fixture(scope='module')
def target(small_configurations):
    return Target(configuration=small_configurations[len(small_configurations) // 2])


@pytest.fixture(scope='module', params=LAWS)
def law(request, small_system, target):
    law = make_law(request.param, small_system(3), ALPHA, BETA, 0.5)
    law.regulate(target)
    return law


@given(st.integers(0, 2**32 - 1), st.integers(2, 6))
def test_damped_left_inverse_tends_to_the_left_inverse(seed, rows):
    field = np.random.default_rng(seed).normal(size=(rows, 2)) + 3 * np.eye(rows, 2)
    exact = damped_left_inverse(field, 0.0)
    np.testing.assert_allclose(exact @ field, np.eye(2), atol=1e-6)
    np.testing.assert_allclose(exact, np.linalg.pinv(field), rtol=1e-5, atol=1e-5)
    errors = [
        np.linalg.norm(damped_left_inverse(field, damping) - exact)
        for damping in (1e-1, 1e-2, 1e-3, 1e-4)
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-3 * np.linalg.norm(exact)


@given(vectors((3, 2)), st.floats(0.01, 1.0))
def test_damping_bounds_the_inverse_also_of_a_singular_field(field, damping):
    field[:, 1] = 0.5 * field[:, 0]
    field[0, 0] = 3.0
    largest = np.linalg.norm(field, 2)
    inverse = damped_left_inverse(field, damping)
    assert np.linalg.norm(inverse, 2) <= 1 / (2 * damping * largest) * (1 + 1e-6)


@given(vectors(2, 1.0))
def test_paper_law_holds_the_body_at_its_target_where_it_can(small_system, latent):
    system = small_system(2)
    law = PaperLaw(system, ALPHA, BETA, inverse_damping=0.0)
    law.regulate(Target(latent=latent))
    force = law.force(latent, np.zeros(2))
    gradient = system.potential_gradient(latent)
    np.testing.assert_allclose(system.input_field(latent) @ force, gradient, rtol=1e-6, atol=1e-6)


@given(vectors(3), vectors(3), vectors(3))
def test_paper_law_is_its_formula(small_system, goal, latent, velocity):
    system = small_system(3)
    law = PaperLaw(system, ALPHA, BETA, inverse_damping=0.1)
    law.regulate(Target(latent=goal))
    momentum = system.mass_matrix(latent) @ velocity
    wanted = system.potential_gradient(goal) + ALPHA * (goal - latent) - BETA * momentum
    expected = damped_left_inverse(system.input_field(goal), 0.1) @ wanted
    np.testing.assert_allclose(law.force(latent, velocity), expected, rtol=1e-9, atol=1e-9)


@pytest.fixture(scope='module')
def resting(small_system, target):
    """The reduced-equilibrium law with the feed-forward that it rests on."""
    law = ReducedEquilibriumLaw(small_system(3), ALPHA, BETA)
    law.regulate(target)
    return law, feed_forward(law.system, target.configuration)


def test_reduced_equilibrium_law_rests_at_its_equilibrium(resting):
    law, solution = resting
    force = law.force(solution.latent, np.zeros(3))
    np.testing.assert_array_equal(force, solution.force)
    gradient = law.system.potential_gradient(solution.latent, force)
    np.testing.assert_allclose(gradient, 0, atol=1e-7)


@given(offset=vectors(3), velocity=vectors(3))
def test_reduced_equilibrium_law_is_its_formula(resting, offset, velocity):
    law, solution = resting
    field = law.system.input_field(solution.latent)
    expected = solution.force - field.T @ (ALPHA * offset + BETA * velocity)
    force = law.force(solution.latent + offset, velocity)
    np.testing.assert_allclose(force, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize('name', LAWS)
def test_a_configuration_and_its_latent_are_targets(small_system, target, name):
    system = small_system(3)
    autoencoder = system.autoencoder
    latent = autoencoder.encode(target.configuration)
    decoded = Target(configuration=autoencoder.decode(latent))
    first, second = (make_law(name, system, ALPHA, BETA) for _ in range(2))
    first.regulate(Target(latent=latent))
    second.regulate(decoded if name == 'reduced_equilibrium' else target)
    state = latent + 0.1, np.ones(3)
    np.testing.assert_allclose(first.force(*state), second.force(*state), rtol=1e-9, atol=1e-12)


@given(latent=vectors(3, 50.0), velocity=vectors(3, 50.0))
def test_the_bound_shortens_a_force_and_keeps_its_direction(law, latent, velocity):
    free, bounded = law.unbounded_force(latent, velocity), law.force(latent, velocity)
    length = np.linalg.norm(free)
    assert np.linalg.norm(bounded) == pytest.approx(min(length, law.largest_force))
    np.testing.assert_allclose(bounded * length, free * np.linalg.norm(bounded), atol=1e-9)


@pytest.mark.parametrize('name', LAWS)
def test_without_a_target_there_is_no_force(small_system, name):
    law = make_law(name, small_system(3), ALPHA, BETA)
    np.testing.assert_array_equal(law.force(np.ones(3), np.ones(3)), 0)


@pytest.mark.parametrize('name', LAWS)
@pytest.mark.parametrize(
    ('bad', 'message'),
    [
        (Target(configuration=np.zeros(400)), 'configuration: expected 24 values, got 400'),
        (Target(latent=np.zeros(2)), 'latent: expected 3 values, got 2'),
    ],
    ids=['configuration', 'latent'],
)
def test_a_target_that_does_not_fit_leaves_the_old_one(small_system, target, name, bad, message):
    law = make_law(name, small_system(3), ALPHA, BETA)
    law.regulate(target)
    before = law.force(np.ones(3), np.ones(3))
    with pytest.raises(TargetError, match=message):
        law.regulate(bad)
    np.testing.assert_array_equal(law.force(np.ones(3), np.ones(3)), before)


@pytest.mark.parametrize('name', LAWS)
@pytest.mark.parametrize('value', [-1.0, np.nan])
@pytest.mark.parametrize('key', ['proportional_gain', 'derivative_gain', 'largest_force'])
def test_gains_and_bound_have_to_be_numbers(small_system, name, value, key):
    values = {'proportional_gain': 1.0, 'derivative_gain': 1.0, key: value}
    with pytest.raises(ValueError, match=f'{key.replace("_", " ")}: expected a number ≥ 0'):
        make_law(name, small_system(3), **values)


def test_an_unknown_law_names_the_known_ones(small_system):
    with pytest.raises(ValueError, match=r"'pid'.*paper.*reduced_equilibrium"):
        make_law('pid', small_system(3), 1.0, 1.0)
