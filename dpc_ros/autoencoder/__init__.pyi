"""Autoencoders between configurations q ∈ ℝⁿ and latent coordinates ξ ∈ ℝᵐ."""

from .base import Autoencoder
from .checkpoint import (
    Checkpoint,
    CheckpointError,
    load_checkpoint,
    save_checkpoint,
)
from .encoders import with_encoder
from .flat import FlatAutoencoder
from .graph import GraphAutoencoder
from .pod import PodAutoencoder
from .projection import ProjectionAutoencoder

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
