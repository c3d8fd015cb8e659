"""The exported autoencoder is the trained module, and its derivatives are exact."""

import numpy as np
import pytest
import torch

from dpc_ros.autoencoder import FlatAutoencoder
from dpc_ros.autoencoder.architecture import FlatArchitecture
from dpc_ros.autoencoder.flat_module import FlatModule
from dpc_ros.autoencoder.layers import DenseLayer
from dpc_ros.autoencoder.perceptron import Perceptron
from dpc_ros.network import Integrator, simulate

# torch compiles its own rules of forward mode when they are first needed.
pytestmark = pytest.mark.filterwarnings('ignore:`torch.jit.script`:DeprecationWarning')

KINDS = [(activation, skip) for activation in ('elu', 'silu') for skip in (False, True)]


@pytest.fixture(params=KINDS, ids=lambda kind: f'{kind[0]}-{"skip" if kind[1] else "plain"}')
def module(request, make_module):
    return make_module(3, *request.param).double()


@pytest.fixture
def point(small_configurations):
    """A configuration, a velocity, a latent state and a weight of each coordinate."""
    rng = np.random.default_rng(1)
    q = small_configurations[7]
    return q, rng.normal(size=q.size), rng.normal(size=3), rng.normal(size=q.size)


def test_export_is_the_module(module, small_configurations):
    autoencoder = module.export()
    with torch.no_grad():
        latent = module.encode(torch.from_numpy(small_configurations))
        configuration = module.decode(latent)
    np.testing.assert_allclose(autoencoder.encode(small_configurations), latent, atol=1e-10)
    np.testing.assert_allclose(autoencoder.decode(latent.numpy()), configuration, atol=1e-10)
    sizes = autoencoder.configuration_size, autoencoder.latent_size
    assert sizes == (small_configurations.shape[1], 3)


def test_export_of_a_module_without_any_normalisation():
    torch.manual_seed(2)
    module = FlatModule(FlatArchitecture(6, 2, (5,), 'elu', skip=False)).double()
    q = torch.randn(10, 6, dtype=torch.float64)
    with torch.no_grad():
        expected = module.decoder(module.encoder(q))
    autoencoder = module.export()
    np.testing.assert_allclose(autoencoder.decode(autoencoder.encode(q.numpy())), expected)


def test_any_leading_dimensions(module, small_configurations):
    autoencoder = module.export()
    q = small_configurations[:12].reshape(3, 4, -1)
    latent = autoencoder.encode(q)
    decoded = autoencoder.decode(latent)
    assert latent.shape == (3, 4, 3)
    for place in np.ndindex(3, 4):
        np.testing.assert_allclose(autoencoder.encode(q[place]), latent[place], atol=1e-12)
        np.testing.assert_allclose(autoencoder.decode(latent[place]), decoded[place], atol=1e-12)


def test_normalised_latents_have_zero_mean_and_unit_deviation(module, small_configurations):
    latent = module.export().encode(small_configurations)
    np.testing.assert_allclose(latent.mean(axis=0), 0, atol=1e-10)
    np.testing.assert_allclose(latent.std(axis=0), 1, atol=1e-10)


def test_normalising_latents_leaves_the_reconstruction(module, small_configurations):
    with torch.no_grad():
        module.latent_mean.fill_(0.7)
        module.latent_scale.fill_(3.0)
        before = module(torch.from_numpy(small_configurations))
        module.normalise_latents(small_configurations)
        after = module(torch.from_numpy(small_configurations))
    np.testing.assert_allclose(after, before, atol=1e-10)


def test_encoder_moves_with_the_configuration(module, point):
    q, velocity, _, _ = point
    latent, latent_velocity = module.export().encoder_jacobian_vector_product(q, velocity)
    expected = torch.func.jvp(module.encode, (torch.from_numpy(q),), (torch.from_numpy(velocity),))
    np.testing.assert_allclose(latent, expected[0].detach(), atol=1e-10)
    np.testing.assert_allclose(latent_velocity, expected[1].detach(), atol=1e-10)


