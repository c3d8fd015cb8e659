"""What a run was computed on: the same description means the same bits."""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path

_COMPUTING = ('numpy', 'scipy', 'numba')


def describe_machine() -> dict[str, str]:
    """Return what floating-point results depend on: processor, system, versions of libraries."""
    return {
        'processor': _processor(),
        'system': f'{platform.system()} {platform.machine()} {"-".join(platform.libc_ver())}',
        'python': platform.python_version(),
        **{package: version(package) for package in _COMPUTING},
    }


def _processor() -> str:
    try:
        lines = Path('/proc/cpuinfo').read_text().splitlines()
    except OSError:
        return platform.processor()
    names = (line.partition(':')[2].strip() for line in lines if line.startswith('model name'))
    return next(names, platform.processor())
