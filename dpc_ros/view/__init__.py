"""Logs of runs: rosbag2 bags written and read without ROS, and the convergence they show."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
