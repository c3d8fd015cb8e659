"""Controller node: (ξ, ξ̇) on `latent_state` becomes the force on `control_force`."""

from __future__ import annotations

import secrets
import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from rcl_interfaces.msg import ParameterEvent
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.timer import Timer
from sensor_msgs.msg import JointState

from dpc_ros.bag.force_frame import force_frame
from dpc_ros.control import (
    Answers,
    BackgroundSolver,
    OnlineController,
    Target,
    TargetError,
    load_target,
)
from dpc_ros.nodes.health import NO_WATCHDOG, WATCHDOG_OK
from dpc_ros.nodes.loop_node import LoopNode, run_node
from dpc_ros.nodes.messages import (
    MessageError,
    latent_names,
    parameters_message,
    read_stamp,
    to_stamp,
)
from dpc_ros.nodes.target_messages import read_target, target_message
from dpc_ros.nodes.topics import MOST_STATES
from dpc_ros.nodes.wire import StateReader, force_pattern

_NO_LATENT_STATE = 'no new latent_state: zero force is commanded until there is one'


class ControllerNode(LoopNode):
    """Answers each latent state with the force of its control law.

    Where no new one comes for a while it commands zero force, once, as it does for a state that
    the law has no finite force for.
    """

    def __init__(self, context: Context | None = None) -> None:
        super().__init__('controller', context)
        self._solver: BackgroundSolver | None = None
        self._watchdog: Timer | None = None

    def configure(self) -> None:
        settings = self.settings
        self._solver = (
            BackgroundSolver(settings, self.report) if settings['solve_in_background'] else None
        )
        self._controller = OnlineController(settings, self._solver, self.report)
        self._network = self._controller.network
        identifier = self._controller.checkpoint.identifier
        self.health.readings |= {
            'network': self._network.identifier,
            'checkpoint': identifier,
        }
        self._latent_size = self._controller.law.system.latent_size
        self._latent_states = StateReader(identifier, latent_names(self._latent_size))
        own = settings['actuated_mass'], secrets.token_hex(4)  # tells this controller from others
        self._forces = force_pattern(force_frame(*own))
        self._releases = force_pattern(force_frame(*own, is_release=True))
        self._answers = Answers()
        self._first_target: Target | None = None
        if settings['target']:
            self._first_target = load_target(settings['target'], self._network)
            self._controller.prepare(self._first_target)  # a bad one is refused now
        else:
            self._controller.warm_up()
        self._control_force = self.create_output('control_force')
        self._target_publisher = self.create_output('target') if self._first_target else None
        self._target_in_force = self.create_output('target_in_force')
        self._parameters_in_force = self.create_output('parameters_in_force')
        self._announced: Mapping[str, Any] = {}  # on `parameters_in_force`
        # Of what is ready together these run first: what has come by then counts for the state.
        if settings['replayed_parameters']:
            self.create_input('parameters', self._replay_parameters)
        self.create_input('target', self._take_target)
        self.create_input('latent_state', self._control, MOST_STATES, raw=True)

    def activate(self) -> None:
        self._controller.restart()
        if self.settings['latent_timeout']:
            self._watchdog = self.create_timer(
                self.settings['latent_timeout'], self._fall_silent, clock=self._steady_clock
            )
            self._watchdog.cancel()  # until the first force
            self.health.watchdog = WATCHDOG_OK
        if self._first_target is None:
            self.say('waiting for a target on the topic')
        elif self._target_publisher is not None:
            self._target_publisher.publish(
                target_message(self._first_target, self._network.identifier)
            )

    def deactivate(self) -> None:
        if self._watchdog is not None:
            self.destroy_timer(self._watchdog)
        self._watchdog = None
        self.health.watchdog = NO_WATCHDOG

    def clean_up(self) -> None:
        self.deactivate()
        if self._solver is not None:
            self._solver.close()
        self._solver = None

    def check_change(self, settings: Mapping[str, Any]) -> None:
        self._controller.check(settings)

    def change(self, settings: Mapping[str, Any]) -> None:
        self._controller.change(settings)

    def _replay_parameters(self, message: ParameterEvent) -> None:
        try:
            given = [
                Parameter.from_parameter_msg(each)
                for each in (*message.new_parameters, *message.changed_parameters)
                if each.name in self.settings['replayed_parameters']
            ]
        except ValueError as error:  # a type that there is none of
            self.reject('parameters', MessageError(str(error)))
            return
        result = self.set_parameters_atomically(given)
        if not result.successful:
            self.reject('parameters', MessageError(result.reason))

    def _take_target(self, message: JointState) -> None:
        try:
            stamp = read_stamp(message.header.stamp)
            target = read_target(
                message, self._network.identifier, self._network.coordinate_names, self._latent_size
            )
            self._controller.add_target(stamp, target)
        except (MessageError, TargetError) as error:
            self.reject('target', MessageError(str(error)))

    def _control(self, data: bytes, info: dict[str, int]) -> None:
        if not (self.receive('latent_state', info) and self.matched(self._control_force)):
            return
        begin = time.perf_counter()
        try:
            state = self._latent_states.read(data)
        except MessageError as error:
            self.reject('latent_state', error)
            return
        stamp, latent, latent_velocity = state
        answer = self._answers.repeated(stamp, state.content)
        if answer is None:
            if self._answers.starts_epoch(stamp):
                self._controller.begin_epoch()
            self._bring_in_force(stamp)
            if not self._controller.has_target:
                self.say('waiting for a target on the topic')
                return
            try:
                force = self._controller.force(latent, latent_velocity, stamp)
            except Exception as error:  # whatever goes wrong in a law that is not ours
                problem = f'control law: {error}, so that zero force is commanded'
                self.reject('latent_state', MessageError(problem))
                force = np.zeros(2)
            else:
                self.health.saturated += self._controller.law.saturated
            answer = self._forces.write(stamp, force)
            self._answers.remember(stamp, state.content, answer)
            if self._watchdog is not None:
                self._watchdog.reset()
                self.health.watchdog = WATCHDOG_OK
        else:
            self.health.repeated += 1
        self.publish(self._control_force, answer)
        self.health.processed(time.perf_counter() - begin)

    def _fall_silent(self) -> None:
        """Let go of the body; silent until the next state."""
        assert self._watchdog is not None
        self._watchdog.cancel()
        if not self.active:
            return
        newest, _ = self._answers.newest
        self.publish(self._control_force, self._releases.write(newest, np.zeros(2)))
        self.health.watchdog = _NO_LATENT_STATE
        self.say(_NO_LATENT_STATE, problem=True)

    def _bring_in_force(self, stamp: int) -> None:
        """Let new targets and parameters count from a state on, and tell logs so."""
        for change in self._controller.bring_in_force(stamp):
            if change.target is None and change.problem:
                self.reject('parameters', MessageError(change.problem))
                self._show_wanted_parameters()
            elif change.problem:
                self.reject('target', MessageError(change.problem))
            elif change.target is not None:
                self._target_in_force.publish(
                    target_message(change.target, self._network.identifier, stamp)
                )
        if self._controller.parameters is not self._announced:
            self._parameters_in_force.publish(
                parameters_message(
                    self.get_fully_qualified_name(),
                    to_stamp(stamp),
                    self._announced,
                    self._controller.parameters,
                )
            )
            self._announced = self._controller.parameters

    def _show_wanted_parameters(self) -> None:
        """Let the node's parameters say again what is in force, after new ones were of no use."""
        self.set_parameters_atomically(
            [Parameter(name, value=value) for name, value in self._controller.wanted.items()]
        )


def main(arguments: list[str] | None = None) -> None:
    """Run the node as a process."""
    sys.exit(run_node(ControllerNode, arguments))


if __name__ == '__main__':
    main()
