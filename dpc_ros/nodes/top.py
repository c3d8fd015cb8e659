"""Shows all nodes in the terminal, from what they report on /diagnostics."""

from __future__ import annotations

import os
import shutil
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.node import Node

from dpc_ros.nodes.executor import make_executor
from dpc_ros.nodes.health import DIAGNOSTICS, REPORT_DEPTH
from dpc_ros.nodes.loop_node import spin_until
from dpc_ros.nodes.reports import Reports
from dpc_ros.nodes.stop import StopRequest
from dpc_ros.nodes.top_table import table

_PERIOD = 1.0  # s, of the reports and so of the table
_CLEAR = '\x1b[H\x1b[J'  # to the upper left corner, erase from there on (ECMA-48)


class _Listener(Node):
    """Hears the reports, and sees in the graph who should send some."""

    def __init__(self, namespace: str, context: Context) -> None:
        super().__init__(f'top_{os.getpid()}', context=context, start_parameter_services=False)
        self.reports = Reports(namespace)
        self.has_heard = False
        self._known = (0, 0.0)  # so many nodes, since this time [s]
        self.create_subscription(DiagnosticArray, DIAGNOSTICS, self._take, REPORT_DEPTH)

    def is_done(self, latest: float) -> bool:
        """Return whether every node has spoken or is silent, and for a period none was new.

        Args:
            latest: time at which it stops waiting for the first [s].
        """
        now = time.monotonic()
        if not self.has_heard:
            return now > latest
        self._look(now)
        reports = self.reports.newest(now)
        count, since = self._known
        if len(reports) > count:
            self._known = (len(reports), now)
            return False
        return now - since >= _PERIOD and all(
            each.values or each.is_silent(now) for each in reports
        )

    def table(self) -> str:
        """Return what is known now."""
        now = time.monotonic()
        self._look(now)
        return table(self.reports.newest(now), now)

    def _look(self, now: float) -> None:
        """See in the graph who publishes."""
        publishers = self.get_publishers_info_by_topic(DIAGNOSTICS)
        names = [f'{each.node_namespace.rstrip("/")}/{each.node_name}' for each in publishers]
        self.reports.see(names, now)

    def _take(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in message.status:
            self.has_heard |= self.reports.take(status, now) is not None


def show(namespace: str, domain: int | None, once: bool, timeout: float) -> int:
    """Show the nodes until Ctrl-C: in place on a terminal, else one table after the other.

    Args:
        namespace: of the nodes to show; all in `/`.
        domain: of DDS; where none is given, that of the environment.
        once: show one table, when every node has reported or has been silent for too long.
        timeout: in which the first node must report then [s].

    Returns:
        exit code: 1 where no node reports in time, else 0.

    Raises:
        KeyboardInterrupt: it was told to stop.
    """
    with StopRequest([], domain) as stop:
        listener = _Listener(namespace, stop.context)
        executor = make_executor('kept_wait_set', context=stop.context)
        executor.add_node(listener)
        try:
            if once:
                latest = time.monotonic() + timeout
                spin_until(executor, lambda: bool(stop) or listener.is_done(latest))
                if not stop:
                    return _show_once(listener)
            while not stop:
                _refresh(listener.table())
                following = time.monotonic() + _PERIOD
                spin_until(executor, lambda end=following: bool(stop) or time.monotonic() > end)
        finally:
            executor.shutdown()
            listener.destroy_node()
    raise KeyboardInterrupt


def _show_once(listener: _Listener) -> int:
    if not listener.has_heard:
        domain = listener.context.get_domain_id()
        print(
            f'error: no node reports on {DIAGNOSTICS} of domain {domain}: are nodes running there, '
            'in this namespace, and does ROS_AUTOMATIC_DISCOVERY_RANGE reach them?',
            file=sys.stderr,
        )
        return 1
    print(listener.table())
    return 0


def _refresh(text: str) -> None:
    if sys.stdout.isatty():
        size = shutil.get_terminal_size()
        lines = [line[: size.columns] for line in text.splitlines()[: size.lines - 1]]
        text = _CLEAR + '\n'.join(lines)
    print(text, end='\n' if sys.stdout.isatty() else '\n\n', flush=True)
