"""Control of the body through its latent coordinates."""

from dpc_ros.control.answers import Answers
from dpc_ros.control.background import BackgroundSolver
from dpc_ros.control.closed_loop import ClosedLoopRun, Imperfections, run_closed_loop
from dpc_ros.control.constant_force import (
    ConstantForce,
    StaticBound,
    nearest_equilibrium,
    static_bound,
)
from dpc_ros.control.controllers import Controllers
from dpc_ros.control.delay import DelayMeter
from dpc_ros.control.equilibrium import (
    EquilibriumError,
    FeedForward,
    feed_forward,
    reduced_equilibrium,
)
from dpc_ros.control.law import ControlLaw, LawSettings
from dpc_ros.control.laws import PaperLaw, ReducedEquilibriumLaw, TransposeLaw
from dpc_ros.control.observer import LatentObserver, ObserverSettings
from dpc_ros.control.online import OnlineController
from dpc_ros.control.online_encoder import OnlineEncoder
from dpc_ros.control.patience import Patience
from dpc_ros.control.registry import LAW_PARAMETERS, LAWS, check_law, make_law
from dpc_ros.control.regulator import QuadraticRegulator
from dpc_ros.control.saturation import approach
from dpc_ros.control.schedule import TargetSchedule
from dpc_ros.control.stamps import LONGEST_GAP
from dpc_ros.control.targets import Target, TargetError, load_target

__all__ = [
    'LAWS',
    'LAW_PARAMETERS',
    'LONGEST_GAP',
    'Answers',
    'BackgroundSolver',
    'ClosedLoopRun',
    'ConstantForce',
    'ControlLaw',
    'Controllers',
    'DelayMeter',
    'EquilibriumError',
    'FeedForward',
    'Imperfections',
    'LatentObserver',
    'LawSettings',
    'ObserverSettings',
    'OnlineController',
    'OnlineEncoder',
    'PaperLaw',
    'Patience',
    'QuadraticRegulator',
    'ReducedEquilibriumLaw',
    'StaticBound',
    'Target',
    'TargetError',
    'TargetSchedule',
    'TransposeLaw',
    'approach',
    'check_law',
    'feed_forward',
    'load_target',
    'make_law',
    'nearest_equilibrium',
    'reduced_equilibrium',
    'run_closed_loop',
    'static_bound',
]
