"""A node that is ordered by a launcher on another host: how it begins, and what ends it."""

import json
import os
import signal
import subprocess
import sys

import pytest

PARAMETERS = '/**: {ros__parameters: {bag: there/run/bag, topics: [/none]}}'


def run_remote(domain, folder, order, *words, ends=True):
    """Return exit code and output of a node, ordered as by a launcher on another host."""
    with subprocess.Popen(
        [sys.executable, '-m', 'dpc_ros.nodes.remote'],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=domain.environment,
        cwd=folder,
    ) as process:
        process.stdin.write(f'{order}\n')
        process.stdin.flush()
        output = ''
        while words and 'configured' not in output:
            line = process.stdout.readline()
            assert line, output
            output += line
        for word in words:
            process.stdin.write(f'{word}\n')
        process.stdin.flush()
        if ends:
            process.stdin.close()
        output += process.stdout.read()
    return process.returncode, output


@pytest.fixture
def order():
    """An order of a recorder, which waits for messages that do not come."""
    return json.dumps(
        {
            'kind': 'recorder',
            'arguments': ['--ros-args', '--params-file', 'there/run/parameters.yaml'],
            'environment': {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'},
            'folder': 'there/run',
            'files': {'parameters.yaml': PARAMETERS},
        }
    )


@pytest.mark.parametrize(
    ('words', 'ends', 'code'),
    [
        pytest.param(['', 'stop'], False, 0, id='stop'),
        pytest.param(['kill'], False, 128 + signal.SIGKILL, id='kill'),
        pytest.param([''], True, 1, id='gone'),
        pytest.param([''], False, 1, id='silent', marks=pytest.mark.long),
    ],
)
def test_a_node_ends_when_its_launcher_says_so_or_nothing_more(
    domain, tmp_path, order, words, ends, code
):
    found, output = run_remote(domain, tmp_path, order, *words, ends=ends)
    assert found == code, output
    assert (tmp_path / 'there' / 'run' / 'bag').is_dir()
    (line,) = (line for line in output.splitlines() if line.startswith('process '))
    assert line.startswith(f'process {os.uname().nodename}/')
    assert ('nothing was heard of the launcher' in output) == (words == [''])


def test_what_is_no_order_is_an_error(domain, tmp_path):
    for order in ('', 'run!', '[]', '{}'):
        code, output = run_remote(domain, tmp_path, order)
        assert code == 2
        assert output.startswith('error: expected an order of a launcher, got ')


def test_the_files_of_another_run_are_left_alone(domain, tmp_path, order):
    parameters = tmp_path / 'there' / 'run' / 'parameters.yaml'
    parameters.parent.mkdir(parents=True)
    parameters.write_text('those of another run')
    code, output = run_remote(domain, tmp_path, order)
    assert code == 1
    assert 'run is of another run: choose another --output' in output
    assert parameters.read_text() == 'those of another run'
