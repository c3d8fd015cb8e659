"""What reaches a user: package.xml, the wheel, and the tree that `ros2 run` looks into."""

import importlib.metadata
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import ament_index_python
import pytest
import rclpy
from catkin_pkg.package import parse_package
from domain_coordinator import domain_id
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

import dpc_ros
from dpc_ros.nodes.discovery import prompt_dds
from dpc_ros.resources import config_path

ROOT = Path(__file__).resolve().parents[2]
EXECUTABLES = (
    'simulator_node',
    'encoder_node',
    'controller_node',
    'recorder_node',
    'player_node',
    'markers_node',
    'viewer_node',
    'launcher',
)
NO_SOURCE = ('build', 'install', 'log', 'dist', 'runs', 'bags', 'docs')
STARTUP_TIMEOUT = 120.0  # s, for a node that compiles its kernels
STOP_TIMEOUT = 30.0  # s
# The command of that name may be in a virtual environment beneath this one.
COLCON = 'import sys; from colcon_core.command import main; sys.exit(main())'
# Prints from another process where an installed package is and what it finds.
PROBE = """
import json, sys
import dpc_ros
from dpc_ros.network import load_network
from dpc_ros.resources import config_path
system = config_path('systems', 'paper_2.json')
json.dump({
    'package': dpc_ros.__file__,
    'system': str(system.resolve(strict=True)),
    'identifier': load_network('paper_2').identifier,
    'rclpy': 'rclpy' in sys.modules,
}, sys.stdout)
"""


def run(*command, **options):
    """Run a command to its end; a failure shows what it printed."""
    result = subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, check=False, **options
    )
    assert result.returncode == 0, f'{command}\n{result.stdout}\n{result.stderr}'
    return result.stdout


def probe(folder, environment):
    """Ask the package in the given environment, from a folder that has nothing to do with it."""
    return json.loads(run(sys.executable, '-c', PROBE, cwd=folder, env=environment))


@pytest.fixture(scope='session')
def make_source_tree(tmp_path_factory):
    """Return a function that copies the source tree, without what builds and runs leave in it."""

    def ignored(folder, names):
        generated = {n for n in names if n == '__pycache__' or n.endswith('.egg-info')}
        if Path(folder) == ROOT:
            generated |= {n for n in names if n.startswith('.') or n in NO_SOURCE}
        return generated

    def make():
        return shutil.copytree(ROOT, tmp_path_factory.mktemp('source') / 'dpc_ros', ignore=ignored)

    return make


@pytest.fixture(scope='session')
def wheel(make_source_tree, tmp_path_factory):
    """The built wheel."""
    folder = tmp_path_factory.mktemp('wheel')
    options = ('--quiet', '--no-deps', '--no-build-isolation', '--use-pep517', '--no-cache-dir')
    run(
        *(sys.executable, '-m', 'pip', '--disable-pip-version-check', 'wheel', *options),
        *('--wheel-dir', folder, make_source_tree()),
    )
    (path,) = folder.glob('dpc_ros-*.whl')
    return path


@pytest.fixture(scope='session')
def prefix(wheel, tmp_path_factory):
    """A prefix with the wheel in it, laid out like a virtual environment."""
    folder = tmp_path_factory.mktemp('prefix')
    run(
        *(sys.executable, '-m', 'pip', '--disable-pip-version-check', 'install', '--quiet'),
        *('--no-deps', '--no-index', '--ignore-installed', '--no-warn-script-location'),
        *('--prefix', folder, wheel),
    )
    return folder


@pytest.fixture(scope='session')
def prefix_environment(prefix):
    """Environment in which Python finds the package of the prefix before any other."""
    (packages,) = prefix.glob('lib*/python*/site-packages')
    return os.environ | {'PYTHONPATH': str(packages)}


class ColconTree:
    """A colcon workspace with the package in it, built."""

    def __init__(self, source, workspace, *options):
        self.source = source
        self.workspace = workspace
        self.prefix = workspace / 'install' / 'dpc_ros'
        self.output = self.colcon('build', '--event-handlers', 'desktop_notification-', *options)
        # What a user's shell has after `source install/setup.bash`.
        variables = run(
            *('bash', '-c', '. install/local_setup.bash && env --null'),
            cwd=workspace,
            env=self._environment(),
        )
        self.environment = dict(line.split('=', 1) for line in variables.split('\0') if line)

    def colcon(self, verb, *options):
        """Run colcon over the source tree."""
        return run(
            *(sys.executable, '-c', COLCON, '--log-base', self.workspace / 'log'),
            *(verb, '--base-paths', self.source, *options),
            cwd=self.workspace,
            env=self._environment(),
        )

    def _environment(self):
        kept = {k: v for k, v in os.environ.items() if not k.startswith('COLCON_')}
        return kept | {'COLCON_HOME': str(self.workspace / 'colcon')}


@pytest.fixture(scope='session', params=[(), ('--symlink-install',)], ids=['copied', 'symlinked'])
def colcon_tree(request, make_source_tree, tmp_path_factory):
    """The built workspace."""
    return ColconTree(make_source_tree(), tmp_path_factory.mktemp('workspace'), *request.param)


