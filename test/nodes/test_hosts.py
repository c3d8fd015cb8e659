"""Which nodes of a run are on other hosts: what a parameter file may say, and what comes of it."""

import shlex
import subprocess
import sys

import pytest
import yaml

from dpc_ros.nodes.by_hand import commands_by_hand
from dpc_ros.nodes.hosts import check_hosts, environment_there, read_hosts
from dpc_ros.nodes.launch_plan import LOOP, make_plan
from dpc_ros.parameters import ParameterError
from dpc_ros.resources import config_path

HOSTS = """
body: {nodes: [simulator], ssh: pi@192.168.1.20}
brain:
  nodes: [encoder, controller]
  command: [env]
  python: /a b/python
  folder: some where
  environment: {NUMBER: 3}
"""


def read(text):
    return read_hosts(yaml.safe_load(text), 'run.yaml: hosts', LOOP)


def test_each_node_has_the_host_that_names_it():
    hosts = read(HOSTS)
    assert {kind: host.name for kind, host in hosts.items()} == {
        'simulator': 'body',
        'encoder': 'brain',
        'controller': 'brain',
    }
    assert read('a@b: {nodes: [encoder]}')['encoder'].ssh == 'a@b'


def test_a_command_comes_as_it_is_by_ssh_and_by_a_command():
    hosts = read(HOSTS)
    *options, line = hosts['simulator'].reaching('a b', "it's")
    assert options[-1] == 'pi@192.168.1.20'
    assert shlex.split(line) == ['a b', "it's"]
    assert hosts['encoder'].reaching('a b') == ['env', 'a b']


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('[a]', 'expected hosts by name'),
        ('a: simulator', 'expected nodes, ssh, command'),
        ('a: {node: [simulator]}', "unknown 'node'"),
        ('a: {nodes: simulator}', 'nodes: expected a list of texts'),
        ('a: {nodes: [simulater]}', "unknown node 'simulater'"),
        ('a: {nodes: [encoder]}\nb: {nodes: [encoder]}', 'encoder on one host, got a and b'),
        ('a: {nodes: [encoder], ssh: b, command: [c]}', 'ssh or command, got both'),
        ('a: {nodes: [encoder], ssh: -oProxyCommand=x}', 'ssh: expected a text'),
        ('-oProxyCommand=x: {nodes: [encoder]}', 'ssh: expected a text'),
        ('a: {nodes: [encoder], python: 3}', 'python: expected a text'),
        ('a: {nodes: [encoder], environment: [B]}', 'expected names and values'),
        ('a: {nodes: [encoder], environment: {B: on}}', 'B: expected a text, got True: put it in'),
        ('a: {nodes: [encoder], python: ~/python}', 'python: expected no ~'),
    ],
)
def test_what_is_no_host_is_refused_with_the_reason(text, reason):
    with pytest.raises(ParameterError, match=f'run.yaml: hosts.*{reason}'):
        read(text)


def test_nodes_agree_in_what_all_must_have_alike():
    host = read(HOSTS)['encoder']
    here = {'ROS_DOMAIN_ID': '7', 'HOME': '/root'}
    assert environment_there(host, here) == {'ROS_DOMAIN_ID': '7', 'NUMBER': '3'}
    # What is not set here may be there, in a profile of a shell.
    assert environment_there(host, {}) == {'ROS_DOMAIN_ID': '0', 'NUMBER': '3'}


def with_environment(text):
    return read(f'a: {{nodes: [encoder], command: [env], environment: {{{text}}}}}')


@pytest.mark.parametrize(
    ('here', 'there'),
    [
        ({}, ''),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}, ''),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_STATIC_PEERS': '10.0.0.2'}, ''),
        ({'ROS_STATIC_PEERS': '10.0.0.2'}, 'ROS_AUTOMATIC_DISCOVERY_RANGE: LOCALHOST'),
    ],
)
def test_hosts_that_can_find_each_other_are_let_pass(here, there):
    check_hosts(with_environment(there), here)


