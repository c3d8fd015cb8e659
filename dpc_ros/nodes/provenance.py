"""Which software a run was made with, and by which commands."""

from __future__ import annotations

import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rclpy.utilities import get_rmw_implementation_identifier

from dpc_ros import __version__
from dpc_ros.results import command_line, source_commit

COMMAND_VARIABLE = 'DPC_ROS_LAUNCHER_COMMAND'  # in which a launcher tells its nodes its own

_PACKAGES = ('numpy', 'scipy', 'numba', 'torch', 'mcap', 'zstandard')
_INSTALLED_WHEEL = 'ros_*_rclpy-*.dist-info'  # as `ros_jazzy_rclpy-7.1.6.dist-info`


def ros_distribution() -> str:
    """Return the name of the ROS distribution: the sourced one, else that of the wheels.

    `unknown` where neither says.
    """
    if os.environ.get('ROS_DISTRO'):
        return os.environ['ROS_DISTRO']
    # By the names of folders: to ask importlib.metadata for those of all packages takes a tenth of
    # a second, and every node begins with this.
    found = (wheel for folder in sys.path for wheel in Path(folder).glob(_INSTALLED_WHEEL))
    wheel = next(found, None)
    return 'unknown' if wheel is None else wheel.name.split('_')[1]


def software_versions() -> dict[str, str]:
    """Return the versions of everything that computes or records; nothing is imported for it."""
    found = {
        'dpc_ros': __version__,
        'commit': source_commit(),
        'python': platform.python_version(),
        'platform': f'{platform.system()} {platform.machine()}',
        'ros_distribution': ros_distribution(),
        'rmw_implementation': get_rmw_implementation_identifier(),
    }
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = 'not installed'
    return found


def commands() -> dict[str, str]:
    """Return the command line of this process, and that of the launcher where one started it."""
    found = {'process': command_line()}
    if COMMAND_VARIABLE in os.environ:
        found['launcher'] = os.environ[COMMAND_VARIABLE]
    return found
