import os
import subprocess
import sys

import pytest
from domain_coordinator import domain_id

from dpc_ros.nodes.discovery import PROFILE_VARIABLES, announce_often
from dpc_ros.resources import config_path

MEET = """
import rclpy
from dpc_ros.nodes.discovery import announce_often

announce_often()
rclpy.init()
rclpy.create_node('alone').destroy_node()
rclpy.shutdown()
"""


@pytest.fixture(autouse=True)
def empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in PROFILE_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def profiles():
    return {name: os.environ.get(name) for name in PROFILE_VARIABLES}


@pytest.mark.parametrize(
    ('distribution', 'variable'),
    [('jazzy', PROFILE_VARIABLES[0]), ('kilted', PROFILE_VARIABLES[1])],
)
def test_the_shipped_profile_is_used(monkeypatch, distribution, variable):
    monkeypatch.setattr(os, 'environ', os.environ | {'ROS_DISTRO': distribution})
    announce_often()
    assert profiles() == dict.fromkeys(PROFILE_VARIABLES) | {
        variable: str(config_path('fast_dds.xml'))
    }


@pytest.mark.parametrize('variable', PROFILE_VARIABLES)
def test_a_profile_of_the_user_is_kept(monkeypatch, variable):
    monkeypatch.setenv(variable, 'mine.xml')
    announce_often()
    assert profiles() == dict.fromkeys(PROFILE_VARIABLES) | {variable: 'mine.xml'}


@pytest.mark.parametrize('name', ['DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml'])
def test_a_profile_in_the_working_directory_is_kept(empty_folder, name):
    (empty_folder / name).touch()
    announce_often()
    assert profiles() == dict.fromkeys(PROFILE_VARIABLES)


def test_fast_dds_has_nothing_to_say_against_the_shipped_profile():
    with domain_id() as domain:
        environment = os.environ | {'ROS_DOMAIN_ID': str(domain)}
        command = [sys.executable, '-c', MEET]
        run = subprocess.run(
            command, env=environment, stderr=subprocess.STDOUT, stdout=subprocess.PIPE, text=True
        )
    assert (run.returncode, run.stdout) == (0, '')
