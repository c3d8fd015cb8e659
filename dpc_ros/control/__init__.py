"""Control of the body through its latent coordinates."""

from dpc_ros.control.closed_loop import ClosedLoopRun, run_closed_loop
from dpc_ros.control.equilibrium import (
    EquilibriumError,
    FeedForward,
    feed_forward,
    reduced_equilibrium,
)
from dpc_ros.control.laws import LAWS, ControlLaw, PaperLaw, ReducedEquilibriumLaw, make_law
from dpc_ros.control.schedule import TargetSchedule
from dpc_ros.control.static_bound import (
    ConstantForce,
    StaticBound,
    nearest_equilibrium,
    static_bound,
)
from dpc_ros.control.targets import Target, TargetError, load_target

__all__ = [
    'LAWS',
    'ClosedLoopRun',
    'ConstantForce',
    'ControlLaw',
    'EquilibriumError',
    'FeedForward',
    'PaperLaw',
    'ReducedEquilibriumLaw',
    'StaticBound',
    'Target',
    'TargetError',
    'TargetSchedule',
    'feed_forward',
    'load_target',
    'make_law',
    'nearest_equilibrium',
    'reduced_equilibrium',
    'run_closed_loop',
    'static_bound',
]
