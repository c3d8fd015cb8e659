"""What someone who only looks on hears of a running loop: the newest message of each topic."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
from functools import partial

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.subscription import Subscription

from dpc_ros.nodes.executor import RareCallbackGroup
from dpc_ros.nodes.topics import TOPICS


class NewestMessages:
    """Keeps the newest message of some topics of the loop as bytes; who looks on takes those.

    It costs the loop as little as can be. It listens only while it is told to. What the loop
    publishes all the time is asked for with best effort: no publisher has to be told what has come,
    or sends anything again. Of what comes between two looks the middleware keeps one message, and
    nothing is taken apart here. (A topic that is latched is rare, and its last message is for all
    who come late: that takes a reliable subscription.)

    Args:
        node: through which to listen.
        topics: of the loop, by name.
        arrived: is called with the info of each message that is kept.
    """

    def __init__(
        self, node: Node, topics: Iterable[str], arrived: Callable[[dict[str, int]], None]
    ) -> None:
        self._node = node
        self._topics = tuple(topics)
        self._arrived = arrived
        self._group = RareCallbackGroup()
        self._subscriptions: list[Subscription] = []
        self._newest: dict[str, bytes] = {}

    def listen(self) -> None:
        """Begin to listen, if it does not yet."""
        if not self._subscriptions:
            self._subscriptions = [self._subscribe(topic) for topic in self._topics]

    def close(self) -> None:
        """Listen no more, and forget what has not been taken."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []
        self._newest.clear()

    def take(self) -> dict[str, bytes]:
        """Return what has come by topic since the last time, of each the newest."""
        taken, self._newest = self._newest, {}
        return taken

    def _subscribe(self, topic: str) -> Subscription:
        entry = TOPICS[topic]
        qos = copy(entry.qos)
        qos.depth = 1
        if qos.durability == DurabilityPolicy.VOLATILE:
            qos.reliability = ReliabilityPolicy.BEST_EFFORT
        keep = partial(self._keep, topic)
        return self._node.create_subscription(
            entry.message_type, topic, keep, qos, callback_group=self._group, raw=True
        )

    def _keep(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        self._newest[topic] = data
        self._arrived(info)
