"""The launcher's nodes as processes of their own."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time

from dpc_ros.nodes.launch_plan import RECORDER, LaunchPlan
from dpc_ros.nodes.provenance import COMMAND_VARIABLE
from dpc_ros.nodes.stop import PARENT_VARIABLE
from dpc_ros.results import command_line

_STOP_TIMEOUT = 15.0  # s for a node to end by itself after SIGINT
_POLL = 0.02  # s


class NodeProcesses:
    """Starts the nodes of a plan, watches them and ends them in order.

    Each runs in a session of its own, so that a Ctrl-C in the terminal reaches the launcher alone,
    which then ends the loop before the recorder. Output goes to `log/<node>.log` of the run.
    """

    def __init__(self, plan: LaunchPlan) -> None:
        self._plan = plan
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self.failure = ''
        self.exit_code = 0

    def start(self) -> None:
        """Start every node, the recorder first."""
        logs = self._plan.folder / 'log'
        logs.mkdir()
        environment = {
            **os.environ,
            PARENT_VARIABLE: str(os.getpid()),
            COMMAND_VARIABLE: command_line(),
            'PYTHONUNBUFFERED': '1',
        }
        for node in self._plan.nodes:
            command = [sys.executable, '-m', f'dpc_ros.nodes.{node}_node']
            with (logs / f'{node}.log').open('wb') as log:
                self._processes[node] = subprocess.Popen(
                    [*command, *self._plan.ros_arguments(node)],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    env=environment,
                    start_new_session=True,
                )

    def is_over(self) -> bool:
        """Return whether the leader has come to its end, or any node has failed."""
        for node, process in self._processes.items():
            code = process.poll()
            if code is None:
                continue
            if node != self._plan.leader or code != 0:
                self._note_failure(node, code)
            return True
        return False

    def stop(self) -> None:
        """End what still runs: the loop first, then the recorder, so that nothing is lost."""
        self._stop([node for node in self._processes if node != RECORDER])
        self._stop([node for node in self._processes if node == RECORDER])

    def _stop(self, nodes: list[str]) -> None:
        for node in nodes:
            if self._processes[node].poll() is None:
                with contextlib.suppress(ProcessLookupError):
                    self._processes[node].send_signal(signal.SIGINT)
        deadline = time.monotonic() + _STOP_TIMEOUT
        for node in nodes:
            process = self._processes[node]
            try:
                code = process.wait(max(deadline - time.monotonic(), _POLL))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                code = -signal.SIGKILL
            # A process that is told to stop before its handlers are up ends by the signal itself.
            if code not in (0, -signal.SIGINT) and not self.failure:
                self._note_failure(node, code)

    def _note_failure(self, node: str, code: int) -> None:
        if code < 0:
            self.failure = f'{node} was ended by {signal.Signals(-code).name}'
            self.exit_code = 1
            return
        log = self._plan.folder / 'log' / f'{node}.log'
        lines = [line for line in log.read_text(errors='replace').splitlines() if line.strip()]
        errors = [line for line in lines if line.startswith('error:')] or lines[-1:]
        reason = errors[-1].removeprefix('error: ') if errors else 'it printed nothing'
        self.failure = f'{node} ended with exit code {code}: {reason} (see {log})'
        self.exit_code = code or 1
