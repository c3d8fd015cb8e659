"""What the launcher shows of a running loop: time, error and force, from the topics alone."""

from __future__ import annotations

import sys

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from tqdm import tqdm

from dpc_ros.bag.topic import NANOSECONDS
from dpc_ros.nodes.launch_plan import LAUNCHER, MONITORED, LaunchPlan
from dpc_ros.nodes.messages import from_stamp, is_latent
from dpc_ros.nodes.topics import TOPICS

_REFRESH = 0.1  # s between two looks at the newest messages
_BAR_FORMAT = '{desc}: {percentage:3.0f}%|{bar:20}| {n:.2f}/{total:.2f} s{postfix}'


class Monitor(Node):
    """Keeps the newest message of each topic as bytes; reads them only to refresh the bar."""

    def __init__(self, plan: LaunchPlan, context: Context) -> None:
        super().__init__(LAUNCHER, context=context)
        self._newest: dict[str, bytes] = {}
        self._start: np.ndarray | None = None
        for topic in MONITORED:
            self._subscribe(topic)
        self._subscribe('target')
        self._subscribe('target_in_force')
        endless = not np.isfinite(plan.duration)
        self._bar = tqdm(
            total=None if endless else plan.duration,
            bar_format='{desc}: {n:.2f} s{postfix}' if endless else _BAR_FORMAT,
            mininterval=_REFRESH,
        )
        self._bar.set_description_str('waiting for the nodes')
        self._refresh = self.create_timer(
            _REFRESH, self._show, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    @property
    def seconds(self) -> float:
        """Simulated time of the newest configuration [s], 0 before the first."""
        if 'configuration' not in self._newest:
            return 0.0
        state = deserialize_message(self._newest['configuration'], JointState)
        return from_stamp(state.header.stamp) / NANOSECONDS

    def target_in_force(self) -> dict[str, list[float]] | None:
        """Return the target that the controller has announced last, as a target file has it."""
        if 'target_in_force' not in self._newest:
            return None
        target = deserialize_message(self._newest['target_in_force'], JointState)
        kind = 'latent' if is_latent(target) else 'configuration'
        return {kind: [*target.position]}

    def say(self, line: str) -> None:
        """Show a line above the bar."""
        self._bar.write(line, file=sys.stderr)

    def close(self) -> None:
        """End the bar with what came last; the nodes are about to finish."""
        self._refresh.cancel()
        self._show()
        self._bar.set_description_str('finishing')
        self._bar.close()

    def _show(self) -> None:
        if 'configuration' not in self._newest:
            return
        state = deserialize_message(self._newest['configuration'], JointState)
        seconds = from_stamp(state.header.stamp) / NANOSECONDS
        if seconds == self._bar.n:
            return
        self._bar.n = min(seconds, self._bar.total or seconds)  # tqdm drops a total it passes
        self._bar.set_description_str('running', refresh=False)
        shown = []
        configuration = np.array(state.position)
        if 'target' in self._newest:
            target = np.array(deserialize_message(self._newest['target'], JointState).position)
            if self._start is not None and target.shape == configuration.shape:
                begin = np.sum((self._start - target) ** 2)
                nmse = np.sum((configuration - target) ** 2) / begin if begin else np.nan
                shown.append(f'nMSE {nmse:.4f}')
        if 'control_force' in self._newest:
            force = deserialize_message(self._newest['control_force'], WrenchStamped).wrench.force
            shown.append(f'|u| {np.hypot(force.x, force.y):.2f} N')
        self._bar.set_postfix_str('  '.join(shown), refresh=True)

    def _subscribe(self, topic: str) -> None:
        def keep(data: bytes) -> None:
            # the first configuration is what the error is normalised by
            if topic == 'configuration' and topic not in self._newest:
                self._start = np.array(deserialize_message(data, JointState).position)
            self._newest[topic] = data

        entry = TOPICS[topic]
        self.create_subscription(entry.message_type, topic, keep, entry.qos, raw=True)
