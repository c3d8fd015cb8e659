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


def write_results(
    path: str | Path, rows: Sequence[Mapping[str, Any]], seed: int | None = None
) -> None:
    """Write rows of measured numbers with the command, commit, machine and seed behind them.

    Args:
        path: file to write.
        rows: one flat object each, SI units; NaN becomes null.
        seed: of what was random, none where nothing was.
    """
    content = {
        'command': ' '.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        'commit': _commit(),
        'created': datetime.datetime.now(datetime.timezone.utc).isoformat(timespec='seconds'),
        'machine': f'{platform.machine()}, {os.cpu_count()} cores, Python '
        f'{platform.python_version()}, dpc_ros {__version__}',
        'seed': seed,
        'rows': [{key: _plain(value) for key, value in row.items()} for row in rows],
    }
    with replacing(path) as partial:
        partial.write_text(json.dumps(content, indent=1) + '\n')


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value


def _commit() -> str:
    """Return the commit of the source tree, marked where files differ from it; else the version."""
    command = ['git', '-C', str(Path(__file__).parent), 'describe', '--always', '--dirty']
    try:
        described = subprocess.run(
            [*command, '--abbrev=40', '--exclude=*'], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return f'dpc_ros {__version__}, no checkout'
    return described.stdout.strip()
