import os
import subprocess
import sys

import pytest
from domain_coordinator import domain_id

from dpc_ros.nodes.discovery import PROFILE_VARIABLES, announce_often
from dpc_ros.nodes.provenance import ros_distribution
from dpc_ros.resources import config_path

# What the profiles say of it in a comment.
RENAMED = {
    'heartbeatPeriod': 'heartbeat_period',
    'nackResponseDelay': 'nack_response_delay',
    'heartbeatResponseDelay': 'heartbeat_response_delay',
}
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


@pytest.mark.parametrize('name', ['fast_dds.xml', 'fast_dds_unicast.xml', 'fast_dds_lossy.xml'])
def test_fast_dds_has_nothing_to_say_against_a_shipped_profile(empty_folder, name):
    is_renamed = ros_distribution() not in ('humble', 'iron', 'jazzy')
    text = config_path(name).read_text()
    for old, new in RENAMED.items() if is_renamed else ():
        text = text.replace(f'{old}>', f'{new}>')
    profile = empty_folder / name
    profile.write_text(text)
    with domain_id() as domain:
        variables = {'ROS_DOMAIN_ID': str(domain), PROFILE_VARIABLES[is_renamed]: str(profile)}
        command = [sys.executable, '-c', MEET]
        run = subprocess.run(
            command,
            env=os.environ | variables,
            stderr=subprocess.STDOUT,
            stdout=subprocess.PIPE,
            text=True,
        )
    assert (run.returncode, run.stdout) == (0, '')
