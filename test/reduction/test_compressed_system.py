"""The compressed system's terms are the body's, pulled back by the decoder."""

import inspect
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.network import Mechanics, NetworkError
from dpc_ros.reduction import CompressedSystem

LATENTS = arrays(float, 3, elements=st.floats(-2, 2))
FORCES = st.none() | arrays(float, 2, elements=st.floats(-2, 2))


@given(LATENTS)
def test_mass_matrix_is_symmetric_and_positive(small_system, latent):
    mass_matrix = small_system(3).mass_matrix(latent)
    np.testing.assert_allclose(mass_matrix, mass_matrix.T, rtol=1e-12, atol=1e-15)
    assert np.linalg.eigvalsh(mass_matrix).min() > 0


@given(LATENTS)
def test_damping_matrix_is_symmetric_and_semidefinite(small_system, latent):
    damping = small_system(3).damping_matrix(latent)
    np.testing.assert_allclose(damping, damping.T, rtol=1e-12, atol=1e-15)
    assert np.linalg.eigvalsh(damping).min() >= -1e-12


@given(LATENTS, arrays(float, 3, elements=st.floats(-1, 1)))
def test_energy_and_dissipation_are_the_bodys(small_system, small_network, latent, velocity):
    system = small_system(3)
    full = system.autoencoder.decoder_jacobian(latent) @ velocity
    kinetic = 0.5 * velocity @ system.mass_matrix(latent) @ velocity
    assert kinetic == pytest.approx(system.mechanics.kinetic_energy(full), abs=1e-12)
    q = system.autoencoder.decode(latent)
    for mechanics in (system.mechanics, Mechanics(replace(small_network, damping_kind='axial'))):
        system = CompressedSystem(mechanics, system.autoencoder, system.actuated_mass)
        dissipated = velocity @ system.damping_matrix(latent) @ velocity
        assert dissipated == pytest.approx(full @ mechanics.damping_force(q, full), abs=1e-12)


@given(LATENTS)
def test_input_field_is_pulled_back(small_system, small_network, latent):
    system = small_system(3)
    jacobian = system.autoencoder.decoder_jacobian(latent)
    place = 2 * small_network.mobile_index(system.actuated_mass)
    expected = jacobian[place : place + 2].T
    np.testing.assert_allclose(system.input_field(latent), expected, rtol=1e-12)


@given(LATENTS, FORCES)
def test_gradient_is_the_derivative_of_the_potential(
    small_system, central_difference, latent, force
):
    system = small_system(3)
    expected = central_difference(lambda xi: system.potential(xi, force), latent)
    np.testing.assert_allclose(
        system.potential_gradient(latent, force), expected, rtol=1e-6, atol=1e-6
    )


