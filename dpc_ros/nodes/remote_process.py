"""A node on another host, handled as a process here is."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from io import BufferedWriter
from pathlib import Path

from dpc_ros.nodes.hosts import Host
from dpc_ros.nodes.program import SIGNALLED

LINK_ENDED = 255  # the exit code of ssh; ours, too, for a link that ended before its node
_ALIVE_PERIOD = 1.0  # s between two words to a node's host
_KILL_TIMEOUT = 5.0  # s, in which what is to be killed there is gone, or the link is cut
_PIPE = 2**20  # bytes: an order fits in, and does not wait for who is to read it


class RemoteProcess:
    """What the launcher needs of `subprocess.Popen`, for a node that another host runs.

    A program there (`dpc_ros.nodes.remote`) runs the node, and ends it when it hears no more of the
    launcher. Those files of the run that the arguments name travel along.

    Args:
        host: where.
        kind: of the node.
        folder: of the run, here.
        arguments: of ROS.
        environment: variables of the node.
        log: takes what it prints; it is at its end.

    Attributes:
        host: where.
    """

    def __init__(
        self,
        host: Host,
        kind: str,
        folder: Path,
        arguments: Sequence[str],
        environment: Mapping[str, str],
        log: BufferedWriter,
    ) -> None:
        self.host = host
        self._log, self._log_begin = Path(log.name), log.tell()
        self._identity = ''
        self._process = subprocess.Popen(
            host.reaching(host.python, '-m', 'dpc_ros.nodes.remote'),
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            pipesize=_PIPE,
        )
        named = ' '.join(arguments)
        order = {
            'kind': kind,
            'arguments': [host.moved(argument, folder) for argument in arguments],
            'environment': {**environment},
            'folder': host.run_folder(folder),
            'files': {
                path.name: path.read_text()
                for path in folder.iterdir()
                if path.is_file() and str(path) in named
            },
        }
        self._said_at = time.monotonic()
        assert self._process.stdin is not None
        os.set_blocking(self._process.stdin.fileno(), False)
        self._say(json.dumps(order))

    def poll(self) -> int | None:
        """Return the exit code once it has ended; let its host know that this one is there."""
        if time.monotonic() - self._said_at >= _ALIVE_PERIOD:
            self._say('')
        return self._code(self._process.poll())

    def wait(self, timeout: float | None = None) -> int | None:
        """Wait for its end; raise `subprocess.TimeoutExpired` where it does not come."""
        return self._code(self._process.wait(timeout))

    def send_signal(self, number: int) -> None:
        """Ask it to stop, whatever the signal."""
        self._say('stop')

    def kill(self) -> None:
        """End it at once; where its host does not answer, that ends it when it hears no more."""
        self._say('kill')
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_KILL_TIMEOUT)
        self._process.kill()

    @property
    def identity(self) -> str:
        """Its host and number, as in its reports; empty as long as its host has not said it."""
        if not self._identity:
            with self._log.open('rb') as log:
                log.seek(self._log_begin)
                said = re.search(rb'^process (\S+/\d+)$', log.read(), re.MULTILINE)
            self._identity = said[1].decode() if said else ''
        return self._identity

    def _say(self, line: str) -> None:
        self._said_at = time.monotonic()
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError, BlockingIOError):  # it has ended; the link is cut
            self._process.stdin.write(f'{line}\n'.encode())
            self._process.stdin.flush()

    @staticmethod
    def _code(code: int | None) -> int | None:
        if code is not None and code < 0:
            return LINK_ENDED  # by a signal here, which says nothing of the node
        if code is not None and code - SIGNALLED in {*signal.Signals}:
            return SIGNALLED - code
        return code
