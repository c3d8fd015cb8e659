"""Autoencoders between configurations q ∈ ℝⁿ and latent coordinates ξ ∈ ℝᵐ."""

from dpc_ros.autoencoder.base import Autoencoder
from dpc_ros.autoencoder.checkpoint import (
    Checkpoint,
    CheckpointError,
    load_checkpoint,
    save_checkpoint,
)
from dpc_ros.autoencoder.flat import FlatAutoencoder

__all__ = [
    'Autoencoder',
    'Checkpoint',
    'CheckpointError',
    'FlatAutoencoder',
    'load_checkpoint',
    'save_checkpoint',
]
