"""Signals ask a process to stop, but for those that whoever started it ignores."""

import os
import signal

import pytest

from dpc_ros.nodes.stop import StopRequest


@pytest.fixture
def hang_up():
    """Let a test choose what becomes of SIGHUP."""
    before = signal.getsignal(signal.SIGHUP)
    yield lambda handler: signal.signal(signal.SIGHUP, handler)
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize(
    ('handler', 'stops'),
    [(signal.SIG_DFL, True), (signal.SIG_IGN, False)],
    ids=['terminal', 'nohup'],
)
def test_a_terminal_that_closes(hang_up, handler, stops):
    hang_up(handler)
    with StopRequest([]) as stop:
        os.kill(os.getpid(), signal.SIGHUP)
        assert bool(stop) == stops
    assert signal.getsignal(signal.SIGHUP) == handler
