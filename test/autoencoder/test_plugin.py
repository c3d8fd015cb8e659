"""An autoencoder of another package trains, is stored and runs like those of this one.

The package is the one that the page on plug-ins shows.
"""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml

from dpc_ros.autoencoder import Checkpoint, CheckpointError, load_checkpoint, save_checkpoint
from dpc_ros.autoencoder.architecture import PluginArchitecture
from dpc_ros.autoencoder.experiment import train_checkpoint
from dpc_ros.autoencoder.kinds import KindError, check_kind, load_plugin
from dpc_ros.autoencoder.modules import untrained_module
from dpc_ros.autoencoder.projection import ProjectionAutoencoder
from dpc_ros.autoencoder.recipe import Recipe, load_recipe
from dpc_ros.autoencoder.training import reconstruction_mse, train
from dpc_ros.network import load_network
from dpc_ros.reduction import CompressedSystem

# torch compiles its own rules of forward mode when they are first needed.
pytestmark = pytest.mark.filterwarnings('ignore:`torch.jit.script`:DeprecationWarning')


@pytest.fixture
def recipe(tanh_package):
    return Recipe(
        'mine_m3',
        'grid',
        kind='tanh',
        options={'units': 12},
        latent_size=3,
        skip=True,
        epochs=8,
        batch_size=64,
    )


@pytest.fixture(params=[True, False], ids=['skip', 'plain'])
def module(request, recipe, small_network, small_configurations):
    """An untrained module, normalised, in double precision."""
    module = untrained_module(replace(recipe, skip=request.param), small_network)
    module.fit_normalisation(small_configurations)
    module.normalise_latents(small_configurations)
    return module


@pytest.fixture
def checkpoint(module, small_network):
    network = {'name': small_network.name, 'digest': small_network.digest}
    return Checkpoint('mine_m3', module.architecture, module.tensors(), network)


def assert_same_bits(first, second):
    ours, theirs = first.tensors(), second.tensors()
    assert ours.keys() == theirs.keys()
    for name, value in ours.items():
        np.testing.assert_array_equal(value, theirs[name], err_msg=name)


def test_recipe_of_the_page_makes_the_module_of_the_page(tanh_package, plugins_page, tmp_path):
    path = tmp_path / 'tanh_m5.yaml'
    path.write_text(plugins_page['yaml'])
    recipe = load_recipe(path)
    module = untrained_module(recipe, load_network(recipe.network))
    assert type(module.plugin) is load_plugin(recipe.kind)
    units = yaml.safe_load(plugins_page['yaml'])['options']['units']
    assert module.plugin.inward[0].weight.shape == (units, 400)


@pytest.mark.parametrize('skip', [True, False])
def test_training_lowers_the_error(recipe, small_network, dataset, skip):
    recipe = replace(recipe, skip=skip, schedule='one_cycle')
    short = train(replace(recipe, epochs=1, learning_rate=0.0), small_network, dataset).export()
    long = train(replace(recipe, epochs=30), small_network, dataset).export()
    before = reconstruction_mse(short, dataset.validation)
    assert reconstruction_mse(long, dataset.validation) < 0.9 * before
    latent = long.encode(dataset.train)
    np.testing.assert_allclose(latent.mean(axis=0), 0, atol=1e-8)
    np.testing.assert_allclose(latent.std(axis=0), 1, atol=1e-8)


def stop_after(epoch):
    def on_epoch(finished, error):
        if finished == epoch:
            raise KeyboardInterrupt

    return on_epoch


@pytest.mark.parametrize('optimizer', ['adam', 'adamw'])
def test_a_training_cut_off_ends_like_an_unbroken_one(
    recipe, small_network, dataset, tmp_path, optimizer
):
    recipe, path = replace(recipe, optimizer=optimizer), tmp_path / 'state.safetensors'
    for epoch in (2, 5):
        with pytest.raises(KeyboardInterrupt):
            train(recipe, small_network, dataset, path, on_epoch=stop_after(epoch))
    assert_same_bits(
        train(recipe, small_network, dataset, path), train(recipe, small_network, dataset)
    )


IDLE = """
import torch
from torch import nn


class Idle(nn.Module):
    def __init__(self, n, m):
        super().__init__()
        self.unused = nn.Parameter(torch.ones(2))
        self.inward, self.outward = nn.Linear(n, m), nn.Linear(m, n)
        self.frozen = nn.Linear(m, m).requires_grad_(False)

    def encode(self, x):
        return self.frozen(self.inward(x))

    def decode(self, latent):
        return self.outward(latent)
"""


def test_parameters_that_nothing_moves_are_taken_up_again(
    install_package, small_network, dataset, tmp_path
):
    install_package('idle_autoencoder', IDLE, {'idle': 'idle_autoencoder:Idle'})
    recipe = Recipe('idle', 'grid', kind='idle', latent_size=2, epochs=4, batch_size=64)
    path = tmp_path / 'state.safetensors'
    with pytest.raises(KeyboardInterrupt):
        train(recipe, small_network, dataset, path, on_epoch=stop_after(1))
    assert_same_bits(
        train(recipe, small_network, dataset, path), train(recipe, small_network, dataset)
    )


