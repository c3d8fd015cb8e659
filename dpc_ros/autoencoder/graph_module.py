"""The graph autoencoder as a torch module: what is trained, and its export for online use.

Node features are kept as (nodes, batch, channels): the mean over neighbours is then one product
with a sparse matrix, and a convolution two products with dense ones. Maps that are linear in a row
are multiplied out before they meet the batch, as in `GraphAutoencoder`, and memory is written
once where torch's own operators would write it several times: training takes a third of the time
that dense SAGE layers take one by one (test/benchmarks/graph_training.py).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn

from dpc_ros.autoencoder.architecture import GraphArchitecture
from dpc_ros.autoencoder.graph import GraphAutoencoder
from dpc_ros.autoencoder.layers import neighbour_mean
from dpc_ros.autoencoder.module import AutoencoderModule


class GraphModule(AutoencoderModule):
    """SAGE convolutions with mean aggregation and single linear projections (section A.2).

    Args:
        architecture: sizes.
        edges: pairs of mobile masses that are joined, (edges, 2), as the network counts them.

    Raises:
        ValueError: an edge names a node that does not exist.
    """

    architecture: GraphArchitecture
    edges: Tensor

    def __init__(self, architecture: GraphArchitecture, edges: np.ndarray) -> None:
        super().__init__(architecture)
        self.register_buffer('edges', torch.from_numpy(np.array(edges, np.int64)))
        mean = NeighbourMean(edges, architecture.nodes)
        self.encoder = GraphEncoder(architecture, mean)
        self.decoder = GraphDecoder(architecture, mean)

    def export(self) -> GraphAutoencoder:
        """Return the same maps for online use."""
        return GraphAutoencoder.from_tensors(self.architecture, self.tensors())


class NeighbourMean:
    """The mean over the neighbours of each node, and its adjoint, on (nodes, …) tensors."""

    def __init__(self, edges: np.ndarray, nodes: int) -> None:
        matrix = neighbour_mean(edges, nodes)
        self._forward = {torch.float64: _sparse(matrix)}
        self._adjoint = {torch.float64: _sparse(matrix.T.tocsr())}

    def __call__(self, x: Tensor) -> Tensor:
        """Return the mean, differentiably."""
        return _Mean.apply(x, self)

    def forward(self, x: Tensor) -> Tensor:
        """Return the mean of the neighbours' values, of the shape of x."""
        return _product(self._forward, x)

    def adjoint(self, x: Tensor) -> Tensor:
        """Return the transposed mean, of the shape of x."""
        return _product(self._adjoint, x)


class SageConvolution(nn.Module):
    """y_v = W_l mean_{u ∈ N(v)} x_u + W_r x_v + b, on (nodes, batch, channels)."""

    def __init__(self, inputs: int, outputs: int, mean: NeighbourMean) -> None:
        super().__init__()
        self.neighbour = nn.Linear(inputs, outputs, bias=False)
        self.root = nn.Linear(inputs, outputs)
        self.mean = mean

    def forward(self, x: Tensor) -> Tensor:
        """Return y."""
        return _Convolution.apply(
            x, self.neighbour.weight, self.root.weight, self.root.bias, self.mean
        )


class GraphEncoder(nn.Module):
    """Convolutions, then a node-wise and a graph-level projection; (batch, n) to (batch, m)."""

    def __init__(self, architecture: GraphArchitecture, mean: NeighbourMean) -> None:
        super().__init__()
        features, nodes = architecture.node_features, architecture.nodes
        self.convolutions = nn.ModuleList(
            SageConvolution(*channels, mean) for channels in architecture.encoder_channels
        )
        self.node = nn.Linear(architecture.channels, features)
        self.graph = nn.Linear(nodes * features, architecture.latent_size)
        self._activation = _ACTIVATIONS[architecture.activation]

    def forward(self, x: Tensor) -> Tensor:
        """Return the raw latents."""
        *convolutions, last = _typed(self.convolutions)
        hidden = x.reshape(len(x), -1, 2).transpose(0, 1).contiguous()
        for convolution in convolutions:
            hidden = self._activation(convolution(hidden))
        nodes, m = len(hidden), self.graph.out_features
        # Last convolution and both projections are linear: one map (nodes, channels, m).
        graph = self.graph.weight.view(m, nodes, -1)
        on_nodes = (graph @ self.node.weight).transpose(0, 1)
        transposed_mean = _AdjointMean.apply(on_nodes, last.mean)
        weight = transposed_mean @ last.neighbour.weight + on_nodes @ last.root.weight
        bias = (
            self.graph.bias + (graph @ self.node.bias).sum(1) + (on_nodes @ last.root.bias).sum(0)
        )
        return torch.bmm(hidden, weight.transpose(1, 2)).sum(0) + bias