@given(LATENTS, FORCES)
def test_hessian_is_the_derivative_of_the_gradient(small_system, central_difference, latent, force):
    system = small_system(3)
    hessian = system.potential_hessian(latent, force)
    expected = central_difference(lambda xi: system.potential_gradient(xi, force), latent)
    np.testing.assert_allclose(hessian, expected, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(hessian, hessian.T, rtol=1e-10, atol=1e-10)


@given(LATENTS, arrays(float, 2, elements=st.floats(-2, 2)))
def test_a_force_adds_its_work(small_system, latent, force):
    system = small_system(3)
    added = system.potential_gradient(latent) - system.potential_gradient(latent, force)
    np.testing.assert_allclose(added, system.input_field(latent) @ force, atol=1e-10)


def damped_axially(system):
    """Return the same system with dampers along the springs."""
    axial = replace(system.mechanics.network, damping_kind='axial')
    mechanics = Mechanics(axial, system.mechanics.gravity)
    return CompressedSystem(mechanics, system.autoencoder, system.actuated_mass)


@pytest.fixture(params=['isotropic', 'axial', 'shipped'])
def any_system(request, small_system, mechanics):
    if request.param == 'shipped':
        autoencoder = load_checkpoint('paper_2_extended_m5').autoencoder()
        return CompressedSystem(mechanics, autoencoder, 162)
    return small_system(3) if request.param == 'isotropic' else damped_axially(small_system(3))


@pytest.fixture
def moving_states(any_system):
    """States and forces, ten of each."""
    draw = np.random.default_rng(4)
    size = (10, any_system.latent_size)
    return draw.normal(size=size), draw.normal(size=size), draw.normal(size=(10, 2))


def convective_force(system, latent, velocity):
    """Return JᵀM(J̇ξ̇)."""
    _, jacobian, second = system.autoencoder.decode_with_derivatives(latent, velocity)
    return jacobian.T @ (system.mechanics.mass_diagonal * second)


def test_equation_of_motion_is_the_one_of_the_terms(any_system, moving_states):
    for latent, velocity, force in zip(*moving_states, strict=True):
        left = any_system.mass_matrix(latent) @ any_system.acceleration(latent, velocity, force)
        left += convective_force(any_system, latent, velocity)
        left += any_system.damping_matrix(latent) @ velocity
        left += any_system.potential_gradient(latent)
        right = any_system.input_field(latent) @ force
        np.testing.assert_allclose(left, right, atol=1e-9 * max(1.0, np.abs(left).max()))


def test_power_is_what_damping_takes_and_the_input_gives(any_system, moving_states):
    for latent, velocity, force in zip(*moving_states, strict=True):
        kinetic_rate = velocity @ (
            any_system.mass_matrix(latent) @ any_system.acceleration(latent, velocity, force)
            + convective_force(any_system, latent, velocity)
        )
        rate = kinetic_rate + velocity @ any_system.potential_gradient(latent)
        taken = velocity @ any_system.damping_matrix(latent) @ velocity
        given_power = velocity @ any_system.input_field(latent) @ force
        scale = abs(kinetic_rate) + taken + abs(given_power)
        assert rate == pytest.approx(given_power - taken, abs=1e-11 * scale)
        power = any_system.power(latent, velocity, force)
        assert power == pytest.approx(given_power - taken, abs=1e-12 * scale)


def test_both_forms_of_the_equations_agree(any_system, moving_states):
    for latent, velocity, force in zip(*moving_states, strict=True):
        momentum = any_system.momentum(latent, velocity)
        mass_matrix = any_system.mass_matrix(latent)
        np.testing.assert_allclose(momentum, mass_matrix @ velocity, atol=1e-12)
        back = any_system.latent_velocity(latent, momentum)
        np.testing.assert_allclose(back, velocity, atol=1e-10)
        # π̇ = M_η ξ̈ + Ṁ_η ξ̇ with Ṁ_η = J̇ᵀMJ + JᵀMJ̇
        jacobian = any_system.autoencoder.decoder_jacobian(latent)
        weight = any_system.mechanics.mass_diagonal * (jacobian @ velocity)
        bend = any_system.autoencoder.decoder_curvature(latent, weight) @ velocity
        acceleration = any_system.acceleration(latent, velocity, force)
        expected = mass_matrix @ acceleration + bend
        expected += convective_force(any_system, latent, velocity)
        rate = any_system.momentum_rate(latent, velocity, force)
        np.testing.assert_allclose(rate, expected, atol=1e-9 * max(1.0, np.abs(rate).max()))


def test_momentum_form_is_the_hamiltons(small_system, central_difference):
    """ξ̇ = ∂η/∂π and π̇ = −∂η/∂ξ − Δ∂η/∂π + Γu (paper, equation of the reduced system)."""
    system = small_system(3)
    draw = np.random.default_rng(5)
    latent, momentum, force = draw.normal(size=3), draw.normal(size=3), draw.normal(size=2)

    def hamiltonian(xi, pi):
        return system.total_energy(xi, system.latent_velocity(xi, pi))

    velocity = system.latent_velocity(latent, momentum)
    by_momentum = central_difference(lambda pi: hamiltonian(latent, pi), momentum)
    np.testing.assert_allclose(velocity, by_momentum, rtol=1e-6, atol=1e-6)
    by_latent = central_difference(lambda xi: hamiltonian(xi, momentum), latent)
    expected = system.input_field(latent) @ force - system.damping_matrix(latent) @ velocity
    rate = system.momentum_rate(latent, velocity, force)
    np.testing.assert_allclose(rate, expected - by_latent, rtol=1e-5, atol=1e-5)


def test_compiled_acceleration_is_the_one_of_any_decoder(any_system, moving_states):
    accelerations = any_system.acceleration(*moving_states)
    expected = any_system._accelerations(*moving_states)
    np.testing.assert_allclose(accelerations, expected, rtol=1e-9, atol=1e-8)
    single = [any_system.acceleration(*state) for state in zip(*moving_states, strict=True)]
    np.testing.assert_array_equal(accelerations, single)
    several = any_system.acceleration(*(rows.reshape(2, 5, -1) for rows in moving_states))
    np.testing.assert_array_equal(several.reshape(accelerations.shape), accelerations)


def test_no_force_is_the_force_zero(any_system, moving_states):
    latents, velocities, forces = moving_states
    np.testing.assert_array_equal(
        any_system.acceleration(latents, velocities),
        any_system.acceleration(latents, velocities, 0.0 * forces),
    )


def test_a_force_for_all_states_is_the_same_for_each(any_system, moving_states):
    latents, velocities, forces = moving_states
    for_each = any_system.acceleration(latents, velocities, np.tile(forces[0], (10, 1)))
    np.testing.assert_array_equal(any_system.acceleration(latents, velocities, forces[0]), for_each)


@pytest.mark.parametrize(
    ('latent', 'velocity', 'force', 'message'),
    [
        ((2,), (2,), (2,), r'latent: expected the shape \(3,\), got \(2,\)'),
        ((24,), (24,), (2,), r'latent: expected the shape \(3,\), got \(24,\)'),
        ((10, 3), (4, 3), (2,), r'velocity: expected the shape \(10, 3\), got \(4, 3\)'),
        ((3,), (2,), (2,), r'velocity: expected the shape \(3,\), got \(2,\)'),
        ((10, 3), (10, 3), (4, 2), r'force: expected the shape \(10, 2\), got \(4, 2\)'),
        ((3,), (3,), (3,), r'force: expected the shape \(2,\), got \(3,\)'),
    ],
)
def test_states_of_other_shapes_are_refused(small_system, latent, velocity, force, message):
    # Without the check of shapes that the tests put around it.
    acceleration = inspect.unwrap(CompressedSystem.acceleration)
    with pytest.raises(ValueError, match=message):
        acceleration(small_system(3), np.zeros(latent), np.zeros(velocity), np.zeros(force))


def test_any_array_will_do(any_system, moving_states):
    expected = any_system.acceleration(*moving_states)
    for each in moving_states:
        each.flags.writeable = False
    backwards = [rows[::-1] for rows in moving_states]
    np.testing.assert_array_equal(any_system.acceleration(*backwards)[::-1], expected)
    in_single = any_system.acceleration(*(rows.astype(np.float32) for rows in moving_states))
    np.testing.assert_allclose(in_single, expected, rtol=1e-2, atol=1e-2)


def test_energy_is_the_bodys(any_system, moving_states):
    for latent, velocity, _ in zip(*moving_states, strict=True):
        q, jacobian = any_system.autoencoder.decode_with_jacobian(latent)
        energy = any_system.mechanics.total_energy(q, jacobian @ velocity)
        assert any_system.total_energy(latent, velocity) == pytest.approx(energy, rel=1e-12)
        kinetic = 0.5 * velocity @ any_system.momentum(latent, velocity)
        assert any_system.kinetic_energy(latent, velocity) == pytest.approx(kinetic, rel=1e-12)


@pytest.mark.parametrize('kind', ['isotropic', 'axial'])
def test_a_linear_decoder_of_full_rank_compresses_nothing(full_rank_system, random_state, kind):
    system = full_rank_system(kind)
    network = system.mechanics.network
    for seed in range(5):
        q, velocity = random_state(seed, network)
        force = np.array([0.5, -1.0])
        xi, xi_dot = system.autoencoder.encoder_jacobian_vector_product(q, velocity)
        full = system.mechanics.acceleration(q, velocity, system.full_input_field @ force)
        accelerated = system.autoencoder.decoder_jacobian(xi) @ system.acceleration(
            xi, xi_dot, force
        )
        np.testing.assert_allclose(accelerated, full, atol=1e-8 * np.abs(full).max())


def test_shipped_systems_have_consistent_derivatives(shipped, central_difference):
    system, force = shipped.system, np.array([0.3, -0.2])
    latent = np.linspace(-0.5, 0.5, system.latent_size)
    gradient = central_difference(lambda xi: system.potential(xi, force), latent)
    np.testing.assert_allclose(
        system.potential_gradient(latent, force), gradient, rtol=1e-5, atol=1e-5
    )
    hessian = central_difference(lambda xi: system.potential_gradient(xi, force), latent, 1e-6)
    np.testing.assert_allclose(
        system.potential_hessian(latent, force), hessian, rtol=1e-4, atol=1e-3
    )
    assert np.linalg.eigvalsh(system.mass_matrix(latent)).min() > 0


def test_autoencoder_and_body_have_to_fit(small_autoencoder, paper_2):
    with pytest.raises(ValueError, match='takes 24 coordinates, paper_2 has 400'):
        CompressedSystem(Mechanics(paper_2), small_autoencoder(2), 162)


def test_actuated_mass_has_to_be_mobile(small_autoencoder, small_mechanics):
    with pytest.raises(NetworkError, match='mass 0 of grid is fixed'):
        CompressedSystem(small_mechanics, small_autoencoder(2), 0)
