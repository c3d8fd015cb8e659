"""What people look at: bodies in colour, the page of a log, the live viewer; no ROS."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
