import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from domain_coordinator import domain_id
from profiles import for_fast_dds_3

from dpc_ros.nodes import discovery
from dpc_ros.nodes.discovery import (
    FAST_DDS,
    LOCAL_VARIABLE,
    PEERS_VARIABLE,
    RANGE_VARIABLE,
    TRANSPORTS_VARIABLE,
    loaded_fast_dds,
    prompt_dds,
)
from dpc_ros.nodes.health import DIAGNOSTICS
from dpc_ros.nodes.topics import TOPICS
from dpc_ros.resources import config_path

HERE = loaded_fast_dds()
VARIABLES = tuple(each.variable for each in FAST_DDS)
PROMPT = ('configuration', 'latent_state', 'control_force', 'target')
MEET = """
import rclpy
from dpc_ros.nodes.discovery import prompt_dds

with prompt_dds():
    rclpy.init()
rclpy.create_node('alone').destroy_node()
rclpy.shutdown()
"""
SHARED = """
import re
import sys
from pathlib import Path

import rclpy
from dpc_ros.nodes.discovery import prompt_dds
from std_msgs.msg import Int64

with prompt_dds(['--ros-args', '-r', f'__ns:={sys.argv[1]}']):
    rclpy.init()
node = rclpy.create_node('here')
node.create_publisher(Int64, 'numbers', 1)
print(re.findall('/dev/shm/fast.*', Path('/proc/self/maps').read_text()))
node.destroy_node()
rclpy.shutdown()
"""
# How a process joins: as the nodes do, or with nothing of ours.
AS_NODES = """
from dpc_ros.nodes.discovery import prompt_dds

with prompt_dds():
    rclpy.init()
"""
AS_ANYBODY = 'rclpy.init()'
SAY = """
import rclpy
from std_msgs.msg import String

{join}
node = rclpy.create_node('speaker')
publisher = node.create_publisher(String, 'words', 1)
node.create_timer(0.05, lambda: publisher.publish(String(data='a' * 100000)))
try:
    rclpy.spin(node)
except rclpy.executors.ExternalShutdownException:
    pass
"""
HEAR = """
import rclpy
from std_msgs.msg import String

{join}
node = rclpy.create_node('listener')
heard = []
node.create_subscription(String, 'words', heard.append, 1)
while not heard:
    rclpy.spin_once(node, timeout_sec=0.1)
print(len(heard[0].data))
node.destroy_node()
rclpy.shutdown()
"""


@pytest.fixture(autouse=True)
def empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    of_dds = (RANGE_VARIABLE, PEERS_VARIABLE, LOCAL_VARIABLE, TRANSPORTS_VARIABLE)
    dropped = (*VARIABLES, *of_dds)
    kept = {name: value for name, value in os.environ.items() if name not in dropped}
    monkeypatch.setattr(os, 'environ', kept | {'XDG_CACHE_HOME': str(tmp_path / 'cache')})
    return tmp_path


def use_prompt_dds(arguments=()):
    """Return the variables of ROS by which the first context of a process is made."""
    discovery._given_here.clear()
    with prompt_dds(arguments):
        return {name: os.environ.get(name) for name in (RANGE_VARIABLE, LOCAL_VARIABLE)}


def profiles():
    return {name: os.environ.get(name) for name in VARIABLES}


def written():
    """Return the text of the profile in use."""
    (profile,) = filter(None, profiles().values())
    return Path(profile).read_text()


