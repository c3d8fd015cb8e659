"""The compressed Hamiltonian system: the body's mechanics in latent coordinates."""

from .compressed_system import CompressedSystem
from .simulation import (
    METHODS,
    DivergenceError,
    LatentTrajectory,
    UnsolvedStepError,
    rk4_step,
    simulate_compressed,
)

__all__ = [
    'METHODS',
    'CompressedSystem',
    'DivergenceError',
    'LatentTrajectory',
    'UnsolvedStepError',
    'rk4_step',
    'simulate_compressed',
]
