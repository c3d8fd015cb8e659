"""Projection finds the nearest point of the decoder's manifold and moves with it exactly."""

import numpy as np
import pytest

from dpc_ros.autoencoder import Autoencoder
from dpc_ros.autoencoder.projection import ProjectionAutoencoder

NOISE = 0.02  # m, each coordinate


class Counting(Autoencoder):
    """Another autoencoder that counts how often its decoder is asked."""

    def __init__(self, autoencoder):
        self.autoencoder = autoencoder
        self.linearised = self.decoded = 0

    @property
    def configuration_size(self):
        return self.autoencoder.configuration_size

    @property
    def latent_size(self):
        return self.autoencoder.latent_size

    def encode(self, configuration):
        return self.autoencoder.encode(configuration)

    def decode(self, latent):
        self.decoded += 1
        return self.autoencoder.decode(latent)

    def encoder_jacobian_vector_product(self, configuration, velocity, guess=None):
        return self.autoencoder.encoder_jacobian_vector_product(configuration, velocity)

    def decode_with_derivatives(self, latent, latent_velocity):
        return self.autoencoder.decode_with_derivatives(latent, latent_velocity)

    def decode_with_jacobian(self, latent):
        self.linearised += 1
        return self.autoencoder.decode_with_jacobian(latent)

    def decoder_curvature(self, latent, weight):
        return self.autoencoder.decoder_curvature(latent, weight)


@pytest.fixture(scope='module')
def network_autoencoder(small_autoencoder):
    return small_autoencoder(3)


@pytest.fixture(scope='module')
def projection(network_autoencoder):
    return ProjectionAutoencoder(network_autoencoder)


@pytest.fixture(scope='module')
def noisy(small_configurations):
    """Configurations of the body off the manifold."""
    draw = np.random.default_rng(0)
    some = small_configurations[::7]
    return some + NOISE * draw.normal(size=some.shape)


def distance(autoencoder, latent, configuration):
    return np.linalg.norm(autoencoder.decode(latent) - configuration, axis=-1)


def test_a_point_of_the_manifold_stays(projection):
    latent = np.random.default_rng(1).normal(size=(50, 3))
    np.testing.assert_allclose(projection.encode(projection.decode(latent)), latent, atol=1e-8)


def test_projecting_twice_is_projecting_once(projection, noisy):
    latent = projection.encode(noisy)
    again = projection.encode(projection.decode(latent))
    np.testing.assert_allclose(again, latent, atol=1e-8)


def test_never_farther_than_the_networks_reconstruction(projection, network_autoencoder, noisy):
    projected = distance(projection, projection.encode(noisy), noisy)
    encoded = distance(projection, network_autoencoder.encode(noisy), noisy)
    assert (projected <= encoded * (1 + 1e-12)).all()
    assert projected.sum() < 0.99 * encoded.sum()


def test_what_is_left_is_normal_to_the_manifold(projection, noisy):
    decoded, jacobian = projection.decode_with_jacobian(projection.encode(noisy))
    gradient = np.einsum('bnm,bn->bm', jacobian, decoded - noisy)
    size = np.linalg.norm(jacobian, axis=(1, 2)) * np.linalg.norm(decoded - noisy, axis=1)
    assert (np.abs(gradient).max(axis=1) < 1e-6 * size).all()


def test_noise_normal_to_the_manifold_is_rejected(projection):
    draw = np.random.default_rng(2)
    for latent in draw.normal(size=(10, 3)):
        decoded, jacobian = projection.decode_with_jacobian(latent)
        tangents, _ = np.linalg.qr(jacobian)
        noise = NOISE * draw.normal(size=decoded.size)
        noise -= tangents @ (tangents.T @ noise)
        np.testing.assert_allclose(projection.encode(decoded + noise), latent, atol=1e-6)


