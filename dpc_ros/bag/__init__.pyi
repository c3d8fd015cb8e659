"""Logs of runs: rosbag2 bags written and read without ROS, and the convergence they show."""

from .convergence import Convergence, Energy, Goal, analyse, goals_in_force
from .convergence_table import course, summary, table
from .figure import draw
from .information import Information, inform
from .mcap_file import (
    Contents,
    Message,
    RawMessage,
    read_contents,
    read_messages,
    read_raw,
    read_topics,
)
from .metadata import (
    COMMAND_RECORD,
    LOSSES_RECORD,
    MACHINE_RECORD,
    MODELS_RECORD,
    NODE_PARAMETERS_RECORD,
    PARAMETERS_RECORD,
    VERSIONS_RECORD,
)
from .reader import Run, Target, read_run
from .signals import Deviation
from .splits import BagError
from .timing import Timing, measure_timing
from .topic import QosProfile, Topic
from .writer import BagWriter, further_folder

__all__ = [
    'COMMAND_RECORD',
    'LOSSES_RECORD',
    'MACHINE_RECORD',
    'MODELS_RECORD',
    'NODE_PARAMETERS_RECORD',
    'PARAMETERS_RECORD',
    'VERSIONS_RECORD',
    'BagError',
    'BagWriter',
    'Contents',
    'Convergence',
    'Deviation',
    'Energy',
    'Goal',
    'Information',
    'Message',
    'QosProfile',
    'RawMessage',
    'Run',
    'Target',
    'Timing',
    'Topic',
    'analyse',
    'course',
    'draw',
    'further_folder',
    'goals_in_force',
    'inform',
    'measure_timing',
    'read_contents',
    'read_messages',
    'read_raw',
    'read_run',
    'read_topics',
    'summary',
    'table',
]
