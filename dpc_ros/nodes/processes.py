"""The launcher's nodes as processes of their own."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from dpc_ros.bag import further_folder
from dpc_ros.nodes.health import identity
from dpc_ros.nodes.hosts import environment_there
from dpc_ros.nodes.launch_plan import RECORDER, LaunchPlan
from dpc_ros.nodes.loop_node import CRASHED
from dpc_ros.nodes.program import PARENT_VARIABLE, interrupts_wait
from dpc_ros.nodes.provenance import COMMAND_VARIABLE
from dpc_ros.nodes.remote_process import LINK_ENDED, RemoteProcess
from dpc_ros.results import command_line

STOP_TIMEOUT = 15.0  # s for a node to end by itself after SIGINT
_RECORDER_TIMEOUT = 60.0  # s; it may have to take what waits for it, and to write that
_POLL = 0.02  # s
_IDENTITY = re.compile(r'process \S+/\d+$')  # with which a node on another host begins
_ASKED_TO_STOP = (0, -signal.SIGINT, -signal.SIGTERM, -signal.SIGHUP)  # exit codes


class NodeProcesses:
    """Starts the nodes of a plan, says how they ended, and ends them in order.

    Each runs on its host, here in a session of its own, so that a Ctrl-C in the terminal reaches
    the launcher alone, which then ends the loop before the recorder. Output goes to
    `log/<node>.log` of the run, that of a node that is started anew behind what is there.

    They are started all at once: each waits for the readers of its topics (`expected_subscribers`),
    the first of them for the recorder, so that starting one after the other would add nothing but
    the time that each takes to come up.

    Attributes:
        restarts: how often each node was started anew.
        bags: folders of the log; more than one where the recorder was started anew.
    """

    def __init__(self, plan: LaunchPlan) -> None:
        self._plan = plan
        self._processes: dict[str, subprocess.Popen[bytes] | RemoteProcess] = {}
        self._log_begins: dict[str, int] = {}  # where the output of the present process does
        self.restarts: Counter[str] = Counter()
        self.bags = [plan.bag] if plan.bag else []

    def start(self) -> None:
        """Start every node."""
        (self._plan.folder / 'log').mkdir()
        for node in self._plan.nodes:
            self._start(node)

    def restart(self, node: str, arguments: Iterable[str] = ()) -> None:
        """Start a node anew that has ended; a recorder leaves the bag that it had as it is.

        Args:
            node: kind of the node.
            arguments: of ROS that win over those of the plan.
        """
        self.restarts[node] += 1
        if node == RECORDER:
            self.bags.append(self._further_bag())
            arguments = ('-p', f'bag:={self.bags[-1]}')
        self._start(node, arguments)

    def _further_bag(self) -> Path:
        first = self.bags[0]
        if RECORDER in self._plan.hosts:  # where it can't be seen from here what there is
            return first.with_name(f'{first.name}_{len(self.bags)}')
        return further_folder(first)

    def ended(self) -> dict[str, int]:
        """Return the exit codes of the nodes that have ended."""
        codes = {node: process.poll() for node, process in self._processes.items()}
        return {node: code for node, code in codes.items() if code is not None}

    def are_running(self, nodes: Iterable[str]) -> bool:
        """Return whether any of some nodes has not ended."""
        return bool({*nodes} & self._processes.keys() - self.ended().keys())

    def identity(self, node: str) -> str:
        """Return host and number of the process that a node is; empty while they are not known."""
        process = self._processes[node]
        return process.identity if isinstance(process, RemoteProcess) else identity(process.pid)

    def ask_to_stop(self, nodes: Iterable[str]) -> None:
        """Send those of some nodes that run what a Ctrl-C does."""
        for node in nodes:
            if node in self._processes and self._processes[node].poll() is None:
                self._processes[node].send_signal(signal.SIGINT)

    def kill(self, node: str) -> None:
        """End a node that does not end by itself."""
        self._processes[node].kill()
        self._processes[node].wait()

    def stop(self) -> str:
        """End what still runs: the loop first, then the recorder, so that nothing is lost.

        Returns:
            what went wrong with it, empty if nothing did but to a companion.
        """
        loop = [node for node in self._processes if node != RECORDER]
        recorder = [node for node in self._processes if node == RECORDER]
        problems = [self._stop(loop, STOP_TIMEOUT), self._stop(recorder, _RECORDER_TIMEOUT)]
        return problems[0] or problems[1]

    def _stop(self, nodes: list[str], timeout: float) -> str:
        running = [node for node in nodes if self.are_running([node])]
        self.ask_to_stop(running)
        deadline = time.monotonic() + timeout
        for node in running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._processes[node].wait(max(deadline - time.monotonic(), _POLL))
                continue
            self.kill(node)
        failed = [
            node
            for node in running
            if self.ended()[node] not in _ASKED_TO_STOP and node not in self._plan.companions
        ]
        return self.describe_end(failed[0]) if failed else ''

    def has_crashed(self, node: str) -> bool:
        """Return whether a node that has ended did not mean to: by a signal, or by an error in it.

        Not if it ended with a reason, or was asked to.
        """
        code = self.ended()[node]
        return code == CRASHED or (code < 0 and code not in _ASKED_TO_STOP)

    def describe_end(self, node: str) -> str:
        """Return how a node ended and why, as far as it has said."""
        code = self.ended()[node]
        if code < 0:
            return f'{node} was ended by {signal.Signals(-code).name}'
        log = self._log(node)
        said = log.read_bytes()[self._log_begins[node] :].decode(errors='replace')
        reason = f'{said_reason(code, said)} (see {log})'
        if code == LINK_ENDED and node in self._plan.hosts:
            return f'{node}: the link to {self._plan.hosts[node].name} ended: {reason}'
        return f'{node} ended with exit code {code}: {reason}'

    def _log(self, node: str) -> Path:
        return self._plan.folder / 'log' / f'{node}.log'

    def _start(self, node: str, restarted: Iterable[str] = ()) -> None:
        environment = {COMMAND_VARIABLE: command_line(), 'PYTHONUNBUFFERED': '1'}
        host = self._plan.hosts.get(node)
        arguments = [*self._plan.ros_arguments(node), *restarted]
        with self._log(node).open('ab') as log, interrupts_wait():
            self._log_begins[node] = log.tell()
            if host is not None:
                environment |= environment_there(host, os.environ)
                self._processes[node] = RemoteProcess(
                    host, node, self._plan.folder, arguments, environment, log
                )
                return
            self._processes[node] = subprocess.Popen(
                [sys.executable, '-m', f'dpc_ros.nodes.{node}_node', *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, **environment, PARENT_VARIABLE: str(os.getpid())},
                start_new_session=True,
            )


def said_reason(code: int, said: str) -> str:
    """Return why a program ended with an exit code that is not zero, from what it printed."""
    if code < 0:
        return f'ended by {signal.Signals(-code).name}'
    lines = [line for line in said.splitlines() if line.strip() and not _IDENTITY.match(line)]
    errors = [line for line in lines if line.startswith('error:')] or lines[-1:]
    return errors[-1].removeprefix('error: ') if errors else 'it printed nothing'
