"""What people who look on want of the loop, carried out by its topics and services."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from jaxtyping import Float
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from dpc_ros.control import Target
from dpc_ros.nodes.messages import force_message, to_stamp
from dpc_ros.nodes.target_messages import target_message
from dpc_ros.nodes.topics import TOPICS

Tell = Callable[[str, bool], None]
_LONGEST_CALL = 20.0  # s; a controller in lockstep solves for new gains first


class Commands:
    """Takes wishes from any thread, and carries them out in the one of the node.

    Args:
        node: through which to ask.
        frame_id: of targets that are configurations: the network's identifier.
        tell: is called with what has come of a wish, and whether that is a problem.
        record: is called with whether a log is wanted.

    Attributes:
        accepts: whether wishes are taken; else they are refused at once.
        stamp: of the newest state that is known [ns], which pushes carry.
    """

    def __init__(
        self,
        node: Node,
        frame_id: str,
        tell: Tell,
        record: Callable[[bool], None],
    ) -> None:
        self._node, self._frame_id = node, frame_id
        self._tell, self._record = tell, record
        self.accepts = False
        self.stamp = 0
        self._wishes: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._calls: dict[Future, tuple[float, Client]] = {}  # until when [s] each may take
        self._targets: Publisher | None = None
        self._given: np.ndarray | None = None  # the target that is on its way
        self._pushes = node.create_publisher(
            WrenchStamped, 'external_force', TOPICS['external_force'].qos
        )
        self._services: dict[str, Client] = {
            'pause': node.create_client(SetBool, 'simulator/pause'),
            'step': node.create_client(Trigger, 'simulator/step'),
            'reset': node.create_client(Trigger, 'simulator/reset'),
            'tune': node.create_client(
                SetParametersAtomically, 'controller/set_parameters_atomically'
            ),
        }

    def carry_out(self) -> None:
        """Do what has been wished for since the last time; give up calls that nobody answers."""
        while True:
            try:
                wish = self._wishes.get_nowait()
            except Empty:
                break
            wish()
        now = time.monotonic()
        late = [future for future, (latest, _) in self._calls.items() if now > latest]
        for future in late:
            _, client = self._calls.pop(future)
            client.remove_pending_request(future)
            self._tell(f'{client.service_name} does not answer', True)

    def in_force(self, value: Float[np.ndarray, ' k']) -> None:
        """Note which target is in force: once it is, nobody who comes later shall get it again."""
        if self._given is not None and np.array_equal(value, self._given):
            assert self._targets is not None
            self._node.destroy_publisher(self._targets)
            self._targets = self._given = None

    def close(self) -> None:
        """Let go of everything."""
        for client in self._services.values():
            self._node.destroy_client(client)
        for publisher in (self._pushes, self._targets):
            if publisher is not None:
                self._node.destroy_publisher(publisher)

    def pause(self, paused: bool) -> None:
        request = SetBool.Request(data=paused)
        self._wish(lambda: self._call('pause', request, self._answered))

    def step(self) -> None:
        self._wish(lambda: self._call('step', Trigger.Request(), self._answered))

    def reset(self) -> None:
        self._wish(lambda: self._call('reset', Trigger.Request(), self._answered))

    def aim(self, target: Target) -> None:
        self._wish(lambda: self._aim(target))

    def push(self, mass: int, force: Float[np.ndarray, ' 2']) -> None:
        self._wish(lambda: self._pushes.publish(force_message(to_stamp(self.stamp), mass, force)))

    def tune(self, parameters: Mapping[str, Any]) -> None:
        request = SetParametersAtomically.Request(
            parameters=[
                Parameter(name, value=value).to_parameter_msg()
                for name, value in parameters.items()
            ]
        )
        done = partial(self._tuned, parameters)
        if parameters:
            self._wish(lambda: self._call('tune', request, done))

    def record(self, recording: bool) -> None:
        self._wish(lambda: self._record(recording))

    def _wish(self, wish: Callable[[], None]) -> None:
        if self.accepts:
            self._wishes.put(wish)
        else:
            self._tell(f'{self._node.get_name()} is not active', True)

    def _aim(self, target: Target) -> None:
        if self._targets is None:
            entry = TOPICS['target']
            self._targets = self._node.create_publisher(entry.message_type, 'target', entry.qos)
        self._given = target.value
        self._targets.publish(target_message(target, self._frame_id))

    def _call(self, name: str, request: Any, done: Callable[[Any], None]) -> None:
        client = self._services[name]
        if not client.service_is_ready():
            self._tell(f'{client.service_name}: expected this service, is its node running?', True)
            return
        future = client.call_async(request)
        self._calls[future] = (time.monotonic() + _LONGEST_CALL, client)
        future.add_done_callback(partial(self._done, done))

    def _done(self, done: Callable[[Any], None], future: Future) -> None:
        _, client = self._calls.pop(future, (0.0, None))
        if client is None:
            return
        if future.exception() is not None:
            self._tell(f'{client.service_name}: {future.exception()}', True)
        elif future.result() is not None:
            done(future.result())

    def _answered(self, response: Trigger.Response | SetBool.Response) -> None:
        if not response.success:
            self._tell(response.message, True)

    def _tuned(
        self, parameters: Mapping[str, Any], response: SetParametersAtomically.Response
    ) -> None:
        if response.result.successful:
            names = ', '.join(f'{name} = {value}' for name, value in parameters.items())
            self._tell(f'accepted, in force once it is solved for: {names}', False)
        else:
            self._tell(response.result.reason, True)
