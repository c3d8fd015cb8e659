"""Data, bodies on disk and packages that the tests of autoencoders share."""

import configparser
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from dpc_ros.data import Condition, Dataset, make_dataset, save_dataset
from dpc_ros.network import Gravity, save_network
from dpc_ros.resources import share_directory

CONDITIONS = [
    Condition(1, 'train', Gravity(9.81), 'rest'),
    Condition(2, 'validation', Gravity(5.0, 0.3), 'continue'),
]
HELD_OUT = [Condition(3, 'test', Gravity(4.0), 'rest')]


@pytest.fixture(scope='session')
def dataset(small_configurations):
    """Configurations of the small network; what training must not read is not a number."""
    train_set, validation = small_configurations[::2].copy(), small_configurations[1::2].copy()
    nothing = np.full_like(validation, np.nan)
    return Dataset(
        train=train_set,
        validation=validation,
        test=nothing,
        test_velocity=nothing,
        train_simulation=np.zeros(len(train_set), int),
        validation_simulation=np.zeros(len(validation), int),
        test_simulation=np.zeros(len(nothing), int),
        provenance={},
    )


@dataclass(frozen=True)
class Workplace:
    """A body and its data on disk."""

    network: str
    data_folder: Path
    dataset: Dataset


@pytest.fixture(scope='session')
def workplace(tmp_path_factory, small_network):
    """The small network and its data as files, to be read only."""
    folder = tmp_path_factory.mktemp('workplace')
    save_network(small_network, folder / 'grid.json')
    dataset = make_dataset(small_network, CONDITIONS, HELD_OUT)
    save_dataset(dataset, folder / 'data' / 'grid.npz')
    return Workplace(str(folder / 'grid.json'), folder / 'data', dataset)


@pytest.fixture(scope='session')
def assert_second_derivative():
    """Assert that J̇ξ̇ is what the Hessians of weighted coordinates say, for any dimensions."""

    def check(autoencoder):
        draw = np.random.default_rng(3)
        latents, velocities = draw.normal(size=(2, 2, 4, autoencoder.latent_size))
        weight = draw.normal(size=autoencoder.configuration_size)
        decoded, jacobian, second = autoencoder.decode_with_derivatives(latents, velocities)
        expected = autoencoder.decode_with_jacobian(latents)
        np.testing.assert_allclose(decoded, expected[0], atol=1e-12)
        np.testing.assert_allclose(jacobian, expected[1], atol=1e-12)
        for place in np.ndindex(2, 4):
            curvature = autoencoder.decoder_curvature(latents[place], weight)
            along = velocities[place] @ curvature @ velocities[place]
            assert weight @ second[place] == pytest.approx(along, abs=1e-10)

    return check


@pytest.fixture(scope='session')
def plugins_page():
    """The blocks of code of the page on plug-ins, by their language."""
    page = (share_directory() / 'docs/plugins.md').read_text()
    blocks = dict(re.findall(r'```(\w+)\n(.*?)```', page, re.S))
    assert blocks.keys() == {'python', 'toml', 'yaml'}
    return blocks


@pytest.fixture
def tanh_package(install_package, plugins_page):
    """Install the package that the page on plug-ins shows; the folder that it lies in."""
    project = configparser.ConfigParser()  # as far as TOML goes here
    project.read_string(plugins_page['toml'])
    points = project['project.entry-points."dpc_ros.autoencoders"']
    (module,) = {value.strip('"').split(':')[0] for value in points.values()}
    return install_package(
        module, plugins_page['python'], {name: value.strip('"') for name, value in points.items()}
    )
