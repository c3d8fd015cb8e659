"""The floor of the closed loop: bare rclpy nodes that pass its messages on and compute nothing.

    python test/benchmarks/bare_loop.py TRIPS FILE simulator [encoder controller]

The nodes of one process share one wait set, which is built once. The one that stands for the
simulator leads: it writes how long each round trip took [s]. Without it the process goes on until
it is told to stop. Messages have the types, sizes and quality of service of the loop, and are made
once.
"""

import json
import sys
import time
from array import array
from pathlib import Path

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.impl.implementation_singleton import rclpy_implementation
from sensor_msgs.msg import JointState

from dpc_ros.nodes.discovery import prompt_dds
from dpc_ros.nodes.messages import to_stamp
from dpc_ros.nodes.topics import TOPICS

COORDINATES, LATENTS = 400, 5
RESEND_NS = 200_000_000  # after which the leader asks again, as until all nodes are there


def _state(size):
    values = array('d', bytes(8 * size))
    return JointState(position=values, velocity=values)


LOOP = {
    'simulator': ('control_force', 'configuration', _state(COORDINATES)),
    'encoder': ('configuration', 'latent_state', _state(LATENTS)),
    'controller': ('latent_state', 'control_force', WrenchStamped()),
}


class Relay:
    """A node that answers each message by its own one, with the same stamp."""

    def __init__(self, kind):
        source, target, self.message = LOOP[kind]
        self.type = TOPICS[source].message_type
        self.node = rclpy.create_node(kind)
        self.publisher = self.node.create_publisher(
            TOPICS[target].message_type, target, TOPICS[target].qos
        )
        self.handle = self.node.create_subscription(
            self.type, source, lambda _: None, TOPICS[source].qos
        ).handle

    def answer(self, message):
        self.message.header.stamp = message.header.stamp
        self.publisher.publish(self.message)


class Leader(Relay):
    """The relay that begins each round trip and measures it."""

    def __init__(self, kind):
        super().__init__(kind)
        self.trips = []
        self.ask()

    def ask(self):
        """Publish with the stamp of this trip; again, where no answer has come."""
        self.stamp = to_stamp(len(self.trips))
        self.message.header.stamp = self.stamp
        self.asked = time.perf_counter()
        self.publisher.publish(self.message)

    def answer(self, message):
        if message.header.stamp == self.stamp:
            self.trips.append(time.perf_counter() - self.asked)
            self.ask()


def relay(relays, is_over):
    """Pass messages on until it is over."""
    context = rclpy.get_default_context()
    by_pointer = {each.handle.pointer: each for each in relays}
    with context.handle:
        wait_set = rclpy_implementation.WaitSet(len(relays), 0, 0, 0, 0, 0, context.handle)
    for each in relays:
        each.handle.__enter__()
    while context.ok() and not is_over():
        wait_set.clear_entities()
        for each in relays:
            wait_set.add_subscription(each.handle)
        wait_set.wait(RESEND_NS)
        ready = wait_set.get_ready_entities('subscription')
        for pointer in ready:
            each = by_pointer[pointer]
            taken = each.handle.take_message(each.type, False)
            if taken is not None:
                each.answer(taken[0])
        if not ready and isinstance(relays[0], Leader):
            relays[0].ask()
    for each in relays:
        each.handle.__exit__(None, None, None)


def main(trips, file, *kinds):
    with prompt_dds():
        rclpy.init()
    relays = [Leader(kind) if kind == 'simulator' else Relay(kind) for kind in kinds]
    leads = isinstance(relays[0], Leader)
    relay(relays, lambda: leads and len(relays[0].trips) >= int(trips))
    if leads:
        Path(file).write_text(json.dumps(relays[0].trips))
    rclpy.try_shutdown()


if __name__ == '__main__':
    main(*sys.argv[1:])