def test_decoder_jacobian(module, point):
    latent = point[2]
    expected = torch.func.jacfwd(module.decode)(torch.from_numpy(latent)).detach()
    np.testing.assert_allclose(module.export().decoder_jacobian(latent), expected, atol=1e-10)


def test_decoder_curvature(module, point):
    _, _, latent, weight = point
    weights = torch.from_numpy(weight)
    hessian = torch.func.hessian(lambda xi: weights @ module.decode(xi))
    expected = hessian(torch.from_numpy(latent)).detach()
    curvature = module.export().decoder_curvature(latent, weight)
    np.testing.assert_allclose(curvature, expected, atol=1e-10)
    assert np.abs(curvature).max() > 1e-6


def test_second_derivative_along_a_velocity(module, point):
    latent, velocity = point[2], np.array([0.5, -1.0, 2.0])
    decoded, jacobian, second = module.export().decode_with_derivatives(latent, velocity)
    xi, xi_dot = torch.from_numpy(latent), torch.from_numpy(velocity)
    jacobian_of = torch.func.jacfwd(module.decode)
    expected = torch.func.jvp(lambda at: jacobian_of(at) @ xi_dot, (xi,), (xi_dot,))[1].detach()
    np.testing.assert_allclose(second, expected, atol=1e-10)
    np.testing.assert_allclose(jacobian, jacobian_of(xi).detach(), atol=1e-10)
    np.testing.assert_allclose(decoded, module.decode(xi).detach(), atol=1e-10)


@pytest.fixture(scope='module')
def spread(small_configurations):
    """Configurations that fill all directions, some more than others."""
    draw = np.random.default_rng(5)
    n = small_configurations.shape[1]
    return small_configurations.mean(axis=0) + draw.normal(size=(80, n)) * np.linspace(0.01, 1, n)


def pod_module(pod_size, configurations):
    torch.manual_seed(0)
    n = configurations.shape[1]
    module = FlatModule(FlatArchitecture(n, 3, (16, 8), 'silu', True, pod_size))
    module.fit_normalisation(configurations)
    module.normalise_latents(configurations)
    return module.double()


@pytest.mark.parametrize('pod_size', [3, 7, 24])
def test_export_with_pod_coordinates_is_the_module(spread, pod_size):
    module = pod_module(pod_size, spread)
    autoencoder = module.export()
    with torch.no_grad():
        latent = module.encode(torch.from_numpy(spread))
        decoded = module.decode(latent)
    np.testing.assert_allclose(autoencoder.encode(spread), latent, atol=1e-10)
    np.testing.assert_allclose(autoencoder.decode(latent.numpy()), decoded, atol=1e-10)
    at, weights = latent[0], torch.from_numpy(spread[1])
    expected = torch.func.jacfwd(lambda xi: module.decode(xi[None])[0])(at).detach()
    np.testing.assert_allclose(autoencoder.decoder_jacobian(at.numpy()), expected, atol=1e-10)
    hessian = torch.func.hessian(lambda xi: weights @ module.decode(xi[None])[0])(at).detach()
    curvature = autoencoder.decoder_curvature(at.numpy(), weights.numpy())
    np.testing.assert_allclose(curvature, hessian, atol=1e-10)
    _, moved = autoencoder.encoder_jacobian_vector_product(spread[0], spread[1])
    jacobian = torch.func.jacfwd(lambda q: module.encode(q[None])[0])(torch.from_numpy(spread[0]))
    np.testing.assert_allclose(moved, jacobian.detach().numpy() @ spread[1], atol=1e-9)


def test_all_pod_coordinates_lose_nothing(spread):
    module = pod_module(24, spread)
    q = torch.from_numpy(spread)
    features = module.features(q)
    assert module.lost_by_features(q) < 1e-28
    centred = (q - module.configuration_mean) / module.configuration_scale
    torch.testing.assert_close(features @ module.pod_basis.T, centred)
    torch.testing.assert_close(features.square().sum(), centred.square().sum())


