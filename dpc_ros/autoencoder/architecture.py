"""Sizes and kind of an autoencoder, apart from its weights."""

from __future__ import annotations

from dataclasses import dataclass

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

    Raises:
        ValueError: a size is not positive, the activation is unknown, or skip is no bool.
    """

    configuration_size: int
    latent_size: int
    hidden_sizes: tuple[int, ...] = (300, 200, 100)
    activation: str = 'elu'
    skip: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, 'hidden_sizes', tuple(self.hidden_sizes))
        sizes = (self.configuration_size, self.latent_size, *self.hidden_sizes)
        if not all(isinstance(size, int) and size > 0 for size in sizes):
            raise ValueError(f'architecture: expected positive whole sizes, got {sizes}')
        if not isinstance(self.skip, bool):
            raise ValueError(f'skip: expected true or false, got {self.skip!r}')
        if self.activation not in ACTIVATIONS:
            raise ValueError(
                f'activation {self.activation!r}: expected one of {sorted(ACTIVATIONS)}'
            )
