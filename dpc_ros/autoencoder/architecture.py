"""Sizes and kind of an autoencoder, apart from its weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from dpc_ros.autoencoder.activations import ACTIVATIONS


@dataclass(frozen=True)
class FlatArchitecture:
    """Sizes and kind of a flat autoencoder; the paper's defaults (section A.2).

    Attributes:
        configuration_size: n.
        latent_size: m.
        hidden_sizes: units of the encoder's hidden layers; the decoder mirrors them.
        activation: σ between layers.
        skip: centre and scale the data, and add linear POD maps around encoder and decoder, so
            that the networks learn only what POD leaves over.
        pod_size: how many POD coordinates the networks read and write instead of all n; zero for
            all n. Needs the skip, and at least m of them.

    Raises:
        ValueError: a size is not positive, the activation is unknown, skip is no bool, or pod_size
            does not fit.
    """

    kind: ClassVar[str] = 'flat'

    configuration_size: int
    latent_size: int
    hidden_sizes: tuple[int, ...] = (300, 200, 100)
    activation: str = 'elu'
    skip: bool = False
    pod_size: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, 'hidden_sizes', tuple(self.hidden_sizes))
        sizes = (self.configuration_size, self.latent_size, *self.hidden_sizes)
        _check(sizes, self.activation, self.skip)
        check_pod_size(self.pod_size, self.skip, self.latent_size, self.configuration_size)

    @property
    def sizes(self) -> list[int]:
        """Sizes of the encoder's vectors from what it reads to the latent."""
        read = self.pod_size or self.configuration_size
        return [read, *self.hidden_sizes, self.latent_size]

    @property
    def basis_size(self) -> int:
        """How many POD modes the checkpoint keeps."""
        return self.pod_size or (self.latent_size if self.skip else 0)


@dataclass(frozen=True)
class GraphArchitecture:
    """Sizes of a graph autoencoder; the paper's defaults (section A.2).

    Attributes:
        configuration_size: n, two coordinates a node.
        latent_size: m.
        channels: of each node between convolutions.
        convolutions: SAGE layers of the encoder, and as many of the decoder, at least two.
        node_features: of each node between node-wise and graph-level projection.
        activation: σ between convolutions (not after the last).
        skip: as of `FlatArchitecture`.

    Raises:
        ValueError: a size is not positive, the activation is unknown, or skip is no bool.
    """

    kind: ClassVar[str] = 'graph'
    pod_size: ClassVar[int] = 0  # a graph has nodes, not modes

    configuration_size: int
    latent_size: int
    channels: int = 50
    convolutions: int = 4
    node_features: int = 10
    activation: str = 'elu'
    skip: bool = False

    def __post_init__(self) -> None:
        sizes = [self.configuration_size, self.latent_size, self.channels, self.convolutions]
        _check([*sizes, self.node_features], self.activation, self.skip)
        if self.configuration_size % 2:
            raise ValueError(f'configuration_size: expected two coordinates a node, got {sizes[0]}')
        if self.convolutions < 2:
            raise ValueError(f'convolutions: expected at least 2, got {self.convolutions}')

    @property
    def nodes(self) -> int:
        """The number of nodes."""
        return self.configuration_size // 2

    @property
    def encoder_channels(self) -> list[tuple[int, int]]:
        """Channels into and out of each convolution of the encoder."""
        return [(2, self.channels), *self._inner_channels]

    @property
    def decoder_channels(self) -> list[tuple[int, int]]:
        """Channels into and out of each convolution of the decoder."""
        return [(self.node_features, self.channels), *self._inner_channels]

    @property
    def basis_size(self) -> int:
        """How many POD modes the checkpoint keeps."""
        return self.latent_size if self.skip else 0

    @property
    def _inner_channels(self) -> list[tuple[int, int]]:
        return [(self.channels, self.channels)] * (self.convolutions - 1)


@dataclass(frozen=True)
class PodArchitecture:
    """Sizes of proper orthogonal decomposition, the best linear autoencoder.

    Attributes:
        configuration_size: n.
        latent_size: m.

    Raises:
        ValueError: a size is not positive.
    """

    kind: ClassVar[str] = 'pod'
    skip: ClassVar[bool] = True
    pod_size: ClassVar[int] = 0
    activation: ClassVar[str] = 'elu'  # of no layer

    configuration_size: int
    latent_size: int

    def __post_init__(self) -> None:
        _check((self.configuration_size, self.latent_size), self.activation, self.skip)

    @property
    def basis_size(self) -> int:
        """How many POD modes the checkpoint keeps."""
        return self.latent_size


@dataclass(frozen=True)
class PluginArchitecture:
    """Sizes of an autoencoder that another package registers (docs/plugins.md).

    Attributes:
        kind: name of its entry point.
        configuration_size: n.
        latent_size: m.
        options: keyword arguments of its class.
        skip: as of `FlatArchitecture`.

    Raises:
        ValueError: a size is not positive, skip is no bool, or options are no mapping.
    """

    pod_size: ClassVar[int] = 0

    kind: str
    configuration_size: int
    latent_size: int
    options: dict[str, Any] = field(default_factory=dict)
    skip: bool = False

    def __post_init__(self) -> None:
        _check((self.configuration_size, self.latent_size), 'elu', self.skip)
        if not isinstance(self.options, dict):
            raise ValueError(f'options: expected names and values, got {self.options!r}')

    @property
    def basis_size(self) -> int:
        """How many POD modes the checkpoint keeps."""
        return self.latent_size if self.skip else 0


Architecture = FlatArchitecture | GraphArchitecture | PodArchitecture | PluginArchitecture


def check_pod_size(pod_size: int, skip: bool, least: int, most: float) -> None:
    """Make sure that a number of POD coordinates is zero or fits.

    Raises:
        ValueError: it does not.
    """
    if isinstance(pod_size, bool) or not isinstance(pod_size, int) or pod_size < 0:
        raise ValueError(f'pod_size: expected a whole number ≥ 0, got {pod_size!r}')
    if pod_size and not (skip and least <= pod_size <= most):
        raise ValueError(
            f'pod_size {pod_size}: expected skip and at least latent_size {least}, '
            f'at most configuration_size {most}'
        )


def _check(sizes: Sequence[int], activation: str, skip: bool) -> None:
    if not all(isinstance(size, int) and size > 0 for size in sizes):
        raise ValueError(f'architecture: expected positive whole sizes, got {sizes}')
    if not isinstance(skip, bool):
        raise ValueError(f'skip: expected true or false, got {skip!r}')
    if activation not in ACTIVATIONS:
        raise ValueError(f'activation {activation!r}: expected one of {sorted(ACTIVATIONS)}')
