"""Logs of runs: rosbag2 bags written and read without ROS, and the convergence they show."""

from dpc_ros.bag.convergence import Convergence, Energy, analyse
from dpc_ros.bag.convergence_table import course, summary, table
from dpc_ros.bag.figure import draw
from dpc_ros.bag.mcap_file import (
    Contents,
    Message,
    RawMessage,
    read_contents,
    read_messages,
    read_raw,
    read_topics,
)
from dpc_ros.bag.metadata import (
    COMMAND_RECORD,
    LOSSES_RECORD,
    MACHINE_RECORD,
    MODELS_RECORD,
    NODE_PARAMETERS_RECORD,
    PARAMETERS_RECORD,
    VERSIONS_RECORD,
)
from dpc_ros.bag.reader import Run, Target, read_run
from dpc_ros.bag.signals import Deviation
from dpc_ros.bag.splits import BagError
from dpc_ros.bag.topic import QosProfile, Topic
from dpc_ros.bag.writer import BagWriter, further_folder

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
    'Message',
    'QosProfile',
    'RawMessage',
    'Run',
    'Target',
    'Topic',
    'analyse',
    'course',
    'draw',
    'further_folder',
    'read_contents',
    'read_messages',
    'read_raw',
    'read_run',
    'read_topics',
    'summary',
    'table',
]
