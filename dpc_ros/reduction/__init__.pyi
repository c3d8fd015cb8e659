"""The compressed Hamiltonian system: the body's mechanics in latent coordinates."""

from .compressed_system import CompressedSystem
from .simulation import (
    METHODS,
    DivergenceError,
    LatentTrajectory,
    UnsolvedStepError,
    simulate_compressed,
)

__all__ = [
    'METHODS',
    'CompressedSystem',
    'DivergenceError',
    'LatentTrajectory',
    'UnsolvedStepError',
    'simulate_compressed',
]
