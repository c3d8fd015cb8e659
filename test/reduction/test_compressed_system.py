"""The compressed system's terms are the body's, pulled back by the decoder."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

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
