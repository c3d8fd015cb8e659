"""The compressed Hamiltonian system: the body's mechanics in latent coordinates."""

from dpc_ros.reduction.compressed_system import CompressedSystem

__all__ = ['CompressedSystem']
