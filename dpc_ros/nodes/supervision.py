"""What the launcher does about a node that has crashed, or that is heard no more."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable

from diagnostic_msgs.msg import DiagnosticArray

from dpc_ros.nodes.health import (
    ADDRESS_READING,
    DIAGNOSTICS,
    HOST_READING,
    PROCESS_READING,
    REPORT_DEPTH,
    identity,
)
from dpc_ros.nodes.launch_plan import RECORDER, LaunchPlan
from dpc_ros.nodes.monitor import Monitor
from dpc_ros.nodes.processes import NodeProcesses

_HOPELESS = 3  # times the silence after which it is reported, then the node is started anew
_LONGEST_LOOK = 0.5  # s between two looks that count as silence: for longer, nobody listened


class Supervision:
    """Starts nodes anew that have crashed, at most so many times in a run.

    A node has crashed if it was ended by a signal, or by an error in it, or when it was silent on
    /diagnostics for too long: that is reported first, and the node is killed if it stays so. It
    can't be silent before it has reported once, so one that is starting has all the time it needs.
    A node that ends with a reason of its own ends the run.

    A companion has as many restarts for itself. One that needs more, or ends with a reason, is
    given up, which is said; the run goes on.

    Args:
        plan: what runs, how many restarts it may need and which silence is too long.
        processes: the nodes.
        monitor: hears what the nodes report and what they do, and shows lines to the user.

    Attributes:
        failure: why the run can't go on; empty while it can.
        exit_code: for it: that of a node that ended with a reason, else 1.
    """

    def __init__(self, plan: LaunchPlan, processes: NodeProcesses, monitor: Monitor) -> None:
        self._plan = plan
        self._processes = processes
        self._monitor = monitor
        self._silent_for: dict[str, float] = {}  # s, by process
        self._reported: set[str] = set()  # processes whose silence was
        self._given_up: set[str] = set()
        self._addresses: dict[str, str] = {}  # of the pages that nodes serve
        self._looked_at = time.monotonic()
        self.failure = ''
        self.exit_code = 0
        monitor.create_subscription(DiagnosticArray, DIAGNOSTICS, self._hear, REPORT_DEPTH)

    def is_over(self) -> bool:
        """See to the nodes; return whether the leader has come to its end, or the run failed."""
        for node, code in self._processes.ended().items():
            if node in self._given_up:
                continue
            if node == self._plan.leader and code == 0:
                return True
            if self._processes.has_crashed(node):
                self._restart(node, self._processes.describe_end(node))
            else:
                self._give_up(node, self._processes.describe_end(node), max(code, 1))
            if self.failure:
                return True
        now = time.monotonic()
        elapsed, self._looked_at = min(now - self._looked_at, _LONGEST_LOOK), now
        for process in self._silent_for:
            self._silent_for[process] += elapsed
        if self._plan.silence:
            for node in self._plan.nodes:
                if node not in self._given_up:
                    self._judge(node)
        return bool(self.failure)

    def _judge(self, node: str) -> None:
        process = self._process(node)
        silent_for = self._silent_for.get(process, 0.0)
        if silent_for > _HOPELESS * self._plan.silence:
            self._processes.kill(node)
            self._restart(node, f'{node} was killed: it has not reported for {silent_for:.0f} s')
        elif silent_for > self._plan.silence and process not in self._reported:
            self._reported.add(process)
            self._monitor.say(f'{node} has not reported for {silent_for:.0f} s')
        elif silent_for == 0.0 and process in self._reported:
            self._reported.remove(process)
            self._monitor.say(f'{node} reports again')

    def _restart(self, node: str, why: str) -> None:
        done = self._count_restarts(node)
        if done >= self._plan.restarts:
            limit = f', and --restarts {self._plan.restarts} allows no more' if done else ''
            self._give_up(node, why + limit, 1)
            return
        self._silent_for.pop(self._process(node), None)
        self._processes.restart(node, self._target() if node == 'controller' else ())
        consequence = ''
        if node == RECORDER:
            *_, before, after = self._processes.bags
            where = self._plan.where
            consequence = (
                f'; what follows is recorded in {where(after)}, '
                f'`dpc bag repair` mends {where(before)}'
            )
        elif node == self._plan.leader:
            consequence = '; the body begins again at rest, and its duration counts anew'
        self._monitor.say(f'{why}: started anew ({done + 1} of {self._plan.restarts}){consequence}')

    def _count_restarts(self, node: str) -> int:
        """Return how many of the restarts that a node may have there have been."""
        restarts, companions = self._processes.restarts, self._plan.companions
        if node in companions:
            return restarts[node]
        return sum(count for kind, count in restarts.items() if kind not in companions)

    def _process(self, name: str) -> str:
        """Return the process that a node is; of no other, whatever its name."""
        found = self._processes.identity(name) if name in self._plan.nodes else ''
        return f'{name} {found}' if found else ''

    def _target(self) -> Iterable[str]:
        """Return the arguments by which a controller begins with the target that was in force."""
        target = self._monitor.target_in_force()
        if target is None:
            return ()
        path = self._plan.folder / 'target_in_force.json'
        path.write_text(json.dumps(target))
        return ('-p', f'target:={path}')

    def _give_up(self, node: str, why: str, exit_code: int) -> None:
        if node in self._plan.companions:
            self._given_up.add(node)
            self._monitor.say(f'{why}; the run goes on without it')
        else:
            self.failure, self.exit_code = why, exit_code

    def _hear(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {reading.key: reading.value for reading in status.values}
            process = identity(values.get(PROCESS_READING, ''), values.get(HOST_READING, ''))
            process = f'{status.name} {process}'
            if process == self._process(status.name):
                self._silent_for[process] = 0.0
                self._announce(status.name, values.get(ADDRESS_READING, ''))

    def _announce(self, node: str, address: str) -> None:
        """Say once where the page of a node is, if it has one."""
        if address and self._addresses.get(node) != address:
            self._addresses[node] = address
            host = self._plan.hosts.get(node)
            self._monitor.say(f'{node:<10}  {address}' + (f' on {host.name}' if host else ''))
