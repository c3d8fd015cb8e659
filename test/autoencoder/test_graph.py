"""Convolutions are SAGE's by independent implementations; the export is the module, exactly."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.autoencoder import Checkpoint, load_checkpoint, save_checkpoint
from dpc_ros.autoencoder.architecture import GraphArchitecture, PodArchitecture
from dpc_ros.autoencoder.graph_module import GraphModule, NeighbourMean, SageConvolution
from dpc_ros.autoencoder.layers import GraphLayer, neighbour_mean
from dpc_ros.autoencoder.pod_module import PodModule

# torch_geometric compiles a few functions by it when it is imported.
pytestmark = pytest.mark.filterwarnings('ignore:`torch.jit.script`:DeprecationWarning')

NODES = 7
# Node 6 has no neighbours; one edge is there twice, once in either direction.
EDGES = np.array([[0, 1], [1, 2], [2, 0], [0, 2], [3, 4], [4, 5], [1, 5]])
KINDS = [(activation, skip) for activation in ('elu', 'silu') for skip in (False, True)]
ACTIVATIONS = {'elu': torch.nn.functional.elu, 'silu': torch.nn.functional.silu}


def neighbours_of(node, edges=EDGES):
    return {int(b) for a, b in edges if a == node} | {int(a) for a, b in edges if b == node}


def random_layer(seed, inputs=3, outputs=4):
    draw = np.random.default_rng(seed)
    return GraphLayer(
        neighbour_mean(EDGES, NODES),
        draw.normal(size=(outputs, inputs)),
        draw.normal(size=(outputs, inputs)),
        draw.normal(size=NODES * outputs),
    )


def random_convolution(seed, edges=EDGES, inputs=3, outputs=4):
    torch.manual_seed(seed)
    return SageConvolution(inputs, outputs, NeighbourMean(edges, NODES)).double()


@pytest.fixture(scope='module')
def make_graph_module(small_network, small_configurations):
    """Return a function: a module of small random networks, normalised, in double precision."""

    def make(activation='silu', skip=True):
        torch.manual_seed(0)
        architecture = GraphArchitecture(
            small_network.configuration_size, 3, 6, 3, 4, activation, skip
        )
        module = GraphModule(architecture, small_network.mobile_edges)
        module.fit_normalisation(small_configurations)
        module.normalise_latents(small_configurations)
        return module.double()

    return make


@pytest.fixture(params=KINDS, ids=lambda kind: f'{kind[0]}-{"skip" if kind[1] else "plain"}')
def module(request, make_graph_module):
    return make_graph_module(*request.param)


@pytest.fixture
def point(small_configurations):
    """A configuration, a velocity, a latent state and a weight of each coordinate."""
    draw = np.random.default_rng(1)
    q = small_configurations[7]
    return q, draw.normal(size=q.size), draw.normal(size=3), draw.normal(size=q.size)


def assert_same_gradients(first, second, rtol=1e-10):
    for ours, theirs in zip(first, second, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=rtol, atol=1e-12)


def test_mean_is_taken_over_neighbours_each_counted_once():
    mean = neighbour_mean(EDGES, NODES).toarray()
    for node in range(NODES):
        joined = neighbours_of(node)
        expected = [1 / len(joined) if other in joined else 0.0 for other in range(NODES)]
        np.testing.assert_allclose(mean[node], expected, rtol=1e-15)
    assert not mean[6].any()


@pytest.mark.parametrize('seed', range(3))
def test_layer_is_the_formula_node_by_node(seed):
    layer = random_layer(seed)
    x = np.random.default_rng(seed).normal(size=(2, 5, NODES * 3))
    value = layer.value(x).reshape(2, 5, NODES, 4)
    for i, j in np.ndindex(2, 5):
        features = x[i, j].reshape(NODES, 3)
        for node in range(NODES):
            expected = layer.root_weight @ features[node] + layer.bias.reshape(NODES, 4)[node]
            for other in neighbours_of(node):
                expected += layer.neighbour_weight @ features[other] / len(neighbours_of(node))
            np.testing.assert_allclose(value[i, j, node], expected, rtol=1e-12, atol=1e-13)


def test_product_is_linear_part_and_adjoint_its_transpose():
    layer = random_layer(0)
    matrix = layer.product(np.eye(layer.input_size)).T
    assert matrix.shape == (layer.output_size, layer.input_size)
    np.testing.assert_allclose(layer.value(np.zeros(layer.input_size)), layer.bias)
    transposed = np.stack([layer.adjoint_product(row) for row in np.eye(layer.output_size)])
    np.testing.assert_allclose(transposed, matrix, rtol=1e-13, atol=1e-14)


def test_scales_and_shifts_can_be_folded_in():
    layer, draw = random_layer(1), np.random.default_rng(1)
    x, shift = draw.normal(size=(2, layer.input_size))
    offset = draw.normal(size=layer.output_size)
    folded = layer.after(0.7, shift).value(x)
    np.testing.assert_allclose(folded, layer.value(0.7 * x + shift), rtol=1e-12)
    folded = layer.before(0.7, offset).value(x)
    np.testing.assert_allclose(folded, 0.7 * layer.value(x) + offset, rtol=1e-12, atol=1e-14)


def gradients(loss, convolution, x):
    return torch.autograd.grad(
        loss,
        [x, convolution.neighbour.weight, convolution.root.weight, convolution.root.bias],
    )


@pytest.mark.parametrize('seed', range(3))
def test_convolution_is_the_dense_one_of_pytorch_geometric(seed):
    from torch_geometric.nn import DenseSAGEConv

    ours = random_convolution(seed)
    theirs = DenseSAGEConv(3, 4).double()
    theirs.lin_rel.weight = ours.neighbour.weight
    theirs.lin_root.weight, theirs.lin_root.bias = ours.root.weight, ours.root.bias
    x = torch.randn(5, NODES, 3, dtype=torch.float64, requires_grad=True)
    weight = torch.randn(5, NODES, 4, dtype=torch.float64)
    adjacency = torch.zeros(NODES, NODES, dtype=torch.float64)
    for node in range(NODES):
        adjacency[node, list(neighbours_of(node))] = 1
    value = ours(x.transpose(0, 1)).transpose(0, 1)
    expected = theirs(x, adjacency)
    torch.testing.assert_close(value, expected, rtol=1e-12, atol=1e-13)
    assert_same_gradients(
        gradients((value * weight).sum(), ours, x), gradients((expected * weight).sum(), ours, x)
    )


@pytest.mark.parametrize('seed', range(3))
def test_convolution_is_the_sparse_one_of_pytorch_geometric(seed):
    from torch_geometric.nn import SAGEConv

    ours = random_convolution(seed)
    theirs = SAGEConv(3, 4, aggr='mean').double()
    theirs.lin_l.weight, theirs.lin_l.bias = ours.neighbour.weight, ours.root.bias
    theirs.lin_r.weight = ours.root.weight
    joined = [(other, node) for node in range(NODES) for other in neighbours_of(node)]
    x = torch.randn(NODES, 3, dtype=torch.float64, requires_grad=True)
    weight = torch.randn(NODES, 4, dtype=torch.float64)
    value = ours(x[:, None])[:, 0]
    expected = theirs(x, torch.tensor(joined).T)
    torch.testing.assert_close(value, expected, rtol=1e-12, atol=1e-13)
    assert_same_gradients(
        gradients((value * weight).sum(), ours, x), gradients((expected * weight).sum(), ours, x)
    )


@given(st.permutations(range(NODES)), st.integers(0, 100))
def test_numbering_of_the_nodes_does_not_matter(order, seed):
    order = np.array(order)
    place = np.argsort(order)  # node i becomes place[i]
    convolution = random_convolution(seed)
    renumbered = random_convolution(seed, place[EDGES])
    x = torch.randn(NODES, 2, 3, dtype=torch.float64)
    torch.testing.assert_close(renumbered(x[order]), convolution(x)[order])


def test_encoder_and_decoder_are_their_layers_one_by_one(module, small_configurations):
    # What the module multiplies out beforehand, plainly and by torch's own gradients.
    architecture = module.architecture
    mean = torch.from_numpy(neighbour_mean(module.edges.numpy(), architecture.nodes).toarray())
    activation = ACTIVATIONS[architecture.activation]

    def convolve(convolutions, hidden):
        for i, convolution in enumerate(convolutions):
            hidden = activation(hidden) if i else hidden
            hidden = convolution.root(hidden) + convolution.neighbour(mean @ hidden)
        return hidden

    def encode(x):
        hidden = convolve(module.encoder.convolutions, x.reshape(len(x), -1, 2))
        return module.encoder.graph(module.encoder.node(hidden).flatten(1))

    def decode(latent):
        hidden = module.decoder.graph(latent).reshape(len(latent), architecture.nodes, -1)
        return module.decoder.node(convolve(module.decoder.convolutions, hidden)).flatten(1)

    torch.manual_seed(3)
    for network, reference, x in (
        (module.encoder, encode, torch.from_numpy(small_configurations[:5])),
        (module.decoder, decode, torch.randn(5, 3, dtype=torch.float64)),
    ):
        x.requires_grad_(True)
        value, expected = network(x), reference(x)
        torch.testing.assert_close(value, expected, rtol=1e-10, atol=1e-12)
        weight = torch.randn_like(value)
        wanted = [x, *network.parameters()]
        assert_same_gradients(
            torch.autograd.grad((value * weight).sum(), wanted),
            torch.autograd.grad((expected * weight).sum(), wanted),
            rtol=1e-8,
        )


def test_the_paper_has_54217_parameters(paper_2):
    module = GraphModule(GraphArchitecture(400, 5), paper_2.mobile_edges)
    assert sum(parameter.numel() for parameter in module.parameters()) == 54217


def test_export_is_the_module(module, small_configurations):
    autoencoder = module.export()
    with torch.no_grad():
        latent = module.encode(torch.from_numpy(small_configurations))
        configuration = module.decode(latent)
    np.testing.assert_allclose(autoencoder.encode(small_configurations), latent, atol=1e-10)
    np.testing.assert_allclose(autoencoder.decode(latent.numpy()), configuration, atol=1e-10)
    np.testing.assert_allclose(latent.mean(axis=0), 0, atol=1e-10)
    np.testing.assert_allclose(latent.std(axis=0, correction=0), 1, atol=1e-10)


def test_any_leading_dimensions(module, small_configurations):
    autoencoder = module.export()
    q = small_configurations[:12].reshape(3, 4, -1)
    latent = autoencoder.encode(q)
    decoded, jacobian = autoencoder.decode_with_jacobian(latent)
    assert latent.shape == (3, 4, 3)
    for place in np.ndindex(3, 4):
        np.testing.assert_allclose(autoencoder.encode(q[place]), latent[place], atol=1e-12)
        np.testing.assert_allclose(autoencoder.decode(latent[place]), decoded[place], atol=1e-12)
        single = autoencoder.decoder_jacobian(latent[place])
        np.testing.assert_allclose(single, jacobian[place], atol=1e-12)


def test_encoder_moves_with_the_configuration(module, point):
    q, velocity, _, _ = point
    latent, latent_velocity = module.export().encoder_jacobian_vector_product(q, velocity)
    at = torch.from_numpy(q)[None]
    jacobian = torch.autograd.functional.jacobian(lambda x: module.encode(x)[0], at)[:, 0]
    np.testing.assert_allclose(latent, module.encode(at)[0].detach(), atol=1e-10)
    np.testing.assert_allclose(latent_velocity, jacobian.numpy() @ velocity, atol=1e-10)


def test_decoder_jacobian(module, point):
    at = torch.from_numpy(point[2])[None]
    expected = torch.autograd.functional.jacobian(lambda xi: module.decode(xi)[0], at)[:, 0]
    np.testing.assert_allclose(module.export().decoder_jacobian(point[2]), expected, atol=1e-10)


def test_decoder_curvature(module, point, central_difference):
    _, _, latent, weight = point
    autoencoder = module.export()
    curvature = autoencoder.decoder_curvature(latent, weight)
    expected = central_difference(lambda xi: weight @ autoencoder.decoder_jacobian(xi), latent)
    np.testing.assert_allclose(curvature, expected, rtol=1e-6, atol=1e-8)
    assert np.abs(curvature).max() > 1e-6


def test_second_derivative_along_a_velocity(module, assert_second_derivative):
    assert_second_derivative(module.export())


def test_graphs_are_not_compiled(module):
    assert module.export().compiled_decoder() is None


def test_second_derivatives_of_the_module_are_refused_not_wrong(make_graph_module):
    latent = torch.zeros(1, 3, dtype=torch.float64)
    for activation in ACTIVATIONS:
        module = make_graph_module(activation)
        with pytest.raises(RuntimeError, match='can be differentiated once only'):
            torch.autograd.functional.hessian(lambda xi, m=module: m.decode(xi).sum(), latent)


def test_a_checkpoint_keeps_every_bit(
    make_graph_module, small_network, small_configurations, tmp_path
):
    network = {'name': small_network.name, 'digest': small_network.digest}
    pod = PodModule(PodArchitecture(small_network.configuration_size, 3))
    pod.fit_normalisation(small_configurations)
    for module in (make_graph_module(), make_graph_module('elu', False), pod):
        kind = module.architecture.kind
        saved = Checkpoint(f'grid_{kind}', module.architecture, module.tensors(), network)
        loaded = load_checkpoint(save_checkpoint(saved, tmp_path))
        assert loaded.architecture == module.architecture
        assert loaded.tensors.keys() == saved.tensors.keys()
        for name, value in saved.tensors.items():
            assert loaded.tensors[name].dtype == value.dtype
            assert loaded.tensors[name].tobytes() == value.tobytes()
        before, after = module.export(), loaded.autoencoder()
        latent = before.encode(small_configurations)
        np.testing.assert_array_equal(after.encode(small_configurations), latent)
        np.testing.assert_array_equal(after.decode(latent), before.decode(latent))


@pytest.mark.parametrize(
    ('edges', 'message'),
    [
        ([[0, 1], [1, NODES]], rf'expected nodes 0 to {NODES - 1}, got 0…{NODES}'),
        ([[0, -1]], rf'expected nodes 0 to {NODES - 1}, got -1…0'),
        ([0, 1], r'pairs of nodes, \(edges, 2\), got shape \(2,\)'),
        ([[0, 1, 2]], r'pairs of nodes, \(edges, 2\), got shape \(1, 3\)'),
    ],
)
def test_bad_edges_are_refused(edges, message):
    with pytest.raises(ValueError, match=message):
        neighbour_mean(np.array(edges), NODES)
    with pytest.raises(ValueError, match=message):
        GraphModule(GraphArchitecture(2 * NODES, 2), np.array(edges))


def test_a_graph_without_edges_has_no_means():
    edges = np.empty((0, 2), int)
    assert not neighbour_mean(edges, NODES).toarray().any()
    module = GraphModule(GraphArchitecture(2 * NODES, 2, 4, 2, 3), edges).double()
    x = torch.randn(3, 2 * NODES, dtype=torch.float64)
    expected = module(x).detach()
    autoencoder = module.export()
    reconstructed = autoencoder.decode(autoencoder.encode(x.numpy()))
    np.testing.assert_allclose(reconstructed, expected, atol=1e-12)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (lambda t: t.pop('edges'), "the tensor 'edges' is missing"),
        (lambda t: t.update(edges=t['edges'].astype(float)), 'edges: expected pairs of whole'),
        (lambda t: t.update(edges=t['edges'] + 9), 'edges: expected nodes 0 to 11'),
        (lambda t: t.pop('encoder.node.bias'), r"'encoder\.node\.bias' is missing"),
        (lambda t: t.update(extra=np.ones(2)), r"expected no tensors \['extra'\]"),
        (lambda t: t.update({'decoder.graph.bias': np.ones(2)}), r'decoder\.graph\.bias: expected'),
    ],
)
def test_bad_tensors_are_refused(make_graph_module, change, message):
    module = make_graph_module()
    tensors = module.tensors()
    change(tensors)
    with pytest.raises(ValueError, match=message):
        type(module.export()).from_tensors(module.architecture, tensors)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'configuration_size': 13}, 'two coordinates a node, got 13'),
        ({'convolutions': 1}, 'convolutions: expected at least 2, got 1'),
        ({'channels': 0}, 'positive whole sizes'),
        ({'node_features': 2.5}, 'positive whole sizes'),
        ({'activation': 'relu'}, "activation 'relu'"),
        ({'skip': 1}, 'skip: expected true or false'),
    ],
)
def test_bad_architectures_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        replace(GraphArchitecture(2 * NODES, 2), **changes)
