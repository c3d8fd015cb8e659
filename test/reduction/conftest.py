"""Systems that the tests of the reduction share."""

from dataclasses import replace

import numpy as np
import pytest

from dpc_ros.autoencoder import PodAutoencoder
from dpc_ros.autoencoder.architecture import PodArchitecture
from dpc_ros.network import Mechanics
from dpc_ros.reduction import CompressedSystem


@pytest.fixture(scope='session')
def full_rank_system(small_mechanics):
    """Return a function: damping → a small body in rotated coordinates, as many as it has."""

    def make(damping_kind):
        network = replace(small_mechanics.network, damping_kind=damping_kind)
        n = network.configuration_size
        rotation = np.linalg.qr(np.random.default_rng(0).normal(size=(n, n)))[0]
        autoencoder = PodAutoencoder.from_tensors(
            PodArchitecture(n, n),
            {
                'configuration_mean': network.rest_configuration,
                'configuration_scale': np.ones(1),
                'latent_mean': np.zeros(n),
                'latent_scale': np.ones(n),
                'pod_basis': rotation,
                'pod_scale': np.ones(n),
            },
        )
        return CompressedSystem(Mechanics(network, small_mechanics.gravity), autoencoder, 14)

    return make
