"""Latent control of high-dimensional mechanical systems with autoencoders, on ROS 2."""

__version__ = '0.1.0'
