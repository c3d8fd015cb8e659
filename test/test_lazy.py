"""Names of packages that are imported when they are asked for."""

import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec

import pytest

PACKAGES = ('autoencoder', 'bag', 'control', 'data', 'network', 'reduction', 'view')


@pytest.mark.parametrize('package', PACKAGES)
def test_each_name_of_a_stub_is_found_and_is_no_module(package):
    module = import_module(f'dpc_ros.{package}')
    assert module.__all__
    for name in module.__all__:
        getattr(module, name)
        assert find_spec(f'dpc_ros.{package}.{name}') is None, name
    with pytest.raises(AttributeError, match='no_such_name'):
        module.no_such_name  # noqa: B018


@pytest.mark.parametrize(
    ('node', 'needless'),
    [
        (
            'simulator',
            {'scipy.sparse', 'mcap', 'torch', 'dpc_ros.autoencoder', 'dpc_ros.reduction'},
        ),
        ('encoder', {'numba', 'scipy.linalg', 'mcap', 'torch', 'dpc_ros.reduction'}),
        ('controller', {'mcap', 'torch'}),
        ('recorder', {'numba', 'scipy', 'torch', 'dpc_ros.control', 'dpc_ros.network'}),
    ],
)
def test_a_node_imports_nothing_that_it_has_no_use_for(node, needless):
    script = f'import sys, dpc_ros.nodes.{node}_node; print(*sys.modules)'
    loaded = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True).stdout
    assert f'dpc_ros.nodes.{node}_node' in loaded.split()
    assert not needless & {*loaded.split()}