def run(script, domain, *arguments, **variables):
    """Run a script on a domain, return what it says."""
    done = subprocess.run(
        [sys.executable, '-c', script, *arguments],
        env=os.environ | {'ROS_DOMAIN_ID': str(domain)} | variables,
        stderr=subprocess.STDOUT,
        stdout=subprocess.PIPE,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_the_shipped_profile_is_used():
    use_prompt_dds()
    shipped = str(config_path(HERE.profile))
    assert profiles() == dict.fromkeys(VARIABLES) | {HERE.variable: shipped}


@pytest.mark.parametrize('given', ['/body_2', 'body_2', '/left/body_2/'])
def test_the_profile_names_the_topics_of_a_namespace(given):
    use_prompt_dds(['--ros-args', '-r', f'__ns:={given}', '-p', 'rate:=100.0'])
    namespace = '/' + given.strip('/')
    for kind in ('writer', 'reader'):
        named = re.findall(f'<data_{kind} profile_name="(.*)">', written())
        assert named == [*(f'{namespace}/{topic}' for topic in PROMPT), DIAGNOSTICS]


@pytest.mark.parametrize('peers', ['', '10.0.0.2', '10.0.0.2;localhost;'])
def test_where_discovery_is_left_to_some_hosts_a_profile_says_so(peers):
    os.environ |= {RANGE_VARIABLE: 'LOCALHOST', PEERS_VARIABLE: peers}
    assert use_prompt_dds()[RANGE_VARIABLE] == 'SYSTEM_DEFAULT'
    assert ('max_message_size' in written()) == bool(peers)
    named = [name.replace('localhost', '127.0.0.1') for name in peers.split(';') if name]
    assert re.findall('<address>(.*?)</address>', written()) == ['127.0.0.1', *named]
    assert os.environ[RANGE_VARIABLE] == 'LOCALHOST'  # for processes that are started from here


def test_the_variable_of_older_distributions_counts_for_them_alone():
    os.environ |= {LOCAL_VARIABLE: '1', PEERS_VARIABLE: '10.0.0.2'}
    seen, peers = use_prompt_dds(), re.findall('<address>(.*?)</address>', written())
    assert os.environ[LOCAL_VARIABLE] == '1'
    if HERE.has_local_variable:
        assert seen == {RANGE_VARIABLE: 'SYSTEM_DEFAULT', LOCAL_VARIABLE: None}
        assert peers == ['127.0.0.1']
    else:
        assert seen == {RANGE_VARIABLE: None, LOCAL_VARIABLE: '1'}
        assert not peers


def test_a_later_context_that_wants_another_profile_leaves_discovery_to_ros():
    use_prompt_dds()
    os.environ[RANGE_VARIABLE] = 'LOCALHOST'
    with prompt_dds():
        assert os.environ[RANGE_VARIABLE] == 'LOCALHOST'


@pytest.mark.parametrize(
    'variables',
    [
        {RANGE_VARIABLE: 'SUBNET', PEERS_VARIABLE: '10.0.0.2'},
        {RANGE_VARIABLE: 'LOCALHOST', PEERS_VARIABLE: 'no..such..host'},
        {RANGE_VARIABLE: 'OFF'},
    ],
)
def test_else_discovery_is_left_to_ros(variables):
    os.environ |= variables
    assert use_prompt_dds()[RANGE_VARIABLE] == variables[RANGE_VARIABLE]
    assert '<address>' not in written()


def test_a_process_adapts_the_profile_of_the_one_that_started_it():
    os.environ[RANGE_VARIABLE] = 'LOCALHOST'
    use_prompt_dds()
    first = written()
    (cached,) = filter(None, profiles().values())
    Path(cached).write_text('<dds>')  # or cut short, or gone
    use_prompt_dds()
    assert written() == first
    Path(cached).unlink()
    use_prompt_dds(['--ros-args', '-r', '__ns:=/body_2'])
    adapted = first.replace('profile_name="/', 'profile_name="/body_2/')
    assert written() == adapted.replace(f'/body_2{DIAGNOSTICS}', DIAGNOSTICS)


@pytest.mark.parametrize('reach', ['LOCALHOST', 'SUBNET'])
@pytest.mark.parametrize('namespace', ['/', '/body_2'])
def test_nodes_share_no_memory(reach, namespace):
    with domain_id() as domain:
        assert run(SHARED, domain, namespace, **{RANGE_VARIABLE: reach}) == '[]\n'


@pytest.mark.parametrize('peers', ['', 'localhost'])  # on this host; as if on another one
@pytest.mark.parametrize(('speaker', 'listener'), [(AS_NODES, AS_ANYBODY), (AS_ANYBODY, AS_NODES)])
def test_nodes_and_any_program_of_ros_hear_long_messages_of_each_other(speaker, listener, peers):
    local = {RANGE_VARIABLE: 'LOCALHOST', PEERS_VARIABLE: peers}
    with domain_id() as domain:
        variables = {'ROS_DOMAIN_ID': str(domain), **local}
        command = [sys.executable, '-c', SAY.format(join=speaker)]
        with subprocess.Popen(command, env=os.environ | variables) as process:
            try:
                assert run(HEAR.format(join=listener), domain, **local) == '100000\n'
            finally:
                process.terminate()


def test_a_wrong_name_of_the_distribution_opens_nothing():
    wrong = 'kilted' if HERE is FAST_DDS[0] else 'jazzy'
    with domain_id() as domain:
        variables = {RANGE_VARIABLE: 'LOCALHOST', 'ROS_DISTRO': wrong}
        assert run(SHARED, domain, '/', **variables) == '[]\n'


def test_a_home_that_takes_no_file_is_no_error(empty_folder):
    (empty_folder / 'cache').touch()
    os.environ |= {RANGE_VARIABLE: 'LOCALHOST'}
    seen = use_prompt_dds(['--ros-args', '-r', '__ns:=/body_2'])
    (profile,) = filter(None, profiles().values())
    assert profile.startswith(str(config_path('.')))
    assert seen[RANGE_VARIABLE] == 'LOCALHOST'  # ROS sees to it


@pytest.mark.parametrize('arguments', [[], ['--ros-args', '-r', '__ns:=/']])
def test_the_root_is_no_namespace(arguments):
    use_prompt_dds(arguments)
    (profile,) = filter(None, profiles().values())
    assert profile.startswith(str(config_path('.')))


@pytest.mark.parametrize('variable', VARIABLES)
def test_a_profile_of_the_user_is_kept(variable):
    os.environ[variable] = 'mine.xml'
    use_prompt_dds()
    assert profiles() == dict.fromkeys(VARIABLES) | {variable: 'mine.xml'}


@pytest.mark.parametrize('reach', ['LOCALHOST', 'SUBNET'])
def test_transports_that_the_user_has_chosen_count(reach):
    with domain_id() as domain:
        variables = {RANGE_VARIABLE: reach, TRANSPORTS_VARIABLE: 'DEFAULT'}
        assert '/dev/shm/fast' in run(SHARED, domain, '/', **variables)


@pytest.mark.parametrize('name', ['DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml'])
def test_a_profile_in_the_working_directory_is_kept(empty_folder, name):
    (empty_folder / name).touch()
    use_prompt_dds()
    assert profiles() == dict.fromkeys(VARIABLES)


def test_the_profiles_of_all_distributions_say_the_same():
    old, new = (
        re.sub('<!--.*?-->', '', config_path(name).read_text(), flags=re.DOTALL)
        for name in ('fast_dds.xml', 'fast_dds_kilted.xml')
    )
    assert for_fast_dds_3(old) == new


def test_writers_and_readers_of_the_loop_repeat_soon_what_is_missing():
    text, unicast = (
        config_path(name).read_text() for name in ('fast_dds.xml', 'fast_dds_unicast.xml')
    )
    for kind in ('writer', 'reader'):
        named = re.findall(f'<data_{kind} profile_name="(.*)">', text)
        assert named == [*(f'/{topic}' for topic in PROMPT), DIAGNOSTICS]
    assert {*PROMPT} < {*TOPICS}
    for part in ('<propertiesPolicy>.*</propertiesPolicy>', '<data_writer.*</data_reader>'):
        (found,) = re.findall(part, text, re.DOTALL)
        assert found in unicast


@pytest.mark.parametrize('name', ['fast_dds.xml', 'fast_dds_unicast.xml'])
def test_fast_dds_has_nothing_to_say_against_a_shipped_profile(empty_folder, name):
    text = config_path(name).read_text()
    profile = empty_folder / name
    profile.write_text(text if HERE is FAST_DDS[0] else for_fast_dds_3(text))
    with domain_id() as domain:
        variables = {HERE.variable: str(profile), RANGE_VARIABLE: 'LOCALHOST'}
        assert run(MEET, domain, **variables) == ''
