"""Network and autoencoder that the parameters of a node name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dpc_ros.autoencoder import Autoencoder, Checkpoint, load_checkpoint, with_encoder
from dpc_ros.network import MassSpringNetwork, load_network


def load_models(
    parameters: Mapping[str, Any],
) -> tuple[MassSpringNetwork, Checkpoint, Autoencoder]:
    """Return network, checkpoint and autoencoder, with the encoder that the parameters ask for.

    Raises:
        FileNotFoundError: there is no such network or checkpoint.
        ValueError: a parameter, or a checkpoint of another network.
    """
    network = load_network(parameters['network'])
    checkpoint = load_checkpoint(parameters['checkpoint'])
    checkpoint.check_network(network)
    autoencoder = with_encoder(
        checkpoint.autoencoder(), parameters['encoder'], parameters['projection_iterations']
    )
    return network, checkpoint, autoencoder
