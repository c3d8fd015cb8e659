"""Runs a node of a launcher that is on another host: `python -m dpc_ros.nodes.remote`.

Its input begins with a line of JSON that says what to run (see `RemoteProcess`); `stop`, `kill`, or
a line now and then that only says that the launcher is still there. Without one for a while, and at
the end of the input, the node is asked to stop: where nobody can stop it, it does not go on.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from dpc_ros.nodes.program import PARENT_VARIABLE, interrupts_wait

_LONGEST_SILENCE = 20.0  # s; a link may be down for some of them
_LONGEST_END = 60.0  # s for a node to end once nobody is there who would kill it
_POLL = 0.05  # s
_BLOCK = 2**16  # bytes
_SIGNALLED = 128  # and the number of the signal: the exit code of who was ended by one, in shells


class _Launcher:
    """What the launcher says, line by line, and when it did last."""

    def __init__(self) -> None:
        self._heard_at = time.monotonic()
        self._is_over = False
        self._rest = b''  # of what was heard, the line that is not whole
        self.wants_stop = False
        self.wants_kill = False

    def order(self) -> bytes:
        """Return its first line."""
        while b'\n' not in self._rest and not self._is_over:
            self._hear()
        line, _, self._rest = self._rest.partition(b'\n')
        return line

    def listen(self, seconds: float) -> None:
        """Take what it says for a while."""
        if self._is_over:
            time.sleep(seconds)
        elif select.select([sys.stdin], [], [], seconds)[0]:
            self._hear()
        *lines, self._rest = self._rest.split(b'\n')
        self.wants_stop |= b'stop' in lines
        self.wants_kill |= b'kill' in lines

    def stop(self, number: int, frame: object) -> None:
        """Take a signal for its wish."""
        self.wants_stop = True

    @property
    def is_gone(self) -> bool:
        """Whether nothing is heard of it any more."""
        return self._is_over or time.monotonic() - self._heard_at > _LONGEST_SILENCE

    def _hear(self) -> None:
        data = os.read(sys.stdin.fileno(), _BLOCK)
        self._heard_at = time.monotonic()
        self._rest += data
        self._is_over = not data


def main() -> int:
    """Run the node, and return its exit code as shells have it."""
    launcher = _Launcher()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, launcher.stop)
    try:
        node = _start(json.loads(launcher.order()))
    except (ValueError, KeyError, TypeError, OSError) as error:
        print(f'error: expected an order of a launcher: {error!r}', file=sys.stderr)
        return 2
    print(f'process {socket.gethostname()}/{node.pid}', flush=True)
    code = _attend(node, launcher)
    return code if code >= 0 else _SIGNALLED - code


def _start(order: dict[str, Any]) -> subprocess.Popen[bytes]:
    """Lay down the files of the run, and start the node."""
    folder = Path(order['there']).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in order['files'].items():
        (folder / Path(name).name).write_text(text.replace(order['here'], str(folder)))
    with interrupts_wait():
        return subprocess.Popen(
            [
                *(sys.executable, '-m', f'dpc_ros.nodes.{order["kind"]}_node'),
                *(argument.replace(order['here'], str(folder)) for argument in order['arguments']),
            ],
            stdin=subprocess.DEVNULL,
            env={**os.environ, **order['environment'], PARENT_VARIABLE: str(os.getpid())},
            start_new_session=True,
        )


def _attend(node: subprocess.Popen[bytes], launcher: _Launcher) -> int:
    """Do what the launcher wants until the node has ended."""
    ends_by = float('inf')  # s, once it was asked to and nobody is there who would kill it
    asked = False
    while node.poll() is None:
        if launcher.wants_kill or time.monotonic() > ends_by:
            node.kill()
            return node.wait()
        if not asked and (launcher.wants_stop or launcher.is_gone):
            asked = True
            node.send_signal(signal.SIGINT)
        if asked and launcher.is_gone:
            ends_by = min(ends_by, time.monotonic() + _LONGEST_END)
        launcher.listen(_POLL)
    return node.returncode


if __name__ == '__main__':
    sys.exit(main())
