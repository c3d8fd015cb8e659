"""Simulated configurations that autoencoders learn from and are measured on."""

from dpc_ros.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