def test_random_numbers_of_others_are_left_alone(recipe, small_network, dataset):
    torch.manual_seed(0)
    expected = torch.rand(3)
    torch.manual_seed(0)
    train(replace(recipe, epochs=1), small_network, dataset).export()
    assert torch.equal(torch.rand(3), expected)


def test_from_recipe_to_checkpoint(recipe, workplace, tmp_path):
    recipe = replace(recipe, network=workplace.network, epochs=2)
    checkpoint = load_checkpoint(train_checkpoint(recipe, tmp_path, workplace.data_folder))
    assert checkpoint.architecture == PluginArchitecture('tanh', 24, 3, {'units': 12}, skip=True)
    assert Recipe(**checkpoint.provenance['recipe']) == recipe
    error = reconstruction_mse(checkpoint.autoencoder(), workplace.dataset.validation)
    assert error == pytest.approx(checkpoint.provenance['scores']['validation_mse'], rel=1e-12)


def test_a_checkpoint_keeps_every_bit(checkpoint, small_configurations, tmp_path):
    loaded = load_checkpoint(save_checkpoint(checkpoint, tmp_path))
    assert loaded.architecture == checkpoint.architecture
    assert loaded.tensors.keys() == checkpoint.tensors.keys()
    for name, value in checkpoint.tensors.items():
        assert loaded.tensors[name].dtype == value.dtype
        assert loaded.tensors[name].tobytes() == value.tobytes()
    before, after = checkpoint.autoencoder(), loaded.autoencoder()
    latent = before.encode(small_configurations)
    np.testing.assert_array_equal(after.encode(small_configurations), latent)
    np.testing.assert_array_equal(after.decode(latent), before.decode(latent))


def test_export_is_the_module(module, small_configurations):
    autoencoder = module.export()
    module.double()
    with torch.no_grad():
        latent = module.encode(torch.from_numpy(small_configurations))
        decoded = module.decode(latent)
    np.testing.assert_allclose(autoencoder.encode(small_configurations), latent, atol=1e-10)
    np.testing.assert_allclose(autoencoder.decode(latent.numpy()), decoded, atol=1e-10)
    assert (autoencoder.configuration_size, autoencoder.latent_size) == (24, 3)


def test_derivatives_are_those_of_the_maps(module, small_configurations, central_difference):
    autoencoder, draw = module.export(), np.random.default_rng(0)
    q, velocity, weight = small_configurations[7], draw.normal(size=24), draw.normal(size=24)
    latent, moved = autoencoder.encoder_jacobian_vector_product(q, velocity)
    np.testing.assert_allclose(latent, autoencoder.encode(q), atol=1e-12)
    jacobian = central_difference(autoencoder.encode, q)
    np.testing.assert_allclose(moved, jacobian @ velocity, rtol=1e-6, atol=1e-6)
    expected = central_difference(autoencoder.decode, latent)
    np.testing.assert_allclose(autoencoder.decoder_jacobian(latent), expected, atol=1e-8)
    curvature = autoencoder.decoder_curvature(latent, weight)
    expected = central_difference(lambda xi: weight @ autoencoder.decoder_jacobian(xi), latent)
    np.testing.assert_allclose(curvature, expected, rtol=1e-6, atol=1e-8)
    assert np.abs(curvature).max() > 1e-6


def test_second_derivative_along_a_velocity(module, assert_second_derivative):
    assert_second_derivative(module.export())


def test_any_leading_dimensions_and_any_array(module, small_configurations):
    autoencoder = module.export()
    q = small_configurations[:6].reshape(2, 3, -1)[:, ::-1]
    q.flags.writeable = False
    latent = autoencoder.encode(q)
    decoded, jacobian = autoencoder.decode_with_jacobian(latent)
    assert (latent.shape, decoded.shape, jacobian.shape) == ((2, 3, 3), (2, 3, 24), (2, 3, 24, 3))
    for place in np.ndindex(2, 3):
        np.testing.assert_allclose(autoencoder.encode(q[place]), latent[place], atol=1e-12)
        single = autoencoder.decode_with_jacobian(latent[place])
        np.testing.assert_allclose(single[0], decoded[place], atol=1e-12)
        np.testing.assert_allclose(single[1], jacobian[place], atol=1e-12)


def test_compresses_the_mechanics(module, small_mechanics, central_difference):
    system = CompressedSystem(small_mechanics, module.export(), actuated_mass=14)
    latent = np.array([0.3, -0.2, 0.1])
    gradient = central_difference(system.potential, latent)
    np.testing.assert_allclose(system.potential_gradient(latent), gradient, rtol=1e-5, atol=1e-5)
    hessian = central_difference(system.potential_gradient, latent)
    np.testing.assert_allclose(system.potential_hessian(latent), hessian, rtol=1e-4, atol=1e-4)
    assert np.linalg.eigvalsh(system.mass_matrix(latent)).min() > 0


