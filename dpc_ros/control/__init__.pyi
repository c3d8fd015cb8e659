"""Control of the body through its latent coordinates."""

from .answers import Answers
from .background import BackgroundSolver
from .closed_loop import ClosedLoopRun, Imperfections, run_closed_loop
from .constant_force import (
    ConstantForce,
    StaticBound,
    nearest_equilibrium,
    static_bound,
)
from .controllers import Controllers
from .delay import DelayMeter
from .equilibrium import (
    EquilibriumError,
    FeedForward,
    feed_forward,
    pulled_equilibrium,
    reduced_equilibrium,
)
from .law import ControlLaw, LawSettings
from .laws import PaperLaw, ReducedEquilibriumLaw, TransposeLaw
from .observer import LatentObserver, ObserverSettings
from .online import OnlineController
from .online_encoder import OnlineEncoder
from .patience import Patience
from .registry import LAW_PARAMETERS, LAWS, check_law, make_law
from .regulator import QuadraticRegulator
from .saturation import approach
from .schedule import TargetSchedule
from .stamps import LONGEST_GAP
from .targets import Target, TargetError, load_target

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
    'pulled_equilibrium',
    'reduced_equilibrium',
    'run_closed_loop',
    'static_bound',
]
