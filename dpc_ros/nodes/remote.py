"""Runs a node of a launcher that is on another host: `python -m dpc_ros.nodes.remote`.

Its input begins with a line of JSON that says what to run (see `RemoteProcess`); then `stop`,
`kill`, or a line now and then that only says that the launcher is still there. Without one for a
while, and at the end of the input, the node is asked to stop: where nobody can stop it, it does not
go on.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from dpc_ros.nodes.program import PARENT_VARIABLE, SIGNALLED, interrupts_wait

_LONGEST_SILENCE = 20.0  # s; a link may be down for some of them
_LONGEST_END = 60.0  # s for a node to end once nobody is there who would kill it
_POLL = 0.05  # s
_BLOCK = 2**16  # bytes
_PARAMETERS = 'parameters.yaml'  # by which a run is known


class _Launcher:
    """What the launcher says, line by line, and when it did last."""

    def __init__(self) -> None:
        self._heard_at = time.monotonic()
        self._is_over = False
        self._rest = b''  # of what was heard, the line that is not whole
        self.wants_stop = False
        self.wants_kill = False

    def order(self) -> bytes:
        """Return its first line; an empty one if none comes."""
        while b'\n' not in self._rest and not (self.is_gone or self.wants_stop):
            self._hear(_POLL)
        line, _, self._rest = self._rest.partition(b'\n')
        return line

    def listen(self, seconds: float) -> None:
        """Take what it says for a while."""
        self._hear(seconds)
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

    def _hear(self, seconds: float) -> None:
        if self._is_over:
            time.sleep(seconds)
        elif select.select([sys.stdin], [], [], seconds)[0]:
            data = os.read(sys.stdin.fileno(), _BLOCK)
            self._heard_at = time.monotonic()
            self._rest += data
            self._is_over = not data


def main() -> int:
    """Run the node, and return its exit code as shells have it."""
    launcher = _Launcher()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, launcher.stop)
    line = launcher.order()
    try:
        order = json.loads(line)
        kind, arguments, environment = order['kind'], order['arguments'], order['environment']
        folder, files = Path(order['folder']).absolute(), order['files']
    except (ValueError, KeyError, TypeError) as error:
        got = f'got {error!r}' if line else 'got none: does its command pass standard input on?'
        return _complain(f'expected an order of a launcher, {got}', 2)
    try:
        _lay_down(files, folder)
    except OSError as error:
        return _complain(f'on {socket.gethostname()}: {error}', 1)
    with interrupts_wait():
        node = subprocess.Popen(
            [sys.executable, '-m', f'dpc_ros.nodes.{kind}_node', *arguments],
            stdin=subprocess.DEVNULL,
            env={**os.environ, **environment, PARENT_VARIABLE: str(os.getpid())},
            start_new_session=True,
        )
    print(f'process {socket.gethostname()}/{node.pid}', flush=True)
    return _attend(node, launcher)


def _lay_down(files: Mapping[str, str], folder: Path) -> None:
    """Write the files of a run, each at once: other nodes of the run may be reading.

    Raises:
        OSError: they can't be written, or those of another run are there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        path = folder / Path(name).name
        if path.exists() and path.read_text() == text:
            continue
        if path.exists() and name == _PARAMETERS:
            raise FileExistsError(f'{folder} is of another run: choose another --output')
        draft = path.with_name(f'{path.name}.{os.getpid()}')
        draft.write_text(text)
        draft.replace(path)


def _attend(node: subprocess.Popen[bytes], launcher: _Launcher) -> int:
    """Do what the launcher wants until the node has ended; return the exit code, as shells do."""
    ends_by = float('inf')  # s, once it was asked to and nobody is there who would kill it
    is_asked = is_left = False
    while node.poll() is None:
        if launcher.wants_kill or time.monotonic() > ends_by:
            node.kill()
            node.wait()
        elif not is_asked and (launcher.wants_stop or launcher.is_gone):
            is_asked, is_left = True, not launcher.wants_stop
            node.send_signal(signal.SIGINT)
        elif is_asked and launcher.is_gone:
            ends_by = min(ends_by, time.monotonic() + _LONGEST_END)
        launcher.listen(_POLL)
    if is_left:
        return _complain(f'nothing was heard of the launcher for {_LONGEST_SILENCE:g} s', 1)
    return node.returncode if node.returncode >= 0 else SIGNALLED - node.returncode


def _complain(text: str, code: int) -> int:
    with contextlib.suppress(BrokenPipeError):  # nobody may be there
        print(f'error: {text}', file=sys.stderr, flush=True)
    return code


if __name__ == '__main__':
    sys.exit(main())
