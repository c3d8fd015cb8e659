"""The body: a planar mass-spring-damper network, its mechanics and its integration in time."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
