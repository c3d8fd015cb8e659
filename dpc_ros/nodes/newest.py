"""The newest messages of a topic: for who was held up, and for who only looks on."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from functools import partial
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.subscription import Subscription

from dpc_ros.nodes.executor import RareCallbackGroup, take_and_call
from dpc_ros.nodes.topics import TOPICS

_PLACES = 100  # for messages, at least
_HELD_UP_NS = 1_000_000  # behind a message that has waited for longer others are looked for [ns]


def subscribe(
    node: Node,
    topic: str,
    callback: Callable[..., None],
    newest: int | None = None,
    raw: bool = False,
    earlier: Sequence[Subscription] = (),
    group: CallbackGroup | None = None,
) -> Subscription:
    """Subscribe to a topic of the loop, with room for many messages however few are needed.

    Of its room Fast DDS loses a place for good whenever, while all are taken, a message comes that
    is older than those, as one that is sent again: until none is left and nothing comes any more.
    With many places that hardly ever happens.

    Args:
        node: whose subscription it is to be.
        topic: its name.
        callback: takes a message, and its info where it has a second argument.
        newest: how many it takes of the messages that wait for it, if not all, once one has waited
            for a millisecond; it then takes their info, too.
        raw: whether it takes the bytes of a message instead.
        earlier: subscriptions whose waiting messages are taken before those newest ones: they count
            for whatever is not answered yet. Some may have come after the executor had looked.
        group: of the callback, if not that of the node.
    """
    entry = TOPICS[topic]
    qos = copy(entry.qos)
    qos.depth = max(qos.depth, _PLACES)
    subscription = node.create_subscription(
        entry.message_type, topic, callback, qos, callback_group=group, raw=raw
    )
    if newest is not None:
        subscription.callback = _of_the_newest(subscription, callback, newest, earlier)
    return subscription


def _of_the_newest(
    subscription: Subscription,
    callback: Callable[..., None],
    count: int,
    earlier: Sequence[Subscription],
) -> Callable[[Any, dict[str, int]], None]:
    """Return a callback that leaves out all but so many of the messages that wait for it.

    A subscription of that depth would do the same, but not in Fast DDS (`subscribe`).
    """
    most = subscription.qos_profile.depth

    def take_waiting(message: Any, info: dict[str, int]) -> deque[tuple[Any, dict[str, int]]]:
        waiting = deque([(message, info)], maxlen=count)
        for _ in range(most):
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if taken is None:
                break
            waiting.append(taken)
        return waiting

    def take(message: Any, info: dict[str, int]) -> None:
        has_just_come = 0 <= time.time_ns() - info['received_timestamp'] <= _HELD_UP_NS
        waiting = ((message, info),) if has_just_come else take_waiting(message, info)
        for each in earlier:
            for _ in range(each.qos_profile.depth):
                if not take_and_call(each):
                    break
        for message, info in waiting:
            callback(message, info)

    return take


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
        entry, keep = TOPICS[topic], partial(self._keep, topic)
        if entry.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            return subscribe(self._node, topic, keep, newest=1, raw=True, group=self._group)
        qos = copy(entry.qos)
        qos.depth, qos.reliability = 1, ReliabilityPolicy.BEST_EFFORT
        return self._node.create_subscription(
            entry.message_type, topic, keep, qos, callback_group=self._group, raw=True
        )

    def _keep(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        self._newest[topic] = data
        self._arrived(info)
