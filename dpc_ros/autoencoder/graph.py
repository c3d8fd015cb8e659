"""The graph autoencoder, for online use."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from dpc_ros.autoencoder.architecture import GraphArchitecture
from dpc_ros.autoencoder.layered import LayeredAutoencoder, NamedTensors, fold_normalisation
from dpc_ros.autoencoder.layers import DenseLayer, GraphLayer, Layer, neighbour_mean

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class GraphAutoencoder(LayeredAutoencoder):
    """SAGE convolutions between node features, linear maps to and from the latents (section III).

    What is linear in a row is one layer here: the last convolution with the projections to the
    latents, the projection from the latents with the first convolution, and the last convolution
    with the projection to coordinates.
    """

    @classmethod
    def from_tensors(
        cls, architecture: GraphArchitecture, tensors: Mapping[str, np.ndarray]
    ) -> GraphAutoencoder:
        """Return the maps of `GraphModule`, every normalisation folded into the layers.

        Args:
            architecture: sizes.
            tensors: weights, edges and buffers by the names that the module gives them.

        Raises:
            ValueError: a tensor is missing or unknown, has another shape than the architecture
                says, is a scale that is not positive, or an edge names no node.
        """
        named = NamedTensors(tensors)
        mean = neighbour_mean(named.take_edges('edges'), architecture.nodes)
        maps = fold_normalisation(
            named,
            _encoder_layers(named, architecture, mean),
            _decoder_layers(named, architecture, mean),
            architecture,
        )
        named.check_all_taken()
        return cls(*maps)


def _encoder_layers(
    tensors: NamedTensors, architecture: GraphArchitecture, mean: csr_array
) -> list[Layer]:
    nodes, features, m = architecture.nodes, architecture.node_features, architecture.latent_size
    *layers, last = _convolutions(tensors, 'encoder', architecture.encoder_channels, mean)
    node_weight, node_bias = _linear(tensors, 'encoder.node', architecture.channels, features)
    weight, bias = _linear(tensors, 'encoder.graph', nodes * features, m)
    # Row by row through node projection and last convolution, backwards.
    on_nodes = (weight.reshape(m, nodes, features) @ node_weight).reshape(m, -1)
    bias = bias + weight @ np.tile(node_bias, nodes) + on_nodes @ last.bias
    return [*layers, DenseLayer(np.stack([last.adjoint_product(row) for row in on_nodes]), bias)]


def _decoder_layers(
    tensors: NamedTensors, architecture: GraphArchitecture, mean: csr_array
) -> list[Layer]:
    nodes, features, m = architecture.nodes, architecture.node_features, architecture.latent_size
    first, *layers, last = _convolutions(tensors, 'decoder', architecture.decoder_channels, mean)
    weight, bias = _linear(tensors, 'decoder.graph', m, nodes * features)
    node_weight, node_bias = _linear(tensors, 'decoder.node', architecture.channels, 2)
    enter = DenseLayer(first.product(weight.T).T, first.value(bias))
    node_bias = (last.bias.reshape(nodes, -1) @ node_weight.T + node_bias).ravel()
    leave = GraphLayer(
        mean, node_weight @ last.neighbour_weight, node_weight @ last.root_weight, node_bias
    )
    return [enter, *layers, leave]


def _convolutions(
    tensors: NamedTensors, part: str, channels: list[tuple[int, int]], mean: csr_array
) -> list[GraphLayer]:
    layers = []
    for i, (inputs, outputs) in enumerate(channels):
        name = f'{part}.convolutions.{i}'
        bias = tensors.take(f'{name}.root.bias', (outputs,))
        layers.append(
            GraphLayer(
                mean,
                tensors.take(f'{name}.neighbour.weight', (outputs, inputs)),
                tensors.take(f'{name}.root.weight', (outputs, inputs)),
                np.tile(bias, mean.shape[0]),
            )
        )
    return layers


def _linear(
    tensors: NamedTensors, name: str, inputs: int, outputs: int
) -> tuple[np.ndarray, np.ndarray]:
    weight = tensors.take(f'{name}.weight', (outputs, inputs))
    return weight, tensors.take(f'{name}.bias', (outputs,))
