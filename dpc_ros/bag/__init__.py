"""Logs of runs: rosbag2 bags written and read without ROS, and the convergence they show."""

from dpc_ros.bag.convergence import Convergence, Energy, analyse
from dpc_ros.bag.convergence_table import course, summary, table
from dpc_ros.bag.figure import draw
from dpc_ros.bag.mcap_file import BagError
from dpc_ros.bag.metadata import (
    COMMAND_RECORD,
    LOSSES_RECORD,
    MODELS_RECORD,
    NODE_PARAMETERS_RECORD,
    PARAMETERS_RECORD,
    VERSIONS_RECORD,
)
from dpc_ros.bag.reader import Run, Target, read_run
from dpc_ros.bag.topic import QosProfile, Topic
from dpc_ros.bag.writer import BagWriter

__all__ = [
    'COMMAND_RECORD',
    'LOSSES_RECORD',
    'MODELS_RECORD',
    'NODE_PARAMETERS_RECORD',
    'PARAMETERS_RECORD',
    'VERSIONS_RECORD',
    'BagError',
    'BagWriter',
    'Convergence',
    'Energy',
    'QosProfile',
    'Run',
    'Target',
    'Topic',
    'analyse',
    'course',
    'draw',
    'read_run',
    'summary',
    'table',
]
