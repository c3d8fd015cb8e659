"""What people look at: bodies in colour, the page of a log, the live viewer; no ROS."""

from .colours import strain_colours

__all__ = ['strain_colours']
