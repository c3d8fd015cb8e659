"""One step of training of the paper's graph autoencoder: ours beside dense SAGE layers one by one.

Both get the same weights and the same batch, take turns in one process on one thread, and their
gradients are compared first. The ratio of the medians is what counts: the times are this machine's.
"""

import numpy as np
import torch
from side_by_side import row, side_by_side
from torch_geometric.nn import DenseSAGEConv

from dpc_ros.autoencoder.architecture import GraphArchitecture
from dpc_ros.autoencoder.graph_module import GraphModule
from dpc_ros.network import load_network

BATCH = 256
REPETITIONS = 15


class DenseSage(torch.nn.Module):
    """The same autoencoder of torch_geometric's layers, one after the other."""

    def __init__(self, module: GraphModule, edges: np.ndarray):
        super().__init__()
        self.module, self.nodes = module, module.architecture.nodes
        adjacency = torch.zeros(self.nodes, self.nodes)
        adjacency[edges[:, 0], edges[:, 1]] = adjacency[edges[:, 1], edges[:, 0]] = 1.0
        self.adjacency = adjacency
        self.inward = [dense(each) for each in module.encoder.convolutions]
        self.outward = [dense(each) for each in module.decoder.convolutions]

    def forward(self, q):
        encoder, decoder = self.module.encoder, self.module.decoder
        hidden = self.convolve(self.inward, q.view(len(q), self.nodes, 2))
        latent = encoder.graph(encoder.node(hidden).flatten(1))
        hidden = decoder.graph(latent).view(len(q), self.nodes, -1)
        return decoder.node(self.convolve(self.outward, hidden)).flatten(1)

    def convolve(self, layers, hidden):
        for layer in layers[:-1]:
            hidden = torch.nn.functional.elu(layer(hidden, self.adjacency))
        return layers[-1](hidden, self.adjacency)


def dense(convolution):
    """Return torch_geometric's layer with the weights of ours."""
    layer = DenseSAGEConv(convolution.root.in_features, convolution.root.out_features)
    layer.lin_rel.weight = convolution.neighbour.weight
    layer.lin_root.weight = convolution.root.weight
    layer.lin_root.bias = convolution.root.bias
    return layer


def gradients(forward, parameters, q):
    loss = torch.nn.functional.mse_loss(forward(q), q)
    return torch.autograd.grad(loss, parameters)


def measure():
    """Return the row of this benchmark."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    network = load_network('paper_2')
    ours = GraphModule(GraphArchitecture(400, 5), network.mobile_edges)
    peer = DenseSage(ours, network.mobile_edges)
    parameters = list(ours.parameters())
    q = torch.from_numpy(network.rest_configuration).float() + torch.randn(BATCH, 400)
    for mine, other in zip(
        gradients(ours, parameters, q), gradients(peer, parameters, q), strict=True
    ):
        torch.testing.assert_close(mine, other, rtol=1e-3, atol=1e-4 * float(other.abs().max()))
    medians = side_by_side(
        lambda: gradients(ours, parameters, q), lambda: gradients(peer, parameters, q), REPETITIONS
    )
    return [row('graph_training_step', 'torch_geometric.nn.DenseSAGEConv', *medians)]
