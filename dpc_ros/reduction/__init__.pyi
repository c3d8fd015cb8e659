"""The compressed Hamiltonian system: the body's mechanics in latent coordinates."""

from dpc_ros.reduction.compressed_system import CompressedSystem
from dpc_ros.reduction.simulation import (
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