def test_manifest_agrees_with_the_package_and_the_wheel(wheel):
    manifest = parse_package(str(ROOT))
    assert manifest.get_build_type() == 'ament_python'
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (n for n in archive.namelist() if n.endswith('.dist-info/METADATA'))
        metadata = importlib.metadata.PathDistribution(zipfile.Path(archive, name).parent).metadata
    assert metadata['Name'].replace('-', '_') == manifest.name == dpc_ros.__name__
    assert metadata['Version'] == manifest.version == dpc_ros.__version__
    license_name = metadata['License-Expression'] or metadata['License']
    assert [license_name] == manifest.licenses == ['Apache-2.0']
    assert (ROOT / manifest.licenses[0].file).is_file()
    (maintainer,) = manifest.maintainers
    assert metadata['Maintainer'] == maintainer.name
    assert metadata['Maintainer-email'] == maintainer.email


def test_source_tree_finds_its_resources():
    assert config_path('systems', 'paper_2.json') == ROOT / 'config' / 'systems' / 'paper_2.json'


def test_wheel_finds_its_resources(prefix, prefix_environment, tmp_path):
    found = probe(tmp_path, prefix_environment)
    assert Path(found['package']).is_relative_to(prefix)
    expected = prefix / 'share' / 'dpc_ros' / 'config' / 'systems' / 'paper_2.json'
    assert Path(found['system']) == expected.resolve()
    assert found['identifier'].startswith('paper_2@')
    assert not found['rclpy']


def test_wheel_holds_every_file_of_config(prefix):
    installed = prefix / 'share' / 'dpc_ros' / 'config'
    for path in (ROOT / 'config').rglob('*'):
        if path.is_file():
            copy = installed / path.relative_to(ROOT / 'config')
            assert copy.read_bytes() == path.read_bytes()


def test_wheel_holds_what_a_page_is_made_of(prefix):
    (installed,) = prefix.glob('lib*/python*/site-packages/dpc_ros/view')
    assets = [path for path in (ROOT / 'dpc_ros/view').glob('report*') if path.suffix != '.py']
    assert {path.suffix for path in assets} == {'.css', '.html', '.js'}
    for path in assets:
        assert (installed / path.name).read_bytes() == path.read_bytes()


def test_wheel_puts_its_commands_on_the_path(prefix, prefix_environment, tmp_path):
    for name in ('dpc', *EXECUTABLES):
        assert os.access(prefix / 'bin' / name, os.X_OK)
    for name, option in (('dpc', '--version'), ('launcher', '--help')):
        assert run(prefix / 'bin' / name, option, cwd=tmp_path, env=prefix_environment)


def test_colcon_takes_it_for_a_ros_package(colcon_tree):
    name, _, kind = colcon_tree.colcon('list').split('\t')
    assert (name, kind.strip()) == ('dpc_ros', '(ros.ament_python)')


def test_ros2_run_finds_every_executable(colcon_tree, monkeypatch):
    monkeypatch.setenv('AMENT_PREFIX_PATH', colcon_tree.environment['AMENT_PREFIX_PATH'])
    assert 'dpc_ros' in ament_index_python.get_packages_with_prefixes()
    prefix = Path(ament_index_python.get_package_prefix('dpc_ros'))
    assert prefix.samefile(colcon_tree.prefix)
    for name in EXECUTABLES:
        path = prefix / 'lib' / 'dpc_ros' / name
        assert path.is_file()
        assert os.access(path, os.X_OK)


def test_ament_index_leads_to_the_resources(colcon_tree, monkeypatch):
    monkeypatch.setenv('AMENT_PREFIX_PATH', colcon_tree.environment['AMENT_PREFIX_PATH'])
    share = Path(ament_index_python.get_package_share_directory('dpc_ros'))
    assert (share / 'package.xml').is_file()
    for path in (ROOT / 'config').rglob('*'):
        assert (share / 'config' / path.relative_to(ROOT / 'config')).exists()


def test_colcon_tree_finds_its_resources(colcon_tree, tmp_path):
    found = probe(tmp_path, colcon_tree.environment)
    if (colcon_tree.workspace / 'build' / 'dpc_ros' / 'setup.py').is_symlink():
        expected = colcon_tree.source / 'config'
    else:
        expected = colcon_tree.prefix / 'share' / 'dpc_ros' / 'config'
        assert Path(found['package']).is_relative_to(colcon_tree.prefix)
    assert Path(found['system']) == (expected / 'systems' / 'paper_2.json').resolve()
    assert found['identifier'].startswith('paper_2@')
    assert not found['rclpy']


def test_node_of_the_colcon_tree_becomes_active_and_ends_on_ctrl_c(colcon_tree, tmp_path):
    with domain_id() as domain:
        local = {'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
        log = tmp_path / 'encoder_node.log'
        with log.open('wb') as output:
            process = subprocess.Popen(
                [colcon_tree.prefix / 'lib' / 'dpc_ros' / 'encoder_node'],
                cwd=tmp_path,
                env=colcon_tree.environment | local,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        try:
            assert wait_for_active(process, domain), log.read_text()
            process.send_signal(signal.SIGINT)
            assert process.wait(STOP_TIMEOUT) == 0, log.read_text()
        finally:
            process.kill()
            process.wait()


def wait_for_active(process, domain):
    """Ask the encoder for its lifecycle state until it is active, it ends, or time is up."""
    context = Context()
    with prompt_dds():
        rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node('packaging_test', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    client = node.create_client(GetState, 'encoder/get_state')
    deadline = time.monotonic() + STARTUP_TIMEOUT
    try:
        while time.monotonic() < deadline and process.poll() is None:
            if not client.wait_for_service(timeout_sec=0.5):
                continue
            answer = client.call_async(GetState.Request())
            executor.spin_until_future_complete(answer, timeout_sec=5.0)
            if answer.done() and answer.result().current_state.id == State.PRIMARY_STATE_ACTIVE:
                return True
        return False
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
