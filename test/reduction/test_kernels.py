"""The compiled kernel that stays on disk is the one of the sources that it is made of."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import dpc_ros

PACKAGE = Path(dpc_ros.__file__).parent
SCRIPT = """
import numpy as np
import dpc_ros
from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.network import Gravity, Mechanics, load_network
from dpc_ros.reduction import CompressedSystem
system = CompressedSystem(
    Mechanics(load_network('paper_2'), Gravity(9.81)),
    load_checkpoint('paper_2_pod_m5').autoencoder(),
    162,
)
state = np.zeros((1, 5)), np.zeros((1, 5)), np.zeros((1, 2))
print(dpc_ros.__file__)
print(np.abs(system.acceleration(*state) - system._accelerations(*state)).max())
"""


@pytest.mark.long  # it compiles all kernels twice
def test_a_change_of_the_bodys_kernels_reaches_the_compressed_system(tmp_path):
    """numba keeps compiled functions by the file that they stand in, not by what they call."""
    copy = tmp_path / 'dpc_ros'
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns('__pycache__', 'nodes'))
    shutil.copytree(PACKAGE.parent / 'config', tmp_path / 'config')
    shutil.copy(PACKAGE.parent / 'package.xml', tmp_path)
    environment = {
        **os.environ,
        'PYTHONPATH': str(tmp_path),
        'NUMBA_CACHE_DIR': str(tmp_path / 'cache'),
    }

    def difference():
        run = subprocess.run(
            [sys.executable, '-c', SCRIPT],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        file, value = run.stdout.split()
        assert Path(file).parent == copy
        return float(value)

    assert difference() < 1e-6
    kernels = copy / 'network' / 'kernels.py'
    changed = kernels.read_text().replace('+ gravity[0]', '+ 2.0 * gravity[0] + 5.0')
    assert changed != kernels.read_text()
    kernels.write_text(changed)
    assert difference() < 1e-6
