"""Autoencoders made of layers, for online use, in float64: numpy, and compiled where dense."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder.architecture import (
    FlatArchitecture,
    GraphArchitecture,
    PodArchitecture,
)
from dpc_ros.autoencoder.base import Autoencoder, Derivatives
from dpc_ros.autoencoder.layers import DenseLayer, Layer
from dpc_ros.autoencoder.perceptron import Perceptron

if TYPE_CHECKING:
    from dpc_ros.autoencoder.compiled import DenseDecoder

_CHUNK = 512  # configurations that go through the layers at a time


class LayeredAutoencoder(Autoencoder):
    """Layered encoder and decoder, each with an optional linear skip.

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
        return _in_chunks(self._encoder, configuration)

    def decode(self, latent: Float[np.ndarray, '*batch m']) -> Float[np.ndarray, '*batch n']:
        return _in_chunks(self._decoder, latent)

    def encoder_jacobian_vector_product(
        self,
        configuration: Float[np.ndarray, ' n'],
        velocity: Float[np.ndarray, ' n'],
        guess: Float[np.ndarray, ' m'] | None = None,
    ) -> tuple[Float[np.ndarray, ' m'], Float[np.ndarray, ' m']]:
        return self._encode_along(configuration, velocity)

    def decode_with_jacobian(
        self, latent: Float[np.ndarray, '*batch m']
    ) -> tuple[Float[np.ndarray, '*batch n'], Float[np.ndarray, '*batch n m']]:
        return self._decoder.value_and_jacobian(latent)

    def decode_with_derivatives(
        self,
        latent: Float[np.ndarray, '*batch m'],
        latent_velocity: Float[np.ndarray, '*batch m'],
    ) -> Derivatives:
        return self._decoder.value_and_derivatives(latent, latent_velocity)

    def compiled_decoder(self) -> DenseDecoder | None:
        if not _is_dense(self._decoder):
            return None
        from dpc_ros.autoencoder.compiled import dense_decoder  # with numba: not every node's

        return dense_decoder(*_arrays(self._decoder))

    @cached_property
    def _encode_along(self) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        if not _is_dense(self._encoder):
            return self._encoder.value_and_jacobian_product
        from dpc_ros.autoencoder.compiled import dense_encoder, value_and_product

        return partial(value_and_product, dense_encoder(*_arrays(self._encoder)))

    def decoder_curvature(
        self, latent: Float[np.ndarray, ' m'], weight: Float[np.ndarray, ' n']
    ) -> Float[np.ndarray, 'm m']:
        return self._decoder.curvature(latent, weight)


def _is_dense(network: Perceptron) -> bool:
    return all(isinstance(layer, DenseLayer) for layer in network.layers)


def _arrays(
    network: Perceptron,
) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray | None, str]:
    """Return what compiled code needs of a network whose layers are all dense."""
    weights = [layer.weight for layer in network.layers if isinstance(layer, DenseLayer)]
    biases = [layer.bias for layer in network.layers]
    return weights, biases, network.skip, network.activation


