"""A recorder that is begun and ended at will."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from dpc_ros.nodes.processes import said_reason
from dpc_ros.nodes.program import PARENT_VARIABLE, interrupts_wait

_LONGEST_END = 60.0  # s; it may have to take what waits for it, and to write that
_LONGEST_WAIT = 8.0  # s; a node that is silent for longer is taken for hung


class Recording:
    """A recorder node in a process of its own, which ends with the one that began it.

    What it says stands beside its bag, in `<bag>.log`.

    Args:
        bag: folder to write; must be new.
        namespace: of the topics.

    Raises:
        OSError: the folder of the bag can't be made, or the process not started.
    """

    def __init__(self, bag: Path, namespace: str) -> None:
        self.bag = bag
        self._ends_at = float('inf')  # s, by when it is to have ended
        bag.parent.mkdir(parents=True, exist_ok=True)
        self._log = bag.with_name(f'{bag.name}.log')
        arguments = [
            '-p',
            f'bag:={bag}',
            '-r',
            '__node:=viewer_recorder',
            '-r',
            f'__ns:={namespace}',
        ]
        with self._log.open('wb') as log, interrupts_wait():
            self._process = subprocess.Popen(
                [sys.executable, '-m', 'dpc_ros.nodes.recorder_node', '--ros-args', *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, PARENT_VARIABLE: str(os.getpid()), 'PYTHONUNBUFFERED': '1'},
                start_new_session=True,
            )

    @property
    def has_ended(self) -> bool:
        """Whether the log is closed; one that does not end when it should is ended here."""
        if self._process.poll() is None and time.monotonic() > self._ends_at:
            self._process.kill()
            self._process.wait()
        return self._process.poll() is not None

    @property
    def problem(self) -> str:
        """Why it has ended other than asked to; empty where it did not."""
        code = self._process.returncode
        return said_reason(code, self._log.read_text(errors='replace')) if code else ''

    def end(self) -> None:
        """Ask it to write what is left and to end."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            self._ends_at = min(self._ends_at, time.monotonic() + _LONGEST_END)

    def close(self) -> None:
        """End it; one that takes long is left to itself, and ends when it has written all."""
        self.end()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_LONGEST_WAIT)
