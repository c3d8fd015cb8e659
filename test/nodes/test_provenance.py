import os
import subprocess
import sys
from importlib.metadata import version

import pytest

from dpc_ros.nodes.provenance import (
    COMMAND_VARIABLE,
    commands,
    ros_distribution,
    software_versions,
)


def test_the_distribution_is_the_sourced_one_else_that_of_the_wheels(monkeypatch):
    monkeypatch.setenv('ROS_DISTRO', 'rolling')
    assert ros_distribution() == 'rolling'
    monkeypatch.delenv('ROS_DISTRO')
    found = ros_distribution()
    if found == 'unknown':
        pytest.skip('rclpy is neither of a sourced installation nor a wheel')
    assert version(f'ros-{found}-rclpy') == version('ros-rclpy')


def test_versions_are_those_installed_and_nothing_is_imported_for_them():
    code = (
        'import sys; from dpc_ros.nodes.provenance import software_versions;'
        'software_versions(); print(*sys.modules)'
    )
    environment = {**os.environ, 'PYTHONWARNINGS': 'ignore'}
    command = [sys.executable, '-c', code]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert {'torch', 'numba', 'scipy'}.isdisjoint(run.stdout.split())
    for package in ('numpy', 'torch', 'mcap'):
        assert software_versions()[package] == version(package)


def test_the_launcher_s_command_stands_beside_the_node_s_own(monkeypatch):
    monkeypatch.setattr(sys, 'argv', ['/somewhere/recorder_node', '--ros-args', '-p', 'bag:=b'])
    monkeypatch.delenv(COMMAND_VARIABLE, raising=False)
    assert commands() == {'process': 'recorder_node --ros-args -p bag:=b'}
    monkeypatch.setenv(COMMAND_VARIABLE, 'launcher --duration 1')
    assert commands()['launcher'] == 'launcher --duration 1'
