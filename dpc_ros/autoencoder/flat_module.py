"""The flat autoencoder as a torch module: what is trained, and its export for online use."""

from __future__ import annotations

from itertools import pairwise

from torch import nn

from dpc_ros.autoencoder.architecture import FlatArchitecture
from dpc_ros.autoencoder.flat import FlatAutoencoder
from dpc_ros.autoencoder.module import AutoencoderModule

_ACTIVATION_MODULES = {'elu': nn.ELU, 'silu': nn.SiLU}


class FlatModule(AutoencoderModule):
    """Perceptrons between configuration and latent, the decoder the encoder's mirror image."""

    architecture: FlatArchitecture

    def __init__(self, architecture: FlatArchitecture) -> None:
        super().__init__(architecture)
        self.encoder = _perceptron_module(architecture.sizes, architecture.activation)
        self.decoder = _perceptron_module(architecture.sizes[::-1], architecture.activation)

    def export(self) -> FlatAutoencoder:
        """Return the same maps for online use."""
        return FlatAutoencoder.from_tensors(self.architecture, self.tensors())


def _perceptron_module(sizes: list[int], activation: str) -> nn.Sequential:
    modules: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        modules += [nn.Linear(inputs, outputs), _ACTIVATION_MODULES[activation]()]
    return nn.Sequential(*modules[:-1])
