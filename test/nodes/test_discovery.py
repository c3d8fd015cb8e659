import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from domain_coordinator import domain_id

from dpc_ros.nodes.discovery import FAST_DDS_2, PROFILE_VARIABLES, use_prompt_dds
from dpc_ros.nodes.provenance import ros_distribution
from dpc_ros.nodes.topics import TOPICS
from dpc_ros.resources import config_path

# What the profiles say of it in a comment.
RENAMED = {
    'heartbeatPeriod': 'heartbeat_period',
    'nackResponseDelay': 'nack_response_delay',
    'heartbeatResponseDelay': 'heartbeat_response_delay',
}
MEET = """
import rclpy
from dpc_ros.nodes.discovery import use_prompt_dds

use_prompt_dds()
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
    ('distribution', 'variable', 'profile'),
    [
        ('jazzy', PROFILE_VARIABLES[0], 'fast_dds.xml'),
        ('kilted', PROFILE_VARIABLES[1], 'fast_dds_kilted.xml'),
    ],
)
def test_the_shipped_profile_is_used(monkeypatch, distribution, variable, profile):
    monkeypatch.setattr(os, 'environ', os.environ | {'ROS_DISTRO': distribution})
    use_prompt_dds()
    assert profiles() == dict.fromkeys(PROFILE_VARIABLES) | {variable: str(config_path(profile))}


@pytest.mark.parametrize('distribution', ['jazzy', 'kilted'])
@pytest.mark.parametrize('given', ['/body_2', 'body_2', '/left/body_2/'])
def test_the_profile_names_the_topics_of_a_namespace(
    monkeypatch, empty_folder, distribution, given
):
    variables = {'ROS_DISTRO': distribution, 'XDG_CACHE_HOME': str(empty_folder)}
    monkeypatch.setattr(os, 'environ', os.environ | variables)
    use_prompt_dds(['--ros-args', '-r', f'__ns:={given}', '-p', 'rate:=100.0'])
    (profile,) = filter(None, profiles().values())
    namespace = '/' + given.strip('/')
    text = Path(profile).read_text()
    assert re.findall('<data_writer profile_name="(.*)">', text) == [
        f'{namespace}/{topic}' for topic in ('configuration', 'latent_state', 'control_force')
    ]


def test_a_home_that_takes_no_file_is_no_error(monkeypatch, empty_folder):
    (empty_folder / 'cache').touch()
    monkeypatch.setenv('XDG_CACHE_HOME', str(empty_folder / 'cache'))
    use_prompt_dds(['--ros-args', '-r', '__ns:=/body_2'])
    (profile,) = filter(None, profiles().values())
    assert profile.startswith(str(config_path('.')))


@pytest.mark.parametrize('arguments', [[], ['--ros-args', '-r', '__ns:=/']])
def test_the_root_is_no_namespace(arguments):
    use_prompt_dds(arguments)
    (profile,) = filter(None, profiles().values())
    assert profile.startswith(str(config_path('.')))


@pytest.mark.parametrize('variable', PROFILE_VARIABLES)
def test_a_profile_of_the_user_is_kept(monkeypatch, variable):
    monkeypatch.setenv(variable, 'mine.xml')
    use_prompt_dds()
    assert profiles() == dict.fromkeys(PROFILE_VARIABLES) | {variable: 'mine.xml'}


@pytest.mark.parametrize('name', ['DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml'])
def test_a_profile_in_the_working_directory_is_kept(empty_folder, name):
    (empty_folder / name).touch()
    use_prompt_dds()
    assert profiles() == dict.fromkeys(PROFILE_VARIABLES)


def test_the_profiles_of_all_distributions_say_the_same():
    old, new = (
        re.sub('<!--.*?-->', '', config_path(name).read_text(), flags=re.DOTALL)
        for name in ('fast_dds.xml', 'fast_dds_kilted.xml')
    )
    assert renamed(old) == new


@pytest.mark.parametrize('name', ['fast_dds.xml', 'fast_dds_unicast.xml'])
def test_writers_of_the_loop_ask_soon_what_is_missing(name):
    written = re.findall('<data_writer profile_name="/(.*)">', config_path(name).read_text())
    assert written == ['configuration', 'latent_state', 'control_force']
    assert {*written} < {*TOPICS}


def renamed(profile):
    for old, new in RENAMED.items():
        profile = profile.replace(f'{old}>', f'{new}>')
    return profile


@pytest.mark.parametrize('name', ['fast_dds.xml', 'fast_dds_unicast.xml', 'fast_dds_lossy.xml'])
def test_fast_dds_has_nothing_to_say_against_a_shipped_profile(empty_folder, name):
    is_renamed = ros_distribution() not in FAST_DDS_2
    text = config_path(name).read_text()
    profile = empty_folder / name
    profile.write_text(renamed(text) if is_renamed else text)
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
