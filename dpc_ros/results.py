"""Files of measured numbers, docs/results/*.json: what the tables in the docs are made from."""

from __future__ import annotations

import datetime
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dpc_ros import __version__
from dpc_ros.files import replacing
from dpc_ros.machine import describe_machine


def write_results(
    path: str | Path, rows: Sequence[Mapping[str, Any]], seed: int | None = None
) -> None:
    """Write rows of measured numbers with the command, commit, machine and seed behind them.

    Args:
        path: file to write.
        rows: one flat object each, SI units; what is not finite becomes null.
        seed: of what was random, none where nothing was.
    """
    content = {
        'command': command_line(),
        'commit': source_commit(),
        'created': datetime.datetime.now(datetime.timezone.utc).isoformat(timespec='seconds'),
        'machine': f'{describe_machine()["processor"]}, {os.cpu_count()} cores, '
        f'{platform.machine()}, Python {platform.python_version()}, dpc_ros {__version__}',
        'seed': seed,
        'rows': [{key: _plain(value) for key, value in row.items()} for row in rows],
    }
    with replacing(path) as partial:
        partial.write_text(json.dumps(content, indent=1, allow_nan=False) + '\n')


def read_results(path: str | Path) -> list[dict[str, Any]]:
    """Return the rows of a file of results; null stands for what was not finite.

    Raises:
        FileNotFoundError: there is none.
    """
    return json.loads(Path(path).read_text())['rows']


def quantity(value: float, unit: str) -> str:
    """Return three digits of a measured number with its unit; seconds in the unit that suits."""
    if unit != 's':
        return f'{value:.3g} {unit}'
    value = float(f'{value:.3g}')
    for factor, name in ((1.0, 's'), (1e-3, 'ms'), (1e-6, 'µs')):
        if abs(value) >= factor:
            return f'{value / factor:.3g} {name}'
    return f'{value / 1e-9:.3g} ns'


def command_line() -> str:
    """Return the command that this process runs, without the folder of the program."""
    return ' '.join([Path(sys.argv[0]).name, *sys.argv[1:]])


def source_commit() -> str:
    """Return the commit of the source tree, else the version.

    It is marked as dirty where files differ from it, but for those that commands write: docs.
    """
    git = ['git', '-C', str(Path(__file__).parent)]
    changes = ['status', '--porcelain', '--untracked-files=no', '--', ':/', ':(top,exclude)docs']
    try:
        commit, changed = (
            subprocess.run([*git, *command], capture_output=True, text=True, check=True).stdout
            for command in (['rev-parse', 'HEAD'], changes)
        )
    except (OSError, subprocess.CalledProcessError):
        return f'dpc_ros {__version__}, no checkout'
    return commit.strip() + ('-dirty' if changed.strip() else '')


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
