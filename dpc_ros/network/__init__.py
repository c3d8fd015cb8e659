"""The body: a planar mass-spring-damper network, its mechanics and its integration in time."""

from dpc_ros.network.body import Body
from dpc_ros.network.integration import INTEGRATORS, Integrator, Trajectory, simulate
from dpc_ros.network.mass_spring_network import (
    MassSpringNetwork,
    NetworkError,
    load_network,
    save_network,
)
from dpc_ros.network.mechanics import NO_GRAVITY, Gravity, Mechanics

__all__ = [
    'INTEGRATORS',
    'NO_GRAVITY',
    'Body',
    'Gravity',
    'Integrator',
    'MassSpringNetwork',
    'Mechanics',
    'NetworkError',
    'Trajectory',
    'load_network',
    'save_network',
    'simulate',
]
