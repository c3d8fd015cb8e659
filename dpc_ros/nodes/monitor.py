"""What the launcher shows of a running loop: time, error and force, from the topics alone."""

from __future__ import annotations

import sys
from functools import lru_cache, partial
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from tqdm import tqdm

from dpc_ros.bag.topic import NANOSECONDS
from dpc_ros.nodes.executor import RareCallbackGroup, take_and_call
from dpc_ros.nodes.launch_plan import LAUNCHER, MONITORED, LaunchPlan
from dpc_ros.nodes.messages import from_stamp, is_latent
from dpc_ros.nodes.newest import subscribe
from dpc_ros.nodes.topics import TOPICS
from dpc_ros.nodes.wire import Pattern, state_pattern

_REFRESH = 0.1  # s between two looks at the newest messages
_BAR_FORMAT = '{desc}: {percentage:3.0f}%|{bar:20}| {n:.2f}/{total:.2f} s{postfix}'


class Monitor(Node):
    """Keeps the newest message of each topic as bytes; reads them only to refresh the bar."""

    def __init__(self, plan: LaunchPlan, context: Context) -> None:
        super().__init__(LAUNCHER, context=context)
        self._newest: dict[str, bytes] = {}
        self._start: np.ndarray | None = None  # what the error is normalised by
        self._states: Pattern | None = None  # that the first configuration is one of
        entry = TOPICS['configuration']
        self._first = self.create_subscription(
            entry.message_type, 'configuration', self._begin, entry.qos, raw=True
        )
        group = RareCallbackGroup()
        self._inputs = [
            subscribe(self, topic, partial(self._keep, topic), 1, raw=True, group=group)
            for topic in (*MONITORED, 'target', 'target_in_force')
        ]
        endless = not np.isfinite(plan.duration)
        self._bar = tqdm(
            total=None if endless else plan.duration,
            bar_format='{desc}: {n:.2f} s{postfix}' if endless else _BAR_FORMAT,
            mininterval=_REFRESH,
        )
        self._bar.set_description_str('waiting for the nodes')
        steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._refresh = self.create_timer(_REFRESH, self._show, group, steady_clock)

    @property
    def seconds(self) -> float:
        """Simulated time of the newest configuration [s], 0 before the first."""
        seconds, _ = self._read_state()
        return seconds or 0.0

    def target_in_force(self) -> dict[str, list[float]] | None:
        """Return the target that the controller has announced last, as a target file has it."""
        target = self._read_newest('target_in_force')
        if target is None:
            return None
        kind = 'latent' if is_latent(target) else 'configuration'
        return {kind: [*target.position]}

    def say(self, line: str) -> None:
        """Show a line above the bar."""
        self._bar.write(line, file=sys.stderr)

    def close(self) -> None:
        """End the bar with what came last; the nodes are about to finish."""
        self._refresh.cancel()
        for subscription in self._inputs:
            while take_and_call(subscription):
                pass
        self._show()
        self._bar.set_description_str('finishing')
        self._bar.close()

    def _show(self) -> None:
        seconds, configuration = self._read_state()
        if seconds is None or seconds == self._bar.n:
            return
        self._bar.n = min(seconds, self._bar.total or seconds)  # tqdm drops a total it passes
        self._bar.set_description_str('running', refresh=False)
        shown = []
        target, answer = self._read_newest('target'), self._read_newest('control_force')
        sizes = {configuration.size, None if self._start is None else self._start.size}
        if target is not None and sizes == {len(target.position)}:
            begin = np.sum((self._start - target.position) ** 2)
            nmse = np.sum((configuration - target.position) ** 2) / begin if begin else np.nan
            shown.append(f'nMSE {nmse:.4f}')
        if answer is not None:
            force = answer.wrench.force
            shown.append(f'|u| {np.hypot(force.x, force.y):.2f} N')
        self._bar.set_postfix_str('  '.join(shown), refresh=True)

    def _begin(self, data: bytes) -> None:
        """Keep the first configuration, and take no more of them one by one."""
        state = _read(data, 'configuration')
        if state is not None:
            self._start = np.array(state.position)
            if len(state.position):
                self._states = state_pattern(state.header.frame_id, len(state.position), state.name)
            self.destroy_subscription(self._first)

    def _keep(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        self._newest[topic] = data

    def _read_state(self) -> tuple[float | None, np.ndarray]:
        """Return time [s] and configuration [m] of the newest state; no time where there is none.

        All states are like the first one. To take one apart by rclpy would hold a loop that runs
        in this process for milliseconds.
        """
        data = self._newest.get('configuration')
        found = self._states.read(data) if data is not None and self._states is not None else None
        if found is not None:
            stamp, configuration, _ = found
            return stamp / NANOSECONDS, configuration
        state = self._read_newest('configuration')
        if state is None:
            return None, np.empty(0)
        return from_stamp(state.header.stamp) / NANOSECONDS, np.array(state.position)

    def _read_newest(self, topic: str) -> Any:
        """Return the newest message of a topic; None where there is none, or none that is one."""
        return _read(self._newest[topic], topic) if topic in self._newest else None


@lru_cache(maxsize=len(TOPICS))  # a target is the same for long
def _read(data: bytes, topic: str) -> Any:
    """Return a message of a topic; None where the bytes are none."""
    try:
        return deserialize_message(data, TOPICS[topic].message_type)
    except RuntimeError:  # the base of what rclpy raises for other bytes
        return None