@pytest.mark.parametrize('pod_size', [0, 3, 7, 24])
def test_error_of_features_and_what_they_lose_is_the_whole_error(spread, pod_size):
    module = pod_module(pod_size, spread)
    q = torch.from_numpy(spread)
    with torch.no_grad():
        features = module.features(q)
        error = (module.reconstruct(features) - features).square().sum() / q.numel()
        whole = (module(q) - q).square().mean()
    seen = float(error * module.configuration_scale**2)
    assert seen + module.lost_by_features(q) == pytest.approx(float(whole), rel=1e-9)


def test_configurations_that_do_not_move_are_refused(make_module, small_configurations):
    module = make_module(3)
    still = np.tile(small_configurations[0], (10, 1))
    with pytest.raises(ValueError, match='fewer than 3 independent directions'):
        module.fit_normalisation(still)


def test_pod_skip_alone_is_the_best_linear_reconstruction(make_module, small_configurations):
    module = make_module(3, skip=True)
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.zero_()
    module.normalise_latents(small_configurations)
    autoencoder = module.export()
    centred = small_configurations - small_configurations.mean(axis=0)
    error = autoencoder.decode(autoencoder.encode(small_configurations)) - small_configurations
    lost = np.linalg.svd(centred, compute_uv=False)[3:]
    np.testing.assert_allclose(np.sum(error**2), np.sum(lost**2), rtol=1e-8)


def test_latent_velocity_is_the_time_derivative_of_the_latent(make_module, small_mechanics):
    autoencoder = make_module(3).export()
    rest = small_mechanics.network.rest_configuration
    # 0.25 s of a fall; the state in its middle, and those one, two and four steps beside it.
    trajectory = simulate(Integrator(small_mechanics, 0.0005), rest, np.zeros_like(rest), 500)
    latent = autoencoder.encode(trajectory.configuration)
    middle = 250
    _, velocity = autoencoder.encoder_jacobian_vector_product(
        trajectory.configuration[middle], trajectory.velocity[middle]
    )
    errors = [
        np.linalg.norm(
            (latent[middle + k] - latent[middle - k]) / (2 * k * trajectory.step) - velocity
        )
        for k in (4, 2, 1)
    ]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 2, atol=0.2)
    assert errors[-1] < 1e-2 * np.linalg.norm(velocity)


def test_encoder_and_decoder_have_to_fit():
    encoder = Perceptron([DenseLayer(np.zeros((2, 6)), np.zeros(2))], 'elu')
    decoder = Perceptron([DenseLayer(np.zeros((6, 3)), np.zeros(6))], 'elu')
    with pytest.raises(ValueError, match='encoder maps 6 to 2, but decoder maps 3 to 6'):
        FlatAutoencoder(encoder, decoder)


def test_layers_have_to_follow_on_one_another():
    layers = [DenseLayer(np.zeros((4, 6)), np.zeros(4)), DenseLayer(np.zeros((2, 5)), np.zeros(2))]
    with pytest.raises(ValueError, match='4 outputs is followed by one of 5 inputs'):
        Perceptron(layers, 'elu')


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'configuration_size': 0}, 'positive whole sizes'),
        ({'latent_size': -1}, 'positive whole sizes'),
        ({'latent_size': 2.0}, 'positive whole sizes'),
        ({'hidden_sizes': (10, 0)}, 'positive whole sizes'),
        ({'activation': 'relu'}, r"activation 'relu': expected one of \['elu', 'silu'\]"),
        ({'pod_size': 4}, 'pod_size 4: expected skip'),
        ({'pod_size': 1, 'skip': True}, 'pod_size 1: expected skip and at least latent_size 2'),
        ({'pod_size': 7, 'skip': True}, 'at most configuration_size 6'),
        ({'pod_size': -1, 'skip': True}, 'pod_size: expected a whole number ≥ 0'),
        ({'pod_size': 2.0, 'skip': True}, 'pod_size: expected a whole number ≥ 0'),
    ],
)
def test_bad_architectures_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        FlatArchitecture(**{'configuration_size': 6, 'latent_size': 2, **changes})
