"""Autoencoders between configurations q ∈ ℝⁿ and latent coordinates ξ ∈ ℝᵐ."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
