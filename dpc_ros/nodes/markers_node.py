"""Markers node: the body, its reconstruction, target and force, as RViz and Foxglove draw them."""

from __future__ import annotations

import sys
import time

from rclpy.context import Context
from rclpy.qos import QoSProfile
from rclpy.timer import Timer
from visualization_msgs.msg import MarkerArray

from dpc_ros.nodes.loop_node import LoopNode, run_node, set_period
from dpc_ros.nodes.marker_scene import BODY, FORCE, RECONSTRUCTION, TARGET, MarkerScene
from dpc_ros.nodes.messages import MessageError
from dpc_ros.nodes.newest import NewestMessages
from dpc_ros.nodes.onlooker import Sight, load_onlooker
from dpc_ros.nodes.topics import Topic

MARKERS = Topic(MarkerArray, QoSProfile(depth=1))  # reliable and volatile, as viewers ask for
_LOOK_PERIOD = 0.2  # s between two looks whether anyone watches
_REPEAT_PERIOD = 1.0  # s after which who has come late gets what has not changed


class MarkersNode(LoopNode):
    """Draws what the loop publishes while someone watches; else it does not even listen.

    It keeps the newest messages as bytes, and reads them when it draws.
    """

    niceness = 5  # below the nodes of the loop

    def __init__(self, context: Context | None = None) -> None:
        super().__init__('markers', context)
        self._timer: Timer | None = None
        self._newest: NewestMessages | None = None

    def configure(self) -> None:
        settings = self.settings
        if not settings['frame']:
            raise ValueError("frame: expected the name of a frame, as 'world', got none")
        self._onlooker = load_onlooker(settings)
        self.health.readings |= self._onlooker.models
        self._scene = MarkerScene(
            self._onlooker.network, settings['frame'], settings['largest_strain']
        )
        self._newest = NewestMessages(self, self._onlooker.topics, self.health.arrived)
        self._markers = self.create_output('markers', MARKERS)

    def activate(self) -> None:
        self._watchers = 0
        self._shown: dict[str, Sight | None] = {}
        self._drawn_at = -_REPEAT_PERIOD
        self._timer = self.create_timer(_LOOK_PERIOD, self._tick, clock=self._steady_clock)

    def deactivate(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
        self._timer = None
        if self._newest is not None:
            self._newest.close()

    def clean_up(self) -> None:
        self.deactivate()
        self._newest = None

    def _tick(self) -> None:
        """Draw, if anyone watches, and be back when the next picture is due."""
        assert self._newest is not None
        assert self._timer is not None
        watchers = self._markers.get_subscription_count()
        if not watchers:
            self._watchers = 0
            self._newest.close()
            self._onlooker.forget()
            set_period(self._timer, _LOOK_PERIOD)
            return
        self._newest.listen()
        begin = time.thread_time()
        now = self.steady_time()
        messages = self._newest.take()
        for topic, data in messages.items():
            try:
                self._onlooker.read(topic, data, now)
            except MessageError as error:
                self.reject(topic, error)
        has_changed = self._onlooker.pass_time(now) or messages or watchers != self._watchers
        if has_changed or now - self._drawn_at >= _REPEAT_PERIOD:
            self._watchers, self._drawn_at = watchers, now
            self._draw()
            self.health.processed(time.thread_time() - begin)
        spent = time.thread_time() - begin
        settings = self.settings
        set_period(
            self._timer, max(1 / settings['largest_rate'], spent / settings['largest_share'])
        )

    def _draw(self) -> None:
        onlooker, scene = self._onlooker, self._scene
        sights = {
            BODY: onlooker.body,
            RECONSTRUCTION: onlooker.reconstruction,
            TARGET: onlooker.target,
        }
        for namespace, sight in sights.items():
            if sight is None:
                scene.hide(namespace)
            elif sight is not self._shown.get(namespace):
                scene.show_springs(namespace, sight.configuration, sight.stamp)
        self._shown = sights
        body, push = onlooker.body, onlooker.push
        if body is None or push is None:
            scene.hide(FORCE)
        else:
            origin = onlooker.network.positions(body.configuration)[push.mass]
            scene.show_force(origin, self.settings['force_scale'] * push.force, push.stamp)
        self.publish(self._markers, scene.message())


def main(arguments: list[str] | None = None) -> None:
    """Run the node as a process."""
    sys.exit(run_node(MarkersNode, arguments))


if __name__ == '__main__':
    main()
