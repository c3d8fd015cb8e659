"""Proper orthogonal decomposition as a module: the skip around no networks at all."""

from __future__ import annotations

from torch import Tensor

from dpc_ros.autoencoder.architecture import PodArchitecture
from dpc_ros.autoencoder.module import AutoencoderModule
from dpc_ros.autoencoder.pod import PodAutoencoder


class PodModule(AutoencoderModule):
    """Nothing but normalisation and basis, so there is nothing to train."""

    architecture: PodArchitecture

    def encoder(self, x: Tensor) -> Tensor:
        """Return zero: the skip is all."""
        return x.new_zeros(len(x), self.architecture.latent_size)

    def decoder(self, latent: Tensor) -> Tensor:
        """Return zero: the skip is all."""
        return latent.new_zeros(len(latent), self.architecture.configuration_size)

    def export(self) -> PodAutoencoder:
        """Return the same maps for online use."""
        return PodAutoencoder.from_tensors(self.architecture, self.tensors())
