"""The body: a planar mass-spring-damper network, its mechanics and its integration in time."""

from .body import Body
from .drawing import draw_figure, draw_network, draw_springs, picture_limits
from .generator import GeneratorSettings, generate_network
from .integration import INTEGRATORS, Integrator, Trajectory, simulate
from .many import simulate_many
from .mass_spring_network import (
    DAMPING_KINDS,
    MassSpringNetwork,
    NetworkError,
    load_network,
    save_network,
)
from .mechanics import NO_GRAVITY, Gravity, Mechanics

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
    'picture_limits',
    'save_network',
    'simulate',
    'simulate_many',
]
