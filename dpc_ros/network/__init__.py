"""The body: a planar mass-spring-damper network, its mechanics and its integration in time."""

from dpc_ros.network.body import Body
from dpc_ros.network.drawing import draw_figure, draw_network, draw_springs
from dpc_ros.network.generator import GeneratorSettings, generate_network
from dpc_ros.network.integration import INTEGRATORS, Integrator, Trajectory, simulate
from dpc_ros.network.many import simulate_many
from dpc_ros.network.mass_spring_network import (
    DAMPING_KINDS,
    MassSpringNetwork,
    NetworkError,
    load_network,
    save_network,
)
from dpc_ros.network.mechanics import NO_GRAVITY, Gravity, Mechanics

__all__ = [
    'DAMPING_KINDS',
    'INTEGRATORS',
    'NO_GRAVITY',
    'Body',
    'GeneratorSettings',
    'Gravity',
    'Integrator',
    'MassSpringNetwork',
    'Mechanics',
    'NetworkError',
    'Trajectory',
    'draw_figure',
    'draw_network',
    'draw_springs',
    'generate_network',
    'load_network',
    'save_network',
    'simulate',
    'simulate_many',
]
