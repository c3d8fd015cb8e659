"""Proper orthogonal decomposition is the best linear reconstruction."""

import numpy as np
import pytest
import torch

from dpc_ros.autoencoder.architecture import PodArchitecture
from dpc_ros.autoencoder.pod_module import PodModule
from dpc_ros.autoencoder.recipe import Recipe
from dpc_ros.autoencoder.training import reconstruction_mse, train


@pytest.fixture(scope='module')
def make_pod(small_configurations):
    """Return a function: latent size → POD of the small configurations."""

    def make(latent_size):
        module = PodModule(PodArchitecture(small_configurations.shape[1], latent_size))
        module.fit_normalisation(small_configurations)
        module.normalise_latents(small_configurations)
        return module

    return make


@pytest.mark.parametrize('latent_size', [1, 3, 8])
def test_loses_the_smaller_singular_values_alone(make_pod, small_configurations, latent_size):
    centred = small_configurations - small_configurations.mean(axis=0)
    lost = np.linalg.svd(centred, compute_uv=False)[latent_size:]
    error = reconstruction_mse(make_pod(latent_size).export(), small_configurations)
    np.testing.assert_allclose(error * centred.size, np.sum(lost**2), rtol=1e-8)


def test_no_other_linear_map_is_better(make_pod, small_configurations):
    error = reconstruction_mse(make_pod(3).export(), small_configurations)
    mean = small_configurations.mean(axis=0)
    draw = np.random.default_rng(0)
    basis = make_pod(3).pod_basis.numpy()
    for size in (1e-3, 0.1, 10.0):
        other, _ = np.linalg.qr(basis + size * draw.normal(size=basis.shape))
        lost = (small_configurations - mean) @ (np.eye(len(other)) - other @ other.T)
        assert np.mean(lost**2) > error


def test_basis_is_orthonormal(make_pod):
    basis = make_pod(6).pod_basis.numpy()
    np.testing.assert_allclose(basis.T @ basis, np.eye(6), atol=1e-12)


def test_error_never_rises_with_the_latent_size(make_pod, small_configurations):
    errors = [reconstruction_mse(make_pod(m).export(), small_configurations) for m in range(1, 11)]
    assert (np.diff(errors) <= 1e-15).all()


def test_export_is_the_module(make_pod, small_configurations):
    module = make_pod(3)
    autoencoder = module.export()
    with torch.no_grad():
        latent = module.encode(torch.from_numpy(small_configurations))
        decoded = module.decode(latent)
    np.testing.assert_allclose(autoencoder.encode(small_configurations), latent, atol=1e-10)
    np.testing.assert_allclose(autoencoder.decode(latent.numpy()), decoded, atol=1e-12)
    np.testing.assert_allclose(latent.mean(axis=0), 0, atol=1e-10)
    np.testing.assert_allclose(latent.std(axis=0, correction=0), 1, atol=1e-10)


def test_derivatives_are_those_of_linear_maps(make_pod, small_configurations, central_difference):
    autoencoder = make_pod(3).export()
    q, velocity = small_configurations[3], small_configurations[5]
    latent, moved = autoencoder.encoder_jacobian_vector_product(q, velocity)
    np.testing.assert_allclose(latent, autoencoder.encode(q), atol=1e-12)
    jacobian = central_difference(autoencoder.encode, q, 0.1)
    np.testing.assert_allclose(moved, jacobian @ velocity, atol=1e-9)
    expected = central_difference(autoencoder.decode, latent, 0.1)
    np.testing.assert_allclose(autoencoder.decoder_jacobian(latent), expected, atol=1e-10)
    assert not autoencoder.decoder_curvature(latent, velocity).any()
    assert not autoencoder.decode_with_derivatives(latent, moved)[2].any()


def test_training_is_nothing_but_the_decomposition(
    make_pod, dataset, small_network, small_configurations, tmp_path
):
    recipe = Recipe('pod', 'grid', kind='pod', latent_size=3)
    module = train(recipe, small_network, dataset, tmp_path / 'state')
    assert list(tmp_path.iterdir()) == []
    centred = dataset.train - dataset.train.mean(axis=0)
    lost = np.linalg.svd(centred, compute_uv=False)[3:]
    error = reconstruction_mse(module.export(), dataset.train)
    np.testing.assert_allclose(error * centred.size, np.sum(lost**2), rtol=1e-8)


def test_more_modes_than_directions_are_refused(small_configurations):
    module = PodModule(PodArchitecture(small_configurations.shape[1], 5))
    with pytest.raises(ValueError, match='fewer than 5 independent directions'):
        module.fit_normalisation(small_configurations[:4])


@pytest.mark.parametrize('sizes', [(0, 2), (24, 0), (24, 2.0)])
def test_bad_sizes_are_refused(sizes):
    with pytest.raises(ValueError, match='positive whole sizes'):
        PodArchitecture(*sizes)