def test_latent_velocity_is_the_derivative_of_the_projection(projection, noisy):
    draw = np.random.default_rng(3)
    # The projection ends within a tolerance, so that a step must not be short: of fourth order.
    step, bends = 5e-4, []
    for q in noisy[:10]:
        velocity = draw.normal(size=q.size)
        latent, latent_velocity = projection.encoder_jacobian_vector_product(q, velocity)
        steps = step * np.array([[-2.0], [-1.0], [1.0], [2.0]])
        around = projection.encode(q + steps * velocity)
        expected = np.array([1.0, -8.0, 8.0, -1.0]) @ around / (12 * step)
        np.testing.assert_allclose(latent_velocity, expected, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(latent, projection.encode(q), atol=1e-7)
        flat = np.linalg.lstsq(projection.decoder_jacobian(latent), velocity)[0]
        bends.append(np.abs(flat - expected).max())
    # The curvature of the manifold is seen: without its term the velocity would be another.
    assert max(bends) > 1e-2


def test_warm_and_cold_starts_agree(projection, noisy):
    for q in noisy[:10]:
        velocity = np.ones_like(q)
        cold = projection.encoder_jacobian_vector_product(q, velocity)
        for guess in (cold[0], cold[0] + 0.1, np.zeros(3)):
            warm = projection.encoder_jacobian_vector_product(q, velocity, guess)
            np.testing.assert_allclose(warm[0], cold[0], atol=1e-6)
            np.testing.assert_allclose(warm[1], cold[1], atol=1e-5)


@pytest.mark.parametrize('guess', [1e3, -1e6, np.nan, np.inf])
def test_a_bad_guess_does_not_hurt(projection, noisy, guess):
    velocity = np.ones_like(noisy[0])
    cold = projection.encoder_jacobian_vector_product(noisy[0], velocity)
    with np.errstate(invalid='ignore', over='ignore'):
        warm = projection.encoder_jacobian_vector_product(noisy[0], velocity, np.full(3, guess))
    np.testing.assert_array_equal(warm, cold)


def test_a_good_guess_saves_steps(network_autoencoder, noisy):
    counting = Counting(network_autoencoder)
    projection = ProjectionAutoencoder(counting)
    latent, _ = projection.encoder_jacobian_vector_product(noisy[0], noisy[0])
    cold, counting.linearised = counting.linearised, 0
    projection.encoder_jacobian_vector_product(noisy[0], noisy[0], latent)
    assert counting.linearised < cold


def test_any_leading_dimensions_give_the_same_as_single_points(projection, noisy):
    batch = noisy[:6].reshape(2, 3, -1)
    latent = projection.encode(batch)
    assert latent.shape == (2, 3, 3)
    for place in np.ndindex(2, 3):
        np.testing.assert_allclose(projection.encode(batch[place]), latent[place], atol=1e-7)


def test_many_points_give_the_same_as_few(projection, noisy):
    many = np.concatenate([noisy] * (600 // len(noisy) + 1))
    some = projection.encode(noisy)
    np.testing.assert_allclose(projection.encode(many)[-len(noisy) :], some, atol=1e-7)


@pytest.mark.parametrize('iterations', [1, 3, 20])
def test_steps_are_bounded(network_autoencoder, small_configurations, iterations):
    counting = Counting(network_autoencoder)
    projection = ProjectionAutoencoder(counting, iterations)
    far = small_configurations[0] + np.random.default_rng(4).normal(size=(20, 24))
    latent = projection.encode(far)
    assert counting.linearised <= iterations + 1
    encoded = distance(network_autoencoder, network_autoencoder.encode(far), far)
    assert (distance(projection, latent, far) <= encoded * (1 + 1e-12)).all()
    counting.linearised = counting.decoded = 0
    projection.encoder_jacobian_vector_product(far[0], far[0], np.zeros(3))
    assert counting.linearised <= iterations + 2
    assert counting.decoded == 1


def test_no_number_in_gives_no_number_out_and_an_end(projection, noisy):
    q = noisy[:2].copy()
    q[1, 3] = np.nan
    latent = projection.encode(q)
    np.testing.assert_allclose(latent[0], projection.encode(q[0]), atol=1e-7)
    assert np.isnan(latent[1]).any()


def test_the_decoder_is_left_as_it_is(projection, network_autoencoder):
    latent, weight = np.linspace(-1, 1, 3), np.linspace(-1, 1, 24)
    assert (projection.configuration_size, projection.latent_size) == (24, 3)
    np.testing.assert_array_equal(projection.decode(latent), network_autoencoder.decode(latent))
    np.testing.assert_array_equal(
        projection.decoder_jacobian(latent), network_autoencoder.decoder_jacobian(latent)
    )
    np.testing.assert_array_equal(
        projection.decoder_curvature(latent, weight),
        network_autoencoder.decoder_curvature(latent, weight),
    )


@pytest.mark.parametrize('iterations', [0, -3])
def test_no_steps_are_refused(network_autoencoder, iterations):
    with pytest.raises(ValueError, match=f'iterations: expected at least 1, got {iterations}'):
        ProjectionAutoencoder(network_autoencoder, iterations)