class NamedTensors:
    """The tensors of a checkpoint, in float64; each is asked for once by its name and shape."""

    def __init__(self, tensors: Mapping[str, np.ndarray]) -> None:
        self._tensors = tensors
        self._known: set[str] = set()

    def take(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """Return a tensor.

        Raises:
            ValueError: it is missing or has another shape.
        """
        self._known.add(name)
        if name not in self._tensors:
            raise ValueError(f'the tensor {name!r} is missing')
        tensor = np.asarray(self._tensors[name])
        if tensor.shape != shape:
            raise ValueError(f'{name}: expected shape {shape}, got {tensor.shape}')
        return tensor.astype(np.float64)

    def take_scale(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """Return a tensor of positive values.

        Raises:
            ValueError: it is missing, has another shape, or a value is not positive.
        """
        tensor = self.take(name, shape)
        if not (tensor > 0).all():
            raise ValueError(f'{name}: expected positive values, got {tensor}')
        return tensor

    def take_positive(self, name: str) -> float:
        """Return a single positive value.

        Raises:
            ValueError: it is missing, not one value or not positive.
        """
        self._known.add(name)
        if name not in self._tensors:
            raise ValueError(f'the tensor {name!r} is missing')
        tensor = np.asarray(self._tensors[name])
        if not (tensor.size == 1 and tensor.item() > 0):
            raise ValueError(f'{name}: expected one positive value, got {tensor}')
        return float(tensor.item())

    def take_edges(self, name: str) -> np.ndarray:
        """Return pairs of nodes, (edges, 2).

        Raises:
            ValueError: they are missing or no pairs of whole numbers.
        """
        self._known.add(name)
        edges = np.asarray(self._tensors[name]) if name in self._tensors else None
        if edges is None:
            raise ValueError(f'the tensor {name!r} is missing')
        if edges.ndim != 2 or edges.shape[1] != 2 or edges.dtype.kind not in 'iu':
            raise ValueError(
                f'{name}: expected pairs of whole numbers, got {edges.dtype} of shape {edges.shape}'
            )
        return edges

    def check_all_taken(self) -> None:
        """Make sure that no tensor is left.

        Raises:
            ValueError: some are.
        """
        unknown = self._tensors.keys() - self._known
        if unknown:
            raise ValueError(f'expected no tensors {sorted(unknown)}')


def fold_normalisation(
    tensors: NamedTensors,
    encoder: Sequence[Layer],
    decoder: Sequence[Layer],
    architecture: FlatArchitecture | GraphArchitecture | PodArchitecture,
) -> tuple[Perceptron, Perceptron]:
    """Return encoder and decoder of an `AutoencoderModule`, its normalisation in their layers.

    Args:
        tensors: the checkpoint's, of which the normalisation is taken.
        encoder: layers from normalised configuration, or its POD coordinates, to raw latent.
        decoder: layers from raw latent back.
        architecture: sizes, and what stands around the layers.

    Raises:
        ValueError: a tensor of the normalisation is missing, misshapen, or a scale not positive.
    """
    n, m = architecture.configuration_size, architecture.latent_size
    mean = tensors.take('configuration_mean', (n,))
    scale = tensors.take_positive('configuration_scale')
    latent_mean = tensors.take('latent_mean', (m,))
    latent_scale = tensors.take_scale('latent_scale', (m,))
    basis = tensors.take('pod_basis', (n, architecture.basis_size))
    pod_scale = tensors.take_scale('pod_scale', (architecture.basis_size,))
    if architecture.pod_size:
        encoder = [_joined(encoder[0], basis.T), *encoder[1:]]
        decoder = [*decoder[:-1], _projected(decoder[-1], basis)]
    encoder_offset, decoder_offset = -latent_mean, mean
    encoder_skip = decoder_skip = None
    if architecture.skip:
        basis, pod_scale = basis[:, :m], pod_scale[:m]
        inward, outward = (basis / pod_scale).T / scale, basis * pod_scale * scale
        encoder_skip = inward / latent_scale[:, None]
        decoder_skip = outward * latent_scale
        encoder_offset = encoder_offset - inward @ mean
        decoder_offset = decoder_offset + outward @ latent_mean
    return (
        Perceptron(
            _wrapped(
                encoder,
                (1.0 / scale, -mean / scale),
                (1.0 / latent_scale, encoder_offset / latent_scale),
            ),
            architecture.activation,
            encoder_skip,
        ),
        Perceptron(
            _wrapped(decoder, (latent_scale, latent_mean), (scale, decoder_offset)),
            architecture.activation,
            decoder_skip,
        ),
    )


def _joined(layer: Layer, before: Float[np.ndarray, 'inputs n']) -> DenseLayer:
    """Return the layer x ↦ L(Ax) + b."""
    return DenseLayer(layer.product(before.T).T, layer.bias)


def _projected(layer: Layer, after: Float[np.ndarray, 'n outputs']) -> DenseLayer:
    """Return the layer x ↦ A(Lx + b)."""
    columns = layer.product(np.eye(layer.input_size)).T
    return DenseLayer(after @ columns, after @ layer.bias)


def _wrapped(layers: Sequence[Layer], enter: tuple, leave: tuple) -> list[Layer]:
    wrapped = list(layers)
    wrapped[0] = wrapped[0].after(*enter)
    wrapped[-1] = wrapped[-1].before(*leave)
    return wrapped


def _in_chunks(
    network: Perceptron, x: Float[np.ndarray, '*batch inputs']
) -> Float[np.ndarray, '*batch outputs']:
    if x.ndim == 1:
        return network.value(x)
    rows = x.reshape(-1, x.shape[-1])
    value = np.empty((len(rows), network.output_size))
    for start in range(0, len(rows), _CHUNK):
        value[start : start + _CHUNK] = network.value(rows[start : start + _CHUNK])
    return value.reshape(*x.shape[:-1], network.output_size)
