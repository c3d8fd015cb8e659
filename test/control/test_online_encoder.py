"""What an encoder gives that is no latent state is refused with the reason."""

import numpy as np
import pytest

from dpc_ros.control import OnlineEncoder
from dpc_ros.parameters import node_parameters


class Encoder:
    """One of another package, which gives what it is told to."""

    latent_size = 5

    def __init__(self, latent, latent_velocity):
        self.given = latent, latent_velocity

    def encoder_jacobian_vector_product(self, configuration, velocity, start):
        return self.given


@pytest.mark.parametrize(
    ('latent', 'latent_velocity', 'reason'),
    [
        (np.zeros(5), np.zeros(1), r'a latent state of the shape \(5,\)'),
        (np.zeros((1, 5)), np.zeros(5), r'a latent state of the shape \(5,\)'),
        (np.zeros(5), np.full(5, np.nan), 'finite'),
    ],
)
def test_no_latent_state(latent, latent_velocity, reason):
    encoder = OnlineEncoder(node_parameters('encoder', {}))
    encoder.autoencoder = Encoder(latent, latent_velocity)
    rest = encoder.network.rest_configuration
    with pytest.raises(ValueError, match=reason):
        encoder.encode(rest, np.zeros_like(rest), 0)
