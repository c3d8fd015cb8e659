"""Simulated configurations that autoencoders learn from and are measured on."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
