"""The flat (dense) autoencoder, for online use: numpy alone, in float64."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder.architecture import FlatArchitecture
from dpc_ros.autoencoder.base import Autoencoder
from dpc_ros.autoencoder.perceptron import Layer, Perceptron

_BUFFERS = {
    'configuration_mean',
    'configuration_scale',
    'latent_mean',
    'latent_scale',
    'pod_basis',
    'pod_scale',
}


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
        try:
            return _fold(architecture, {k: v.astype(np.float64) for k, v in tensors.items()})
        except KeyError as error:
            raise ValueError(f'the tensor {error} is missing') from error

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


def _fold(architecture: FlatArchitecture, tensors: Mapping[str, np.ndarray]) -> FlatAutoencoder:
    n, m = architecture.configuration_size, architecture.latent_size
    sizes = [n, *architecture.hidden_sizes, m]
    encoder = _layers(tensors, 'encoder', sizes)
    decoder = _layers(tensors, 'decoder', sizes[::-1])
    skip_size = m if architecture.skip else 0
    mean = _shaped(tensors, 'configuration_mean', (n,))
    scale = tensors['configuration_scale']
    if scale.size != 1:
        raise ValueError(f'configuration_scale: expected one value, got shape {scale.shape}')
    latent_mean = _shaped(tensors, 'latent_mean', (m,))
    latent_scale = _shaped(tensors, 'latent_scale', (m,))
    basis = _shaped(tensors, 'pod_basis', (n, skip_size))
    pod_scale = _shaped(tensors, 'pod_scale', (skip_size,))
    unknown = tensors.keys() - _BUFFERS - _layer_names(sizes)
    if unknown:
        raise ValueError(f'expected no tensors {sorted(unknown)}')
    for name in ('configuration_scale', 'latent_scale', 'pod_scale'):
        if not (tensors[name] > 0).all():
            raise ValueError(f'{name}: expected positive values, got {tensors[name]}')
    encoder_offset, decoder_offset = -latent_mean, mean
    encoder_skip = decoder_skip = None
    if architecture.skip:
        inward, outward = (basis / pod_scale).T / scale, basis * pod_scale * scale
        encoder_skip = inward / latent_scale[:, None]
        decoder_skip = outward * latent_scale
        encoder_offset = encoder_offset - inward @ mean
        decoder_offset = decoder_offset + outward @ latent_mean
    enter, leave = encoder[0], decoder[-1]
    encoder[0] = Layer(enter.weight / scale, enter.bias - enter.weight @ (mean / scale))
    decoder[-1] = Layer(scale * leave.weight, scale * leave.bias + decoder_offset)
    squeeze, expand = encoder[-1], decoder[0]
    encoder[-1] = Layer(
        squeeze.weight / latent_scale[:, None], (squeeze.bias + encoder_offset) / latent_scale
    )
    decoder[0] = Layer(expand.weight * latent_scale, expand.bias + expand.weight @ latent_mean)
    return FlatAutoencoder(
        Perceptron(encoder, architecture.activation, encoder_skip),
        Perceptron(decoder, architecture.activation, decoder_skip),
    )


def _layer_names(sizes: list[int]) -> set[str]:
    return {
        f'{part}.{2 * i}.{kind}'
        for part in ('encoder', 'decoder')
        for i in range(len(sizes) - 1)
        for kind in ('weight', 'bias')
    }


def _layers(tensors: Mapping[str, np.ndarray], part: str, sizes: list[int]) -> list[Layer]:
    """Return the affine maps of a torch `Sequential` in which activations stand between them."""
    return [
        Layer(
            _shaped(tensors, f'{part}.{2 * i}.weight', (outputs, inputs)),
            _shaped(tensors, f'{part}.{2 * i}.bias', (outputs,)),
        )
        for i, (inputs, outputs) in enumerate(pairwise(sizes))
    ]


def _shaped(tensors: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...]) -> np.ndarray:
    if tensors[name].shape != shape:
        raise ValueError(f'{name}: expected shape {shape}, got {tensors[name].shape}')
    return tensors[name]
