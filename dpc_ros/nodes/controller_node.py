"""Controller node: (ξ, ξ̇) on `latent_state` becomes the force on `control_force`."""

from __future__ import annotations

import sys
import time

from rclpy.context import Context
from sensor_msgs.msg import JointState

from dpc_ros.control import Answers, OnlineController, Target, load_target
from dpc_ros.nodes.loop_node import LoopNode, run_node
from dpc_ros.nodes.messages import (
    MessageError,
    force_message,
    from_stamp,
    latent_names,
    read_state,
    read_target,
    target_message,
)


class ControllerNode(LoopNode):
    """Answers each latent state with the force of its control law."""

    def __init__(self, context: Context | None = None) -> None:
        super().__init__('controller', context)

    def configure(self) -> None:
        settings = self.settings
        self._controller = OnlineController(settings)
        self._controller.warm_up()
        self._network = self._controller.network
        self._identifier = self._controller.checkpoint.identifier
        self.health.readings |= {
            'network': self._network.identifier,
            'checkpoint': self._identifier,
        }
        self._names = latent_names(self._controller.law.system.latent_size)
        self._mass = settings['actuated_mass']
        self._answers = Answers()
        self._first_target: Target | None = None
        if settings['target']:
            self._first_target = load_target(settings['target'], self._network)
            self._controller.prepare(self._first_target)  # a bad one is refused now
        self._control_force = self.create_output('control_force')
        self._target_publisher = self.create_output('target') if self._first_target else None
        self._target_in_force = self.create_output('target_in_force')
        # Of what is ready together the target runs first: one that came before a latent state
        # counts for it.
        self.create_input('target', self._take_target)
        self.create_input('latent_state', self._control)

    def activate(self) -> None:
        self._controller.restart()
        if self._first_target is None:
            self.say('waiting for a target on the topic')
        elif self._target_publisher is not None:
            self._target_publisher.publish(
                target_message(self._first_target, self._network.identifier)
            )

    def _take_target(self, message: JointState) -> None:
        try:
            target = read_target(
                message, self._network.identifier, self._network.coordinate_names, len(self._names)
            )
        except MessageError as error:
            self.reject('target', error)
            return
        self._controller.add_target(from_stamp(message.header.stamp), target)

    def _control(self, message: JointState, info: dict[str, int]) -> None:
        if not (self.receive('latent_state', info) and self.matched(self._control_force)):
            return
        begin = time.perf_counter()
        try:
            latent, latent_velocity = read_state(message, self._identifier, self._names)
        except MessageError as error:
            self.reject('latent_state', error)
            return
        stamp = from_stamp(message.header.stamp)
        answer = self._answers.repeated(stamp, message)
        if answer is None:
            if self._answers.starts_epoch(stamp):
                self._controller.begin_epoch()
            if not self._regulate(stamp):
                return
            try:
                force = self._controller.force(latent, latent_velocity, stamp)
            except Exception as error:  # whatever goes wrong in a law that is not ours
                self.reject('latent_state', MessageError(f'control law: {error}'))
                return
            self.health.saturated += self._controller.law.saturated
            answer = force_message(message.header.stamp, self._mass, force)
            self._answers.remember(stamp, message, answer)
        else:
            self.health.repeated += 1
        self.publish(self._control_force, answer)
        self.health.processed(time.perf_counter() - begin)

    def _regulate(self, stamp: int) -> bool:
        """Give the law the target in force; return whether it has ever had one that it can use."""
        try:
            target = self._controller.regulate(stamp)
        except Exception as error:  # EquilibriumError, or what a law that is not ours raises
            self.reject('target', MessageError(str(error)))
        else:
            if target is not None:
                self._target_in_force.publish(
                    target_message(target, self._network.identifier, stamp)
                )
        if not self._controller.has_target:
            self.say('waiting for a target on the topic')
        return self._controller.has_target


def main(arguments: list[str] | None = None) -> None:
    """Run the node as a process."""
    sys.exit(run_node(ControllerNode, arguments))


if __name__ == '__main__':
    main()
