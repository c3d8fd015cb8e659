"""Encoder node: (q, q̇) on `configuration` becomes (ξ, ξ̇) on `latent_state`."""

from __future__ import annotations

import sys
import time

import numpy as np
from rclpy.context import Context
from sensor_msgs.msg import JointState

from dpc_ros.control import Answers, OnlineEncoder
from dpc_ros.nodes.loop_node import LoopNode, run_node
from dpc_ros.nodes.messages import (
    MessageError,
    from_stamp,
    latent_names,
    read_state,
    state_message,
)


class EncoderNode(LoopNode):
    """Compresses each configuration by the encoder and its Jacobian."""

    def __init__(self, context: Context | None = None) -> None:
        super().__init__('encoder', context)

    def configure(self) -> None:
        self._encoder = OnlineEncoder(self.settings)
        network, checkpoint = self._encoder.network, self._encoder.checkpoint
        self._network_identifier = network.identifier
        self._coordinate_names = network.coordinate_names
        self._identifier = checkpoint.identifier
        self._names = latent_names(self._encoder.autoencoder.latent_size)
        self._answers = Answers()
        rest = network.rest_configuration
        self._encoder.encode(rest, np.zeros_like(rest))  # warm up
        self._encoder.restart()
        self._latent_state = self.create_output('latent_state')
        self.create_input('configuration', self._encode)

    def _encode(self, message: JointState, info: dict[str, int]) -> None:
        if not (self.receive('configuration', info) and self.matched(self._latent_state)):
            return
        begin = time.perf_counter()
        try:
            configuration, velocity = read_state(
                message, self._network_identifier, self._coordinate_names
            )
        except MessageError as error:
            self.reject('configuration', error)
            return
        stamp = from_stamp(message.header.stamp)
        answer = self._answers.repeated(stamp, message)
        if answer is None:
            if self._answers.starts_epoch(stamp):
                self._encoder.restart()
            latent, latent_velocity = self._encoder.encode(configuration, velocity)
            answer = state_message(
                message.header.stamp, self._identifier, latent, latent_velocity, self._names
            )
            self._answers.remember(stamp, message, answer)
        else:
            self.health.repeated += 1
        self.publish(self._latent_state, answer)
        self.health.processed(time.perf_counter() - begin)


def main(arguments: list[str] | None = None) -> None:
    """Run the node as a process."""
    sys.exit(run_node(EncoderNode, arguments))


if __name__ == '__main__':
    main()
