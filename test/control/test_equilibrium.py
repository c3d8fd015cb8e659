"""Reduced equilibria are stable and at rest, and the feed-forward is the best constant force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dpc_ros.control import (
    EquilibriumError,
    feed_forward,
    pulled_equilibrium,
    reduced_equilibrium,
)

FORCES = arrays(float, 2, elements=st.floats(-1, 1))  # N; the small body weighs 1.8 N
SIZES = st.sampled_from([2, 3])


def equilibrium_from_rest(system, force):
    rest = system.autoencoder.encode(system.mechanics.network.rest_configuration)
    return reduced_equilibrium(system, force, rest)


def distance(system, force, start, target):
    latent = reduced_equilibrium(system, force, start)
    return np.sqrt(np.mean((system.autoencoder.decode(latent) - target) ** 2))


@given(SIZES, FORCES)
def test_an_equilibrium_is_a_minimum_of_the_potential(small_system, size, force):
    system = small_system(size)
    latent = equilibrium_from_rest(system, force)
    np.testing.assert_allclose(system.potential_gradient(latent, force), 0, atol=1e-7)
    assert np.linalg.eigvalsh(system.potential_hessian(latent, force)).min() > 0


@given(SIZES, FORCES)
def test_an_equilibrium_is_found_again(small_system, size, force):
    system = small_system(size)
    latent = equilibrium_from_rest(system, force)
    np.testing.assert_allclose(reduced_equilibrium(system, force, latent), latent, atol=1e-6)


def test_shipped_systems_have_equilibria(shipped):
    system = shipped.system
    latent = equilibrium_from_rest(system, np.zeros(2))
    for force in (np.zeros(2), np.array([0.2, 0.0]), np.array([0.2, -0.2])):
        latent = reduced_equilibrium(system, force, latent)
        np.testing.assert_allclose(system.potential_gradient(latent, force), 0, atol=1e-7)
        assert np.linalg.eigvalsh(system.potential_hessian(latent, force)).min() > 0


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_a_force_that_is_no_number_has_no_equilibrium(small_system, value):
    with pytest.raises(EquilibriumError):
        equilibrium_from_rest(small_system(2), np.array([value, 0.0]))


def test_the_start_is_left_alone(small_system):
    start = np.zeros(3)
    reduced_equilibrium(small_system(3), np.array([0.5, 0.5]), start)
    np.testing.assert_array_equal(start, 0)


@settings(max_examples=10)
@given(SIZES, FORCES)
def test_feed_forward_recovers_the_force_of_an_equilibrium(small_system, size, force):
    system = small_system(size)
    latent = equilibrium_from_rest(system, force)
    solution = feed_forward(system, system.autoencoder.decode(latent))
    np.testing.assert_allclose(solution.force, force, atol=1e-4)
    np.testing.assert_allclose(solution.latent, latent, atol=1e-3)
    assert solution.distance < 1e-5


@settings(max_examples=10)
@given(SIZES, st.integers(0, 10**6))
def test_no_force_nearby_comes_nearer_the_target(small_system, small_configurations, size, number):
    system = small_system(size)
    target = small_configurations[number % len(small_configurations)]
    solution = feed_forward(system, target)
    stated = distance(system, solution.force, solution.latent, target)
    assert solution.distance == pytest.approx(stated, rel=1e-6)
    for radius in (1e-3, 1e-2, 1e-1):
        for angle in np.linspace(0, 2 * np.pi, 8, endpoint=False):
            force = solution.force + radius * np.array([np.cos(angle), np.sin(angle)])
            nearby = distance(system, force, solution.latent, target)
            assert nearby >= solution.distance * (1 - 1e-7)


@settings(max_examples=10)
@given(st.floats(0, 1), st.integers(0, 10**6))
def test_feed_forward_keeps_to_its_bound(small_system, small_configurations, bound, number):
    system = small_system(3)
    target = small_configurations[number % len(small_configurations)]
    solution = feed_forward(system, target, bound)
    assert np.linalg.norm(solution.force) <= bound * (1 + 1e-12)
    unforced = equilibrium_from_rest(system, np.zeros(2))
    residual = system.autoencoder.decode(unforced) - target
    assert solution.distance <= np.sqrt(np.mean(residual**2)) * (1 + 1e-9)


def test_shipped_feed_forward_comes_nearer_than_no_force(shipped, paper_2, paper_trajectories):
    target = paper_trajectories(paper_2)[1][1].configuration[300]
    solution = feed_forward(shipped.system, target, 2.0)
    unforced = feed_forward(shipped.system, target, 0.0)
    np.testing.assert_array_equal(unforced.force, 0)
    assert solution.distance < unforced.distance


@settings(max_examples=10)
@given(SIZES, arrays(float, 2, elements=st.floats(-0.2, 0.2)), st.floats(0.1, 2.0))
def test_what_a_hand_pulls_at_is_held_by_its_force(small_system, size, displacement, bound):
    system = small_system(size)
    start = equilibrium_from_rest(system, np.zeros(2))
    hand = system.full_input_field.T @ system.autoencoder.decode(start) + displacement
    found = pulled_equilibrium(system, hand, start, bound)
    np.testing.assert_allclose(system.potential_gradient(found.latent, found.force), 0, atol=1e-7)
    position = system.full_input_field.T @ system.autoencoder.decode(found.latent)
    assert found.distance == pytest.approx(np.linalg.norm(hand - position))
    strength = np.linalg.norm(found.force)
    assert strength <= bound * (1 + 1e-12)
    if strength < bound * (1 - 1e-9):
        assert found.distance <= strength / 50 + 1e-9  # the hand's spring has 100 N/m


def test_a_hand_that_is_nowhere_is_refused(small_system):
    with pytest.raises(EquilibriumError, match='finite position'):
        pulled_equilibrium(small_system(2), np.array([np.nan, 0.0]), np.zeros(2))
