"""The rooms of the package: who may import whom, and what the online path leaves out."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import dpc_ros

PACKAGE = Path(dpc_ros.__file__).parent
# From the bottom up: each imports only from itself and those before it.
ROOMS = [
    'files',
    'finite',
    'figure',
    'machine',
    'resources',
    'parameters',
    'results',
    'threads',
    'network',
    'data',
    'autoencoder',
    'reduction',
    'control',
    'bag',
    'view',
    'nodes',
    'paper',
]
ROS_PACKAGES = {
    'ament_index_python',
    'builtin_interfaces',
    'launch',
    'launch_ros',
    'rcl_interfaces',
    'rclpy',
    'rosgraph_msgs',
    'rpyutils',
    'std_srvs',
}
COMMANDS = {'cli', 'bag_commands'}  # above all rooms
MODULES = sorted([*PACKAGE.rglob('*.py'), *PACKAGE.rglob('*.pyi')])
OUTSIDE_NODES = [path for path in MODULES if not path.is_relative_to(PACKAGE / 'nodes')]


def is_of_ros(module):
    top = module.split('.')[0]
    return top in ROS_PACKAGES or top.endswith(('_msgs', '_interfaces'))


def imports(path):
    """Return the full names of everything that a file imports, anywhere in it."""
    package = ('dpc_ros', *path.relative_to(PACKAGE).parent.parts)
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = '.'.join((*base, *([node.module] if node.module else [])))
            names |= {f'{module}.{alias.name}' for alias in node.names}
    return names


def room(parts):
    """Return the room of a module by the parts of its path or name below dpc_ros."""
    return Path(parts[0]).stem if parts else ''


def below(path):
    return path.relative_to(PACKAGE).as_posix()


def test_every_module_stands_in_a_room():
    assert {room(path.relative_to(PACKAGE).parts) for path in MODULES} <= {
        *ROOMS,
        *COMMANDS,
        '__init__',
    }


@pytest.mark.parametrize('path', OUTSIDE_NODES, ids=below)
def test_only_nodes_import_ros(path):
    assert {name for name in imports(path) if is_of_ros(name)} == set()


@pytest.mark.parametrize('path', MODULES, ids=below)
def test_rooms_import_only_downward(path):
    own = room(path.relative_to(PACKAGE).parts)
    if own in COMMANDS:
        return
    allowed = ROOMS[: ROOMS.index(own) + 1] if own in ROOMS else []
    for name in imports(path):
        parts = name.split('.')
        if parts[0] == 'dpc_ros' and parts[1:] != ['__version__']:
            assert room(parts[1:]) in allowed, f'{below(path)} imports {name}'


def modules_of_stub(package):
    """Return the modules of a package whose names are imported when they are asked for."""
    stub = PACKAGE / package / '__init__.pyi'
    return {name.rpartition('.')[0] for name in imports(stub)}


def loaded_by(*modules):
    """Return the top names of all modules that a fresh interpreter loads for these."""
    code = f'import sys, {", ".join(modules)}; print(*{{m.split(".")[0] for m in sys.modules}})'
    run = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    return set(run.stdout.split())


def test_the_online_path_loads_neither_torch_nor_ros():
    modules = {name for stub in ('control', 'bag') for name in modules_of_stub(stub)}
    loaded = loaded_by(*sorted(modules))
    assert 'numba' in loaded
    assert 'torch' not in loaded
    assert {name for name in loaded if is_of_ros(name)} == set()


def test_the_commands_load_nothing_heavy_before_they_are_called():
    assert loaded_by('dpc_ros.cli').isdisjoint({'torch', 'numba', 'scipy', 'matplotlib', 'numpy'})
