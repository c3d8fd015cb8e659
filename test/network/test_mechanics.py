"""Forces are the derivatives of energies, and the symmetries of the body hold."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.network import DAMPING_KINDS, Gravity, Mechanics, NetworkError

SEEDS = st.integers(0, 2**32 - 1)
KINDS = st.sampled_from(DAMPING_KINDS)
GRAVITIES = st.builds(Gravity, st.floats(0.0, 20.0), st.floats(-math.pi, math.pi))


def without_dampers_at_supports(network):
    held = np.isin(network.springs, network.fixed).any(axis=1)
    return replace(network, damping=np.where(held, 0.0, network.damping))


@given(SEEDS, GRAVITIES)
def test_gradient_is_the_derivative_of_the_potential(
    random_network, random_state, central_difference, seed, gravity
):
    network = random_network(seed)
    mechanics = Mechanics(network, gravity)
    q, _ = random_state(seed, network)
    expected = central_difference(mechanics.potential, q)
    np.testing.assert_allclose(mechanics.potential_gradient(q), expected, rtol=1e-6, atol=1e-6)


@given(SEEDS)
def test_hessian_is_the_derivative_of_the_gradient(
    random_network, random_state, central_difference, seed
):
    network = random_network(seed)
    mechanics = Mechanics(network, Gravity(9.81))
    q, _ = random_state(seed, network)
    hessian = mechanics.potential_hessian(q)
    expected = central_difference(mechanics.potential_gradient, q)
    np.testing.assert_allclose(hessian, expected, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(hessian, hessian.T, rtol=1e-14, atol=0)


def test_paper_body_has_consistent_derivatives(mechanics, random_state):
    q, direction = random_state(0, mechanics.network)
    step = 1e-6
    ahead, behind = q + step * direction, q - step * direction
    slope = (mechanics.potential(ahead) - mechanics.potential(behind)) / (2 * step)
    assert slope == pytest.approx(mechanics.potential_gradient(q) @ direction, rel=1e-6)
    change = mechanics.potential_gradient(ahead) - mechanics.potential_gradient(behind)
    np.testing.assert_allclose(
        change / (2 * step), mechanics.potential_hessian(q) @ direction, rtol=1e-4, atol=1e-4
    )


@given(SEEDS, KINDS)
def test_damping_matrix_is_symmetric_and_takes_energy(random_network, random_state, seed, kind):
    network = replace(random_network(seed), damping_kind=kind)
    mechanics = Mechanics(network)
    q, velocity = random_state(seed, network)
    matrix, force = mechanics.damping_matrix(q), mechanics.damping_force(q, velocity)
    np.testing.assert_array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix).min() > -1e-12
    np.testing.assert_allclose(force, matrix @ velocity, atol=1e-12)
    assert -velocity @ force <= 0


@given(SEEDS)
def test_isotropic_damping_resists_every_motion(random_network, seed):
    network = random_network(seed)
    # Every spring is damped and every mass hangs on a fixed one: nothing moves for free.
    matrix = Mechanics(network).damping_matrix(network.rest_configuration)
    assert np.linalg.eigvalsh(matrix).min() > 0


@given(SEEDS, KINDS)
def test_damping_matrix_is_semidefinite_where_dampers_are_missing(random_network, seed, kind):
    network = random_network(seed)
    damping = network.damping * (np.random.default_rng(seed).random(len(network.damping)) < 0.5)
    network = replace(network, damping=damping, damping_kind=kind)
    matrix = Mechanics(network).damping_matrix(network.rest_configuration)
    assert np.linalg.eigvalsh(matrix).min() > -1e-12


@given(SEEDS, st.floats(-5, 5), st.tuples(*[st.floats(-5, 5)] * 4))
def test_rigid_motion_gives_no_axial_damping(random_network, seed, turn, motion):
    network = without_dampers_at_supports(replace(random_network(seed), damping_kind='axial'))
    x, y, *shift = motion
    arm = network.rest_configuration.reshape(-1, 2) - [x, y]
    velocity = (turn * arm @ [[0, 1], [-1, 0]] + shift).ravel()
    force = Mechanics(network).damping_force(network.rest_configuration, velocity)
    np.testing.assert_allclose(force, 0, atol=1e-11)


@given(SEEDS, st.floats(-5, 5))
def test_stretching_gives_the_same_damping_of_both_kinds(random_network, seed, rate):
    network = without_dampers_at_supports(random_network(seed))
    q = network.rest_configuration
    # Where all points move away from one, each spring's ends move apart along the spring.
    isotropic, axial = (
        Mechanics(replace(network, damping_kind=kind)).damping_force(q, rate * q)
        for kind in DAMPING_KINDS
    )
    np.testing.assert_allclose(axial, isotropic, atol=1e-12)


@given(SEEDS)
def test_axial_damping_is_the_rate_of_the_springs_lengths(
    random_network, random_state, central_difference, seed
):
    network = replace(random_network(seed), damping_kind='axial')
    q, velocity = random_state(seed, network)

    def lengths(configuration):
        position = network.rest_position.copy()
        position[network.mobile] = configuration.reshape(-1, 2)
        first, second = position[network.springs].swapaxes(0, 1)
        return np.linalg.norm(first - second, axis=1)

    jacobian = central_difference(lengths, q)
    expected = jacobian.T @ (network.damping * (jacobian @ velocity))
    np.testing.assert_allclose(Mechanics(network).damping_force(q, velocity), expected, atol=1e-6)


@given(SEEDS, GRAVITIES, KINDS)
def test_acceleration_follows_the_equation_of_motion(
    random_network, random_state, seed, gravity, kind
):
    network = replace(random_network(seed), damping_kind=kind)
    mechanics = Mechanics(network, gravity)
    q, velocity = random_state(seed, network)
    force = np.random.default_rng(seed).normal(size=len(q))
    total = -mechanics.potential_gradient(q) - mechanics.damping_matrix(q) @ velocity + force
    mass_matrix = np.diag(np.repeat(network.mass[network.mobile], 2))
    np.testing.assert_allclose(
        mechanics.acceleration(q, velocity, force),
        np.linalg.solve(mass_matrix, total),
        rtol=1e-10,
        atol=1e-9,
    )


@given(SEEDS, st.floats(-5, 5), st.floats(-5, 5))
def test_elastic_energy_does_not_see_a_translation(random_network, random_state, seed, x, y):
    network = random_network(seed)
    q, _ = random_state(seed, network)
    moved = replace(network, rest_position=network.rest_position + np.array([x, y]))
    moved_q = q + np.tile([x, y], len(q) // 2)
    before, after = Mechanics(network), Mechanics(moved)
    assert after.elastic_energy(moved_q) == pytest.approx(before.elastic_energy(q), rel=1e-9)
    np.testing.assert_allclose(
        after.potential_gradient(moved_q), before.potential_gradient(q), atol=1e-9
    )


@given(SEEDS, st.floats(-math.pi, math.pi))
def test_elastic_energy_does_not_see_a_rotation_without_background(
    random_network, random_state, seed, angle
):
    network = replace(random_network(seed), background_stiffness=0.0)
    q, _ = random_state(seed, network)
    rotation = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])

    def rotated(values):
        return values.reshape(-1, 2) @ rotation.T

    turned = Mechanics(replace(network, rest_position=rotated(network.rest_position)))
    straight, turned_q = Mechanics(network), rotated(q).ravel()
    assert turned.elastic_energy(turned_q) == pytest.approx(straight.elastic_energy(q), rel=1e-9)
    np.testing.assert_allclose(
        turned.potential_gradient(turned_q),
        rotated(straight.potential_gradient(q)).ravel(),
        atol=1e-9,
    )


@given(SEEDS, KINDS)
def test_internal_forces_balance_and_have_no_moment(random_network, random_state, seed, kind):
    network = replace(random_network(seed), background_stiffness=0.0, damping_kind=kind)
    held = np.isin(network.springs, network.fixed).any(axis=1)
    free = without_dampers_at_supports(
        replace(network, stiffness=np.where(held, 0.0, network.stiffness))
    )
    mechanics = Mechanics(free)
    q, velocity = random_state(seed, free)
    force = mechanics.potential_gradient(q).reshape(-1, 2)
    x, y = q.reshape(-1, 2).T
    np.testing.assert_allclose(force.sum(axis=0), 0, atol=1e-11)
    assert x @ force[:, 1] - y @ force[:, 0] == pytest.approx(0, abs=1e-11)
    damping = mechanics.damping_force(q, velocity).reshape(-1, 2)
    np.testing.assert_allclose(damping.sum(axis=0), 0, atol=1e-11)
    if kind == 'axial':
        assert x @ damping[:, 1] - y @ damping[:, 0] == pytest.approx(0, abs=1e-11)


@given(SEEDS)
def test_supports_carry_the_rest_of_the_internal_forces(
    random_network, random_state, central_difference, seed
):
    network = replace(random_network(seed), background_stiffness=0.0)
    q, _ = random_state(seed, network)

    def energy_with_supports_moved(shift):
        position = network.rest_position.copy()
        position[network.fixed] += shift
        return Mechanics(replace(network, rest_position=position)).elastic_energy(q)

    reaction = central_difference(energy_with_supports_moved, np.zeros(2))
    on_mobile = Mechanics(network).potential_gradient(q).reshape(-1, 2).sum(axis=0)
    np.testing.assert_allclose(reaction + on_mobile, 0, atol=1e-6)


@given(SEEDS)
def test_rest_is_an_equilibrium_without_gravity_and_background(random_network, seed):
    network = random_network(seed)
    ends = network.rest_position[network.springs]
    network = replace(
        network,
        rest_length=np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1),
        background_stiffness=0.0,
    )
    mechanics = Mechanics(network)
    zero = np.zeros(network.configuration_size)
    assert mechanics.elastic_energy(network.rest_configuration) == pytest.approx(0, abs=1e-25)
    acceleration = mechanics.acceleration(network.rest_configuration, zero, zero)
    np.testing.assert_allclose(acceleration, 0, atol=1e-10)


def test_only_the_background_term_pulls_the_paper_body_at_rest(paper_2):
    mechanics = Mechanics(paper_2)
    first, second = paper_2.springs.T
    rest_vector = paper_2.rest_position[first] - paper_2.rest_position[second]
    pull = paper_2.background_stiffness * (1 - paper_2.background_rest_fraction) * rest_vector
    expected = np.zeros_like(paper_2.rest_position)
    np.add.at(expected, first, pull)
    np.add.at(expected, second, -pull)
    np.testing.assert_allclose(
        mechanics.potential_gradient(paper_2.rest_configuration),
        expected[paper_2.mobile].ravel(),
        atol=1e-9,
    )
    without = Mechanics(replace(paper_2, background_stiffness=0.0))
    np.testing.assert_allclose(without.potential_gradient(paper_2.rest_configuration), 0, atol=1e-9)


@given(SEEDS, GRAVITIES)
def test_gravity_pulls_each_mass_by_its_weight(random_network, random_state, seed, gravity):
    network = random_network(seed)
    q, _ = random_state(seed, network)
    pull = Mechanics(network).potential_gradient(q) - Mechanics(
        network, gravity
    ).potential_gradient(q)
    direction = np.array([math.cos(gravity.angle), math.sin(gravity.angle)])
    weight = network.mass[network.mobile][:, None] * gravity.magnitude * direction
    np.testing.assert_allclose(pull.reshape(-1, 2), weight, atol=1e-10)
    hessians = [Mechanics(network, g).potential_hessian(q) for g in (Gravity(), gravity)]
    np.testing.assert_array_equal(*hessians)


@given(SEEDS)
def test_energies_add_up(random_network, random_state, seed):
    network = random_network(seed)
    mechanics = Mechanics(network, Gravity(9.81, 0.3))
    q, velocity = random_state(seed, network)
    kinetic = 0.5 * velocity @ (mechanics.mass_diagonal * velocity)
    assert mechanics.kinetic_energy(velocity) == pytest.approx(kinetic)
    potential = mechanics.elastic_energy(q) + mechanics.gravitational_energy(q)
    assert mechanics.potential(q) == pytest.approx(potential)
    assert mechanics.total_energy(q, velocity) == pytest.approx(potential + kinetic)


@pytest.mark.parametrize('kind', DAMPING_KINDS)
def test_masses_at_one_point_give_finite_forces(small_network, kind):
    mechanics = Mechanics(replace(small_network, damping_kind=kind))
    together = np.zeros(small_network.configuration_size)
    assert np.isfinite(mechanics.damping_force(together, together + 1.0)).all()
    assert np.isfinite(mechanics.damping_matrix(together)).all()
    assert np.isfinite(mechanics.potential_gradient(together)).all()
    assert np.isfinite(mechanics.potential_hessian(together)).all()


@given(SEEDS)
def test_input_field_selects_one_mass(random_network, random_state, seed):
    network = random_network(seed)
    mass = int(np.random.default_rng(seed).choice(network.mobile))
    field = Mechanics(network).input_field(mass)
    np.testing.assert_array_equal(field.T @ field, np.eye(2))
    np.testing.assert_array_equal(field.T @ network.rest_configuration, network.rest_position[mass])


@pytest.mark.parametrize('mass', [-1, 15, 10**6])
def test_no_force_on_a_mass_that_does_not_exist(small_network, mass):
    with pytest.raises(NetworkError, match=f'no mass {mass}: masses are numbered 0 to 14'):
        Mechanics(small_network).input_field(mass)


def test_no_force_on_a_fixed_mass(small_network):
    with pytest.raises(NetworkError, match=r'mass 1 of grid is fixed .* \[0, 1, 2\]'):
        Mechanics(small_network).input_field(1)


def test_default_gravity_is_none_and_its_angle_is_down():
    np.testing.assert_array_equal(Gravity().vector, 0)
    np.testing.assert_allclose(Gravity(9.81).vector, [0, -9.81], atol=1e-15)


@pytest.mark.parametrize(
    ('magnitude', 'angle'), [(-1.0, 0.0), (math.nan, 0.0), (math.inf, 0.0), (1.0, math.nan)]
)
def test_gravity_has_to_be_finite_and_not_negative(magnitude, angle):
    with pytest.raises(ValueError, match='gravity: expected a finite magnitude'):
        Gravity(magnitude, angle)
