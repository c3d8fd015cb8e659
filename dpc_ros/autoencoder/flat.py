"""The flat (dense) autoencoder, for online use."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder.base import Autoencoder
from dpc_ros.autoencoder.perceptron import Perceptron


class FlatAutoencoder(Autoencoder):
    """Dense encoder and decoder (paper, section III), each with an optional linear skip.

    Args:
        encoder: E, normalisation folded into its layers.
        decoder: D, likewise.

    Raises:
        ValueError: sizes of encoder and decoder do not fit.
    """

    def __init__(self, encoder: Perceptron, decoder: Perceptron) -> None:
        sizes = (encoder.input_size, encoder.output_size)
        if sizes != (decoder.output_size, decoder.input_size):
            raise ValueError(
                f'encoder maps {sizes[0]} to {sizes[1]}, but decoder maps '
                f'{decoder.input_size} to {decoder.output_size}'
            )
        self._encoder = encoder
        self._decoder = decoder

    @property
    def configuration_size(self) -> int:
        return self._encoder.input_size

    @property
    def latent_size(self) -> int:
        return self._encoder.output_size

    def encode(self, configuration: Float[np.ndarray, '*batch n']) -> Float[np.ndarray, '*batch m']:
        return self._encoder.value(configuration)

    def decode(self, latent: Float[np.ndarray, '*batch m']) -> Float[np.ndarray, '*batch n']:
        return self._decoder.value(latent)

    def encoder_jacobian_vector_product(
        self, configuration: Float[np.ndarray, ' n'], velocity: Float[np.ndarray, ' n']
    ) -> tuple[Float[np.ndarray, ' m'], Float[np.ndarray, ' m']]:
        return self._encoder.value_and_jacobian_product(configuration, velocity)

    def decoder_jacobian(self, latent: Float[np.ndarray, ' m']) -> Float[np.ndarray, 'n m']:
        return self._decoder.jacobian(latent)

    def decoder_curvature(
        self, latent: Float[np.ndarray, ' m'], weight: Float[np.ndarray, ' n']
    ) -> Float[np.ndarray, 'm m']:
        return self._decoder.curvature(latent, weight)
