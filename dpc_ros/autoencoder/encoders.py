"""The encoders that go with a decoder: the one trained with it, or the projection."""

from __future__ import annotations

from dpc_ros.autoencoder.base import Autoencoder

ENCODERS = ('network', 'projection')
ITERATIONS = 20  # of the projection


def with_encoder(
    autoencoder: Autoencoder, encoder: str, iterations: int = ITERATIONS
) -> Autoencoder:
    """Return an autoencoder with its trained encoder (`network`) or the projection in its place.

    Args:
        autoencoder: a trained one.
        encoder: one of `ENCODERS`.
        iterations: steps of the projection at most.

    Raises:
        ValueError: there is no such encoder, or iterations is not positive.
    """
    if encoder not in ENCODERS:
        raise ValueError(f'encoder {encoder!r}: expected one of {ENCODERS}')
    if encoder == 'network':
        return autoencoder
    from dpc_ros.autoencoder.projection import ProjectionAutoencoder  # with scipy's solvers

    return ProjectionAutoencoder(autoencoder, iterations)
