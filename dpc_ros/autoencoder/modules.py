"""The torch module that a recipe asks for."""

from __future__ import annotations

import torch

from dpc_ros.autoencoder.architecture import (
    FlatArchitecture,
    GraphArchitecture,
    PluginArchitecture,
    PodArchitecture,
)
from dpc_ros.autoencoder.flat_module import FlatModule
from dpc_ros.autoencoder.graph_module import GraphModule
from dpc_ros.autoencoder.module import AutoencoderModule
from dpc_ros.autoencoder.plugin import PluginModule
from dpc_ros.autoencoder.pod_module import PodModule
from dpc_ros.autoencoder.recipe import Recipe
from dpc_ros.network import MassSpringNetwork


def untrained_module(recipe: Recipe, network: MassSpringNetwork) -> AutoencoderModule:
    """Return the module that a recipe trains, its weights drawn by the recipe's seed."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(recipe.seed)
        return _BUILDERS.get(recipe.kind, _plugin)(recipe, network)


def _flat(recipe: Recipe, network: MassSpringNetwork) -> FlatModule:
    return FlatModule(
        FlatArchitecture(
            configuration_size=network.configuration_size,
            latent_size=recipe.latent_size,
            hidden_sizes=recipe.hidden_sizes,
            activation=recipe.activation,
            skip=recipe.skip,
            pod_size=recipe.pod_size,
        )
    )


def _graph(recipe: Recipe, network: MassSpringNetwork) -> GraphModule:
    architecture = GraphArchitecture(
        configuration_size=network.configuration_size,
        latent_size=recipe.latent_size,
        channels=recipe.channels,
        convolutions=recipe.convolutions,
        node_features=recipe.node_features,
        activation=recipe.activation,
        skip=recipe.skip,
    )
    return GraphModule(architecture, network.mobile_edges)


def _pod(recipe: Recipe, network: MassSpringNetwork) -> PodModule:
    return PodModule(PodArchitecture(network.configuration_size, recipe.latent_size))


def _plugin(recipe: Recipe, network: MassSpringNetwork) -> PluginModule:
    return PluginModule(
        PluginArchitecture(
            kind=recipe.kind,
            configuration_size=network.configuration_size,
            latent_size=recipe.latent_size,
            options=recipe.options,
            skip=recipe.skip,
        )
    )


_BUILDERS = {'flat': _flat, 'graph': _graph, 'pod': _pod}
