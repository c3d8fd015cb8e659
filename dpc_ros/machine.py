"""What a run was computed on: the same description means the same bits."""

from __future__ import annotations

import hashlib
import platform
from importlib.metadata import version
from pathlib import Path

_COMPUTING = ('numpy', 'scipy', 'numba')
_CPU_INFORMATION = Path('/proc/cpuinfo')  # of Linux
# Libraries choose their code by these; a virtual machine may call any processor by the same name.
_PROCESSOR = ('cpu family', 'model', 'stepping')
_FEATURES = ('flags', 'Features')  # on x86 and on Arm


def describe_machine() -> dict[str, str]:
    """Return what floating-point results depend on: processor, system, versions of libraries."""
    return {
        **_describe_processor(),
        'system': f'{platform.system()} {platform.machine()} {"-".join(platform.libc_ver())}',
        'python': platform.python_version(),
        **{package: version(package) for package in _COMPUTING},
    }


def _describe_processor() -> dict[str, str]:
    try:
        first, *_ = _CPU_INFORMATION.read_text().partition('\n\n')
    except OSError:
        return {'processor': platform.processor()}
    lines = [line.partition(':') for line in first.splitlines()]
    values = {name.strip(): value.strip() for name, _, value in lines}
    named = [f'{name} {values[name]}' for name in _PROCESSOR if name in values]
    features = ' '.join(sorted(' '.join(values.get(name, '') for name in _FEATURES).split()))
    return {
        'processor': ', '.join([values.get('model name', platform.processor()), *named]),
        'processor features': hashlib.sha256(features.encode()).hexdigest()[:12],
    }
