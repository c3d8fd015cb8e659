"""Proper orthogonal decomposition, for online use."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dpc_ros.autoencoder.architecture import PodArchitecture
from dpc_ros.autoencoder.layered import LayeredAutoencoder, NamedTensors, fold_normalisation
from dpc_ros.autoencoder.layers import DenseLayer


class PodAutoencoder(LayeredAutoencoder):
    """The linear maps that lose least of the training configurations in the mean square."""

    @classmethod
    def from_tensors(
        cls, architecture: PodArchitecture, tensors: Mapping[str, np.ndarray]
    ) -> PodAutoencoder:
        """Return the maps of `PodModule`.

        Args:
            architecture: sizes.
            tensors: basis and normalisation by the names that the module gives them.

        Raises:
            ValueError: a tensor is missing or unknown, has another shape than the architecture
                says, or is a scale that is not positive.
        """
        named = NamedTensors(tensors)
        n, m = architecture.configuration_size, architecture.latent_size
        nothing_in = DenseLayer(np.zeros((m, n)), np.zeros(m))
        nothing_out = DenseLayer(np.zeros((n, m)), np.zeros(n))
        maps = fold_normalisation(named, [nothing_in], [nothing_out], architecture)
        named.check_all_taken()
        return cls(*maps)
