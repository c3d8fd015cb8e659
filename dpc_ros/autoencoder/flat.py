"""The flat (dense) autoencoder, for online use."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from dpc_ros.autoencoder.architecture import FlatArchitecture
from dpc_ros.autoencoder.layered import LayeredAutoencoder, NamedTensors, fold_normalisation
from dpc_ros.autoencoder.layers import DenseLayer


class FlatAutoencoder(LayeredAutoencoder):
    """Dense encoder and decoder (paper, section III), each with an optional linear skip."""

    @classmethod
    def from_tensors(
        cls, architecture: FlatArchitecture, tensors: Mapping[str, np.ndarray]
    ) -> FlatAutoencoder:
        """Return the maps of `FlatModule`, every normalisation folded into the layers.

        Args:
            architecture: sizes and kind.
            tensors: weights and buffers by the names that the module gives them.

        Raises:
            ValueError: a tensor is missing or unknown, has another shape than the architecture
                says, or is a scale that is not positive.
        """
        named = NamedTensors(tensors)
        sizes = architecture.sizes
        maps = fold_normalisation(
            named,
            _layers(named, 'encoder', sizes),
            _layers(named, 'decoder', sizes[::-1]),
            architecture,
        )
        named.check_all_taken()
        return cls(*maps)


def _layers(tensors: NamedTensors, part: str, sizes: list[int]) -> list[DenseLayer]:
    """Return the affine maps of a torch `Sequential` in which activations stand between them."""
    return [
        DenseLayer(
            tensors.take(f'{part}.{2 * i}.weight', (outputs, inputs)),
            tensors.take(f'{part}.{2 * i}.bias', (outputs,)),
        )
        for i, (inputs, outputs) in enumerate(pairwise(sizes))
    ]