@pytest.mark.parametrize(
    ('here', 'there'),
    [
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}, ''),
        ({}, 'ROS_AUTOMATIC_DISCOVERY_RANGE: LOCALHOST'),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_STATIC_PEERS': ''}, ''),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF', 'ROS_STATIC_PEERS': '10.0.0.2'}, ''),
        ({'ROS_LOCALHOST_ONLY': '1', 'ROS_STATIC_PEERS': '10.0.0.2'}, ''),
    ],
)
def test_hosts_that_keep_to_themselves_are_refused(here, there):
    with pytest.raises(ParameterError, match='keeps the nodes of the run from each other'):
        check_hosts(with_environment(there), here)
    check_hosts({}, here)  # without other hosts there is nobody to find


def test_a_program_that_is_not_here_reaches_no_host():
    hosts = read('a: {nodes: [encoder], command: [dokcer, exec]}')
    with pytest.raises(ParameterError, match="hosts: a: there is no program 'dokcer' here"):
        check_hosts(hosts, {})
    check_hosts(hosts, {}, reach=False)  # people may have it elsewhere


def test_the_shipped_example_is_sound(tmp_path):
    made = make_plan(config_path('two_hosts.yaml'), {}, tmp_path / 'run')
    assert {kind: host.name for kind, host in made.hosts.items()} == {
        'encoder': 'brain',
        'controller': 'brain',
    }


@pytest.fixture
def plan(tmp_path):
    config = tmp_path / 'run.yaml'
    hosts = {'hosts': yaml.safe_load(HOSTS)}
    config.write_text(config_path('demo.yaml').read_text() + yaml.safe_dump(hosts))
    made = make_plan(config, {}, tmp_path / 'my run', namespace='/body_2', monitored=False)
    made.write()
    return made


def test_what_is_typed_by_hand_takes_the_parameters_along(plan):
    text = commands_by_hand(plan)
    blocks = {block.splitlines()[0]: block.splitlines()[1:] for block in text.split('\n\n')}
    (here,) = (shlex.split(line) for line in blocks['# here'])
    module = here.index('dpc_ros.nodes.recorder_node')
    assert here[module - 2 : module] == [sys.executable, '-m']
    assert here[here.index('--params-file') + 1] == str(plan.parameters_file)
    take, *starts = (shlex.split(line) for line in blocks['# brain'])
    assert take[-2:] == ['<', str(plan.parameters_file)]
    for kind, start in zip(('encoder', 'controller'), starts, strict=True):
        assert start[:3] == ['env', 'sh', '-c']
        command = shlex.split(start[3])
        assert command[command.index('-m') - 1 :][:3] == [
            '/a b/python',
            '-m',
            f'dpc_ros.nodes.{kind}_node',
        ]
        assert f'{command[command.index("--params-file") + 1]}'.startswith('some where/my run/')
        assert '__ns:=/body_2' in command
    assert blocks['# body'][1].startswith('ssh -t pi@192.168.1.20 ')
    # Nobody waits for a launcher.
    for values in plan.parameters.values():
        assert 'launcher' not in values.get('expected_subscribers', [])


def test_files_of_the_run_are_there_when_they_are_taken(plan, tmp_path):
    take = commands_by_hand(plan).split('# brain\n')[1].splitlines()[0]
    subprocess.run(['sh', '-c', take], cwd=tmp_path, check=True)
    there = tmp_path / 'some where' / 'my run' / 'parameters.yaml'
    assert there.read_text() == plan.parameters_file.read_text()


def test_the_package_is_found_beside_a_folder_of_its_name(tmp_path):
    """A clone in a home, where ssh begins, is one."""
    (tmp_path / 'dpc_ros').mkdir()
    command = [sys.executable, '-c', 'import dpc_ros; print(dpc_ros.__version__)']
    subprocess.run(command, cwd=tmp_path, check=True)