def test_can_be_projected_on(module, small_configurations):
    autoencoder = module.export()
    projection = ProjectionAutoencoder(autoencoder)
    decoded = autoencoder.decode(autoencoder.encode(small_configurations[:5]))
    latent = projection.encode(decoded)
    np.testing.assert_allclose(projection.decode(latent), decoded, atol=1e-7)


def test_a_kind_that_nobody_registers_names_those_there_are():
    for refuse in (check_kind, load_plugin, lambda kind: Recipe('r', 'grid', kind=kind)):
        with pytest.raises(KindError, match=r"kind 'wavelet': expected one of \['flat', .*'pod'"):
            refuse('wavelet')


@pytest.mark.parametrize('value', ['nowhere_to_be_found:Model', 'my_autoencoder:Missing'])
def test_a_class_that_can_not_be_imported_is_refused(
    tanh_package, install_package, small_network, value
):
    install_package('broken_package', '', {'broken': value})
    with pytest.raises(KindError, match=f"kind 'broken': {value} can not be loaded, "):
        untrained_module(Recipe('r', 'grid', kind='broken'), small_network)


WRONG = """
import torch
from torch import nn


class NoModule:
    def __init__(self, n, m):
        pass


class NoDecoder(nn.Module):
    def __init__(self, n, m):
        super().__init__()

    def encode(self, x):
        return x[:, :2]


class NoSizes(nn.Module):
    pass


class Wide(NoDecoder):
    def decode(self, latent):
        return torch.cat([latent, latent], dim=1)


class Failing(NoDecoder):
    def decode(self, latent):
        return latent @ torch.zeros(7, 24)


class Pair(NoDecoder):
    def encode(self, x):
        return x[:, :2], x[:, 2:4]
"""


@pytest.mark.parametrize(
    ('name', 'options', 'message'),
    [
        ('NoModule', {}, r'expected a torch module, got a NoModule'),
        ('NoDecoder', {}, r"its module has no method 'decode'"),
        ('NoSizes', {}, r'positional argument'),
        ('NoDecoder', {'depth': 3}, r"unexpected keyword argument 'depth'"),
        (
            'Wide',
            {},
            r'decode should map \(batch, 2\) to \(batch, 24\), but \(2, 2\) became \(2, 4\)',
        ),
        (
            'Failing',
            {},
            r'decode should map \(batch, 2\) to \(batch, 24\), but \(2, 2\) gives: mat1 and mat2',
        ),
        ('Pair', {}, r"encode should map \(batch, 24\).*'tuple'"),
    ],
    ids=lambda value: value if isinstance(value, str) and value.isalpha() else '',
)
def test_classes_that_are_no_autoencoder_are_refused(
    install_package, small_network, name, options, message
):
    install_package('wrong_autoencoders', WRONG, {'wrong': f'wrong_autoencoders:{name}'})
    recipe = Recipe('r', 'grid', kind='wrong', latent_size=2, options=options)
    with pytest.raises(ValueError, match=f"kind 'wrong': .*{message}") as caught:
        untrained_module(recipe, small_network)
    assert '\n' not in str(caught.value)


def test_a_checkpoint_whose_package_is_gone_names_its_kind(
    checkpoint, tanh_package, monkeypatch, tmp_path
):
    path = save_checkpoint(checkpoint, tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(sys, 'path', [entry for entry in sys.path if entry != str(tanh_package)])
        with pytest.raises(CheckpointError, match=r"mine_m3\.json: kind 'tanh': expected one of"):
            load_checkpoint(path)
    assert load_checkpoint(path).architecture == checkpoint.architecture


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (lambda t: t.pop('plugin.inward.0.weight'), r'Missing key.*plugin\.inward\.0\.weight'),
        (lambda t: t.update(extra=np.ones(2)), r'Unexpected key.*extra'),
        (lambda t: t.update(latent_mean=np.ones(2)), r'size mismatch for latent_mean'),
        (lambda t: t['latent_scale'].fill(0), r'latent_scale: expected positive values'),
    ],
)
def test_a_checkpoint_that_does_not_fit_is_refused(checkpoint, tmp_path, change, message):
    tensors = {name: value.copy() for name, value in checkpoint.tensors.items()}
    change(tensors)
    path = save_checkpoint(replace(checkpoint, tensors=tensors), tmp_path)
    with pytest.raises(CheckpointError, match=message):
        load_checkpoint(path)


def test_an_altered_option_is_refused(checkpoint, tmp_path):
    path = save_checkpoint(checkpoint, tmp_path)
    content = json.loads(path.read_text())
    for options, message in (
        ({'units': 13}, 'size mismatch'),
        ({'depth': 2}, "unexpected keyword argument 'depth'"),
        ([12], 'options: expected names and values'),
    ):
        content['architecture']['options'] = options
        path.write_text(json.dumps(content))
        with pytest.raises(CheckpointError, match=message):
            load_checkpoint(path)


def test_sizes_of_a_plugin_are_checked():
    with pytest.raises(ValueError, match='positive whole sizes'):
        PluginArchitecture('tanh', 24, 0)
