"""Where the programs of this package begin: a Ctrl-C ends each quietly from its first import on.

The imports that follow take a second or more, and an interrupt in the middle of one can come out as
any other error. Until a program has handlers of its own (`StopRequest`) there is nothing to put in
order: it just ends.
"""

from __future__ import annotations

import atexit
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module

SIGNALLED = 128  # and the number of the signal: the exit code of who was ended by one, in shells
PARENT_VARIABLE = 'DPC_ROS_LAUNCHER_PID'  # of who started a node, and with whom it ends
_INTERRUPTED = 130  # exit code after Ctrl-C, as shells have it


def end_quietly(program: str) -> None:
    """Let a Ctrl-C end this process at once: a node is asked to by it, anything else interrupted.

    One that came while signals were held back, as the launcher does while a node starts, counts.
    """
    code = 0 if program.endswith('_node') else _INTERRUPTED
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as a shell does in the background
        signal.signal(signal.SIGINT, lambda number, frame: os._exit(code))
    atexit.register(
        signal.signal, signal.SIGINT, signal.SIG_IGN
    )  # at the end nothing is left to do
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """Let a SIGINT wait; for a process that is started now until it says that it can take one."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _run(program: str) -> None:
    end_quietly(program)
    import_module(f'dpc_ros.nodes.{program}').main()


simulator_node = partial(_run, 'simulator_node')
encoder_node = partial(_run, 'encoder_node')
controller_node = partial(_run, 'controller_node')
recorder_node = partial(_run, 'recorder_node')
player_node = partial(_run, 'player_node')
markers_node = partial(_run, 'markers_node')
viewer_node = partial(_run, 'viewer_node')
launcher = partial(_run, 'launcher')
