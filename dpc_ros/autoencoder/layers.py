"""Affine layers, evaluated in float64: dense ones, and graph convolutions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Scale = float | Float[np.ndarray, ' size']


class Layer(ABC):
    """An affine map x ↦ Lx + b between flat vectors."""

    bias: Float[np.ndarray, ' outputs']

    @property
    @abstractmethod
    def input_size(self) -> int:
        """Return the size of x."""

    @property
    def output_size(self) -> int:
        """Return the size of Lx + b."""
        return len(self.bias)

    def value(self, x: Float[np.ndarray, '*batch inputs']) -> Float[np.ndarray, '*batch outputs']:
        """Return Lx + b for any leading dimensions."""
        return self.product(x) + self.bias

    @abstractmethod
    def product(
        self, tangent: Float[np.ndarray, '*batch inputs']
    ) -> Float[np.ndarray, '*batch outputs']:
        """Return Lt for any leading dimensions."""

    @abstractmethod
    def adjoint_product(
        self, adjoint: Float[np.ndarray, ' outputs']
    ) -> Float[np.ndarray, ' inputs']:
        """Return Lᵀa."""

    @abstractmethod
    def after(self, scale: Scale, shift: Float[np.ndarray, ' inputs']) -> Layer:
        """Return the layer x ↦ L(scale·x + shift) + b."""

    @abstractmethod
    def before(self, scale: Scale, offset: Float[np.ndarray, ' outputs']) -> Layer:
        """Return the layer x ↦ scale·(Lx + b) + offset."""


@dataclass(frozen=True, eq=False)
class DenseLayer(Layer):
    """An affine map with a full matrix."""

    weight: Float[np.ndarray, 'outputs inputs']
    bias: Float[np.ndarray, ' outputs']

    def __post_init__(self) -> None:
        object.__setattr__(self, 'weight', np.ascontiguousarray(self.weight, float))
        object.__setattr__(self, 'bias', np.ascontiguousarray(self.bias, float))

    @property
    def input_size(self) -> int:
        return self.weight.shape[1]

    def product(
        self, tangent: Float[np.ndarray, '*batch inputs']
    ) -> Float[np.ndarray, '*batch outputs']:
        # A product with a single vector is another routine of BLAS than one with rows.
        return self.weight @ tangent if tangent.ndim == 1 else tangent @ self.weight.T

    def adjoint_product(
        self, adjoint: Float[np.ndarray, ' outputs']
    ) -> Float[np.ndarray, ' inputs']:
        return adjoint @ self.weight

    def after(self, scale: Scale, shift: Float[np.ndarray, ' inputs']) -> DenseLayer:
        return DenseLayer(self.weight * scale, self.bias + self.weight @ shift)

    def before(self, scale: Scale, offset: Float[np.ndarray, ' outputs']) -> DenseLayer:
        column = scale[:, None] if isinstance(scale, np.ndarray) else scale
        return DenseLayer(self.weight * column, self.bias * scale + offset)


@dataclass(frozen=True, eq=False)
class GraphLayer(Layer):
    """A SAGE convolution with mean aggregation: y_v = W_r x_v + W_l mean_{u ∈ N(v)} x_u + b_v.

    Vectors hold the channels of node 0, then those of node 1, and so on. A node without
    neighbours has the mean zero. The bias may differ from node to node, so that a shift of the
    input can be folded into it; a scale that is folded in is one number.
    (Hamilton, Ying, Leskovec 2017, algorithm 1 with mean aggregator.)

    Attributes:
        mean: the mean over neighbours as a matrix, one row a node.
        neighbour_weight: W_l.
        root_weight: W_r.
        bias: b, nodes × outputs values.
    """

    mean: csr_array
    neighbour_weight: Float[np.ndarray, 'outputs inputs']
    root_weight: Float[np.ndarray, 'outputs inputs']
    bias: Float[np.ndarray, ' nodes*outputs']

    @property
    def nodes(self) -> int:
        """Return the number of nodes."""
        return self.mean.shape[0]

    @property
    def input_size(self) -> int:
        return self.nodes * self.root_weight.shape[1]

    def product(
        self, tangent: Float[np.ndarray, '*batch inputs']
    ) -> Float[np.ndarray, '*batch outputs']:
        batch = tangent.reshape(-1, self.nodes, self.root_weight.shape[1])
        # One row a node, so that the mean over neighbours is a single product.
        node = np.ascontiguousarray(batch.transpose(1, 0, 2))
        aggregated = (self.mean @ node.reshape(self.nodes, -1)).reshape(node.shape)
        product = node @ self.root_weight.T + aggregated @ self.neighbour_weight.T
        return product.transpose(1, 0, 2).reshape(*tangent.shape[:-1], self.output_size)

    def adjoint_product(
        self, adjoint: Float[np.ndarray, ' outputs']
    ) -> Float[np.ndarray, ' inputs']:
        node = adjoint.reshape(self.nodes, -1)
        aggregated = self.mean.T @ (node @ self.neighbour_weight)
        return (node @ self.root_weight + aggregated).ravel()

    def after(self, scale: Scale, shift: Float[np.ndarray, ' inputs']) -> GraphLayer:
        return self._scaled(float(scale), self.bias + self.product(shift))

    def before(self, scale: Scale, offset: Float[np.ndarray, ' outputs']) -> GraphLayer:
        return self._scaled(float(scale), self.bias * float(scale) + offset)

    def _scaled(self, scale: float, bias: Float[np.ndarray, ' outputs']) -> GraphLayer:
        return GraphLayer(self.mean, self.neighbour_weight * scale, self.root_weight * scale, bias)


def neighbour_mean(edges: np.ndarray, nodes: int) -> csr_array:
    """Return the matrix that takes the mean over the neighbours of each node.

    Args:
        edges: pairs of nodes, (edges, 2), each undirected edge once; a repeated one counts once.
        nodes: how many there are.

    Raises:
        ValueError: an edge names a node that does not exist, or the shape is another.
    """
    from scipy.sparse import csr_array  # of graphs alone, and slow to import

    edges = np.asarray(edges)
    if edges.ndim != 2 or edges.shape[1] != 2:
        raise ValueError(f'edges: expected pairs of nodes, (edges, 2), got shape {edges.shape}')
    if edges.size and not (edges.min() >= 0 and edges.max() < nodes):
        raise ValueError(f'edges: expected nodes 0 to {nodes - 1}, got {edges.min()}…{edges.max()}')
    both = np.unique(np.concatenate([edges, edges[:, ::-1]]), axis=0)
    degree = np.bincount(both[:, 0], minlength=nodes)
    return csr_array((1.0 / degree[both[:, 0]], (both[:, 0], both[:, 1])), shape=(nodes, nodes))
