"""Autoencoders between configurations q ∈ ℝⁿ and latent coordinates ξ ∈ ℝᵐ."""

from dpc_ros.autoencoder.base import Autoencoder
from dpc_ros.autoencoder.checkpoint import (
    Checkpoint,
    CheckpointError,
    load_checkpoint,
    save_checkpoint,
)
from dpc_ros.autoencoder.encoders import with_encoder
from dpc_ros.autoencoder.flat import FlatAutoencoder
from dpc_ros.autoencoder.graph import GraphAutoencoder
from dpc_ros.autoencoder.pod import PodAutoencoder
from dpc_ros.autoencoder.projection import ProjectionAutoencoder

__all__ = [
    'Autoencoder',
    'Checkpoint',
    'CheckpointError',
    'FlatAutoencoder',
    'GraphAutoencoder',
    'PodAutoencoder',
    'ProjectionAutoencoder',
    'load_checkpoint',
    'save_checkpoint',
    'with_encoder',
]