class GraphDecoder(nn.Module):
    """A graph-level projection, convolutions, a node-wise projection; (batch, m) to (batch, n)."""

    def __init__(self, architecture: GraphArchitecture, mean: NeighbourMean) -> None:
        super().__init__()
        features, nodes = architecture.node_features, architecture.nodes
        self.graph = nn.Linear(architecture.latent_size, nodes * features)
        self.convolutions = nn.ModuleList(
            SageConvolution(*channels, mean) for channels in architecture.decoder_channels
        )
        self.node = nn.Linear(architecture.channels, 2)
        self._nodes = nodes
        self._activation = _ACTIVATIONS[architecture.activation]

    def forward(self, latent: Tensor) -> Tensor:
        """Return the normalised configuration."""
        first, *convolutions, last = _typed(self.convolutions)
        # Projection and first convolution are linear: one map (nodes, m, channels).
        enter = torch.cat([self.graph.weight, self.graph.bias[:, None]], dim=1)
        columns = enter.view(self._nodes, -1, enter.shape[1]).transpose(1, 2)
        weight = first.mean(columns) @ first.neighbour.weight.T + columns @ first.root.weight.T
        bias = weight[:, -1:] + first.root.bias
        latents = latent.expand(self._nodes, *latent.shape)
        hidden = self._activation(torch.baddbmm(bias, latents, weight[:, :-1]))
        for convolution in convolutions:
            hidden = self._activation(convolution(hidden))
        # Last convolution and projection: two channels out, so the mean is taken of those.
        neighbour = hidden @ (self.node.weight @ last.neighbour.weight).T
        root = hidden @ (self.node.weight @ last.root.weight).T
        bias = self.node.weight @ last.root.bias + self.node.bias
        return (last.mean(neighbour) + root + bias).transpose(0, 1).reshape(len(latent), -1)


class _Mean(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, mean: NeighbourMean) -> Tensor:
        ctx.mean = mean
        return mean.forward(x)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        return ctx.mean.adjoint(gradient), None


class _AdjointMean(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, mean: NeighbourMean) -> Tensor:
        ctx.mean = mean
        return mean.adjoint(x)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        return ctx.mean.forward(gradient), None


class _Convolution(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, x: Tensor, neighbour: Tensor, root: Tensor, bias: Tensor, mean: NeighbourMean
    ) -> Tensor:
        rows = x.reshape(-1, x.shape[-1])
        aggregated = mean.forward(x).reshape(rows.shape)
        y = rows @ root.T
        y.addmm_(aggregated, neighbour.T)
        y += bias
        ctx.mean, ctx.shape = mean, x.shape
        ctx.save_for_backward(rows, aggregated, neighbour, root)
        return y.view(*x.shape[:-1], -1)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        _refuse_second_derivatives()
        rows, aggregated, neighbour, root = ctx.saved_tensors
        g = gradient.reshape(-1, gradient.shape[-1])
        by_x = None
        if ctx.needs_input_grad[0]:
            by_x = ctx.mean.adjoint((g @ neighbour).view(ctx.shape)).view(rows.shape)
            by_x.addmm_(g, root)
            by_x = by_x.view(ctx.shape)
        return by_x, g.T @ aggregated, g.T @ rows, g.sum(0), None


class _Elu(torch.autograd.Function):
    """ELU with one exponential: its slope e^min(y, 0) is also its value where y < 0, less one."""

    @staticmethod
    def forward(ctx: Any, y: Tensor) -> Tensor:
        slope = y.clamp_max(0).exp_()
        ctx.save_for_backward(slope)
        return y.clamp_min(0).add_(slope).sub_(1)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        _refuse_second_derivatives()
        (slope,) = ctx.saved_tensors
        return gradient * slope


def _refuse_second_derivatives() -> None:
    # A gradient that is written by hand is no function of x to torch: its derivative would be zero.
    if torch.is_grad_enabled():
        raise RuntimeError(
            'a graph module can be differentiated once only: take second derivatives of its export'
        )


_ACTIVATIONS: dict[str, Callable[[Tensor], Tensor]] = {
    'elu': _Elu.apply,
    'silu': nn.functional.silu,
}


def _typed(convolutions: nn.ModuleList) -> list[SageConvolution]:
    return cast('list[SageConvolution]', list(convolutions))


def _sparse(matrix: Any) -> Tensor:
    with warnings.catch_warnings():
        warnings.filterwarnings('ignore', 'Sparse CSR tensor support is in beta', UserWarning)
        return torch.sparse_csr_tensor(
            torch.from_numpy(matrix.indptr.astype(np.int64)),
            torch.from_numpy(matrix.indices.astype(np.int64)),
            torch.from_numpy(matrix.data),
            matrix.shape,
            check_invariants=True,
        )


def _product(matrix: dict[torch.dtype, Tensor], x: Tensor) -> Tensor:
    if x.dtype not in matrix:
        matrix[x.dtype] = matrix[torch.float64].to(x.dtype)
    return torch.mm(matrix[x.dtype], x.reshape(len(x), -1)).view(x.shape)
