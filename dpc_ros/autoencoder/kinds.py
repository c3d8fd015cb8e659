"""The kinds of autoencoders: what a checkpoint or a recipe names by one word."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any, NamedTuple

from dpc_ros.autoencoder.architecture import (
    FlatArchitecture,
    GraphArchitecture,
    PluginArchitecture,
    PodArchitecture,
)
from dpc_ros.autoencoder.base import Autoencoder
from dpc_ros.autoencoder.flat import FlatAutoencoder
from dpc_ros.autoencoder.graph import GraphAutoencoder
from dpc_ros.autoencoder.pod import PodAutoencoder

ENTRY_POINT_GROUP = 'dpc_ros.autoencoders'


class KindError(ValueError):
    """A kind that is neither built in nor registered: what came, what there is, what to do."""


class Kind(NamedTuple):
    """How the checkpoints of one kind become autoencoders.

    Attributes:
        architecture: class of the sizes that a checkpoint stores.
        autoencoder: sizes and tensors → the autoencoder for online use; raises ValueError.
    """

    architecture: Callable[..., Any]
    autoencoder: Callable[[Any, Any], Autoencoder]


_BUILT_IN = {
    'flat': Kind(FlatArchitecture, FlatAutoencoder.from_tensors),
    'graph': Kind(GraphArchitecture, GraphAutoencoder.from_tensors),
    'pod': Kind(PodArchitecture, PodAutoencoder.from_tensors),
}


def load_kind(name: str) -> Kind:
    """Return a kind by its name; one that a package registers brings torch along.

    Raises:
        KindError: there is none of that name.
    """
    check_kind(name)
    return _BUILT_IN[name] if name in _BUILT_IN else Kind(PluginArchitecture, _from_plugin)


def check_kind(name: str) -> None:
    """Make sure that a kind is built in or registered.

    Raises:
        KindError: it is neither.
    """
    # To look for others reads a file of every package that is installed. A name out of a file may
    # be no text, and then no key.
    if name in [*_BUILT_IN]:
        return
    known = [*_BUILT_IN, *_registered()]
    if name not in known:
        raise KindError(
            f'kind {name!r}: expected one of {known}; one of another package is there once that '
            f'package is installed with an entry point in the group {ENTRY_POINT_GROUP!r}'
        )


def load_plugin(name: str) -> Callable[..., Any]:
    """Return the class that a package registers by a name.

    Raises:
        KindError: there is none of that name, or it can't be imported.
    """
    check_kind(name)
    point = _registered()[name]
    try:
        return point.load()
    except Exception as error:  # whatever goes wrong in code that is not ours
        raise KindError(f'kind {name!r}: {point.value} can not be loaded, {error}') from error


def _registered() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}


def _from_plugin(architecture: PluginArchitecture, tensors: Any) -> Autoencoder:
    from dpc_ros.autoencoder.plugin import PluginAutoencoder  # torch

    return PluginAutoencoder.from_tensors(architecture, tensors)
