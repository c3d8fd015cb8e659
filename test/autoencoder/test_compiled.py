"""Compiled encoder and decoder are those of numpy; derivatives are by automatic differentiation.

Weights are random, and so are the sizes: blocks of four are filled up where they don't fit.
"""

from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.autoencoder import ProjectionAutoencoder
from dpc_ros.autoencoder.compiled import (
    FIRST_TANGENT,
    SECOND,
    VALUE,
    dense_decoder,
    dense_encoder,
    value_and_derivatives,
    value_and_product,
)

# torch compiles its own rules of forward mode when they are first needed.
pytestmark = pytest.mark.filterwarnings('ignore:`torch.jit.script`:DeprecationWarning')

ACTIVATIONS = {'elu': torch.nn.functional.elu, 'silu': torch.nn.functional.silu}
PAPER_SIZES = (5, 100, 200, 300, 400)


def random_layers(sizes, seed):
    rng = np.random.default_rng(seed)
    weights = [rng.normal(scale=b**-0.5, size=(a, b)) for b, a in pairwise(sizes)]
    return weights, [rng.normal(size=len(weight)) for weight in weights]


def reference(weights, biases, skip, activation, latent, velocity):
    """Return value, Jacobian and second derivative along the velocity by torch."""
    layers = [tuple(map(torch.from_numpy, each)) for each in zip(weights, biases, strict=True)]

    def decode(xi):
        hidden = xi
        for weight, bias in layers[:-1]:
            hidden = ACTIVATIONS[activation](weight @ hidden + bias)
        weight, bias = layers[-1]
        value = weight @ hidden + bias
        return value if skip is None else value + torch.from_numpy(skip) @ xi

    xi, xi_dot = torch.from_numpy(latent), torch.from_numpy(velocity)
    jacobian = torch.func.jacfwd(decode)
    second = torch.func.jvp(lambda point: jacobian(point) @ xi_dot, (xi,), (xi_dot,))[1]
    return decode(xi), jacobian(xi), second


def assert_derivatives(sizes, activation, with_skip, seed):
    weights, biases = random_layers(sizes, seed)
    rng = np.random.default_rng(seed + 1)
    m, n = sizes[0], sizes[-1]
    skip = rng.normal(size=(n, m)) if with_skip else None
    latent, velocity = rng.normal(size=(2, m))
    decoder = dense_decoder(weights, biases, skip, activation)
    rows = value_and_derivatives(decoder, latent, velocity)
    value, jacobian, second = reference(weights, biases, skip, activation, latent, velocity)
    np.testing.assert_allclose(rows[VALUE], value, atol=1e-12)
    np.testing.assert_allclose(rows[FIRST_TANGENT : FIRST_TANGENT + m].T, jacobian, atol=1e-12)
    np.testing.assert_allclose(rows[SECOND], second, atol=1e-12)


@pytest.mark.parametrize('activation', ACTIVATIONS)
@pytest.mark.parametrize('with_skip', [False, True], ids=['plain', 'skip'])
def test_the_papers_decoder(activation, with_skip):
    assert_derivatives(PAPER_SIZES, activation, with_skip, seed=0)


@given(
    sizes=st.lists(st.integers(1, 9), min_size=4, max_size=4),
    activation=st.sampled_from(sorted(ACTIVATIONS)),
    with_skip=st.booleans(),
    seed=st.integers(0, 100),
)
def test_any_sizes(sizes, activation, with_skip, seed):
    assert_derivatives(sizes, activation, with_skip, seed)


@given(
    sizes=st.lists(st.integers(1, 9), min_size=2, max_size=5),
    activation=st.sampled_from(sorted(ACTIVATIONS)),
    with_skip=st.booleans(),
    seed=st.integers(0, 100),
)
def test_an_encoder_of_any_sizes(sizes, activation, with_skip, seed):
    weights, biases = random_layers(sizes, seed)
    rng = np.random.default_rng(seed + 1)
    skip = rng.normal(size=(sizes[-1], sizes[0])) if with_skip else None
    configuration, velocity = rng.normal(size=(2, sizes[0]))
    encoder = dense_encoder(weights, biases, skip, activation)
    latent, latent_velocity = value_and_product(encoder, configuration, velocity)
    value, jacobian, _ = reference(weights, biases, skip, activation, configuration, velocity)
    np.testing.assert_allclose(latent, value, atol=1e-12)
    np.testing.assert_allclose(latent_velocity, jacobian.numpy() @ velocity, atol=1e-12)


@pytest.mark.parametrize('size', [3, 5])  # of which neither fills a block of four
def test_a_configuration_of_another_size_is_refused(size):
    encoder = dense_encoder(*random_layers((4, 5, 2), 0), None, 'silu')
    for sizes in ((size, 4), (4, size)):
        with pytest.raises(ValueError, match='broadcast'):
            value_and_product(encoder, *map(np.zeros, sizes))


@pytest.mark.parametrize('layers', [1, 2, 6])
def test_any_number_of_layers(layers):
    assert_derivatives([3] * layers + [8], 'silu', True, seed=layers)


def test_far_latents_give_finite_values():
    weights, biases = random_layers((2, 5, 6), 0)
    for activation in ACTIVATIONS:
        decoder = dense_decoder(weights, biases, None, activation)
        for latent in (np.full(2, 1e4), np.full(2, -1e4)):
            assert np.isfinite(value_and_derivatives(decoder, latent, latent)).all()
        encoder = dense_encoder(weights, biases, None, activation)
        for configuration in (np.full(2, 1e4), np.full(2, -1e4)):
            assert np.isfinite(value_and_product(encoder, configuration, configuration)).all()


def test_other_activations_are_refused():
    with pytest.raises(ValueError, match="activation 'tanh': expected elu or silu"):
        dense_decoder(*random_layers((2, 3), 0), None, 'tanh')


def test_dense_autoencoders_give_their_decoder(small_autoencoder, shipped):
    for autoencoder in (small_autoencoder(3), shipped.autoencoder):
        m = autoencoder.latent_size
        latent, velocity = np.random.default_rng(0).normal(size=(2, m))
        expected = autoencoder.decode_with_derivatives(latent, velocity)
        for each in (autoencoder, ProjectionAutoencoder(autoencoder)):
            rows = value_and_derivatives(each.compiled_decoder(), latent, velocity)
            tangents = rows[FIRST_TANGENT : FIRST_TANGENT + m]
            for got, wanted in zip((rows[VALUE], tangents.T, rows[SECOND]), expected, strict=True):
                np.testing.assert_allclose(got, wanted, atol=1e-12)
