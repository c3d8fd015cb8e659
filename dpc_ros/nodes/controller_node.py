"""Controller node: (ξ, ξ̇) on `latent_state` becomes the force on `control_force`."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
import yaml
from rclpy.context import Context
from sensor_msgs.msg import JointState

from dpc_ros.autoencoder import load_checkpoint, with_encoder
from dpc_ros.control import (
    LawSettings,
    Target,
    TargetSchedule,
    load_target,
    make_law,
)
from dpc_ros.network import Gravity, Mechanics, load_network
from dpc_ros.nodes.answers import Answers
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
from dpc_ros.nodes.parameters import ParameterError
from dpc_ros.reduction import CompressedSystem


class ControllerNode(LoopNode):
    """Answers each latent state with the force of its control law."""

    def __init__(self, context: Context | None = None) -> None:
        super().__init__('controller', context)

    def configure(self) -> None:
        settings = self.settings
        network = load_network(settings['network'])
        checkpoint = load_checkpoint(settings['checkpoint'])
        checkpoint.check_network(network)
        gravity = Gravity(settings['gravity_magnitude'], settings['gravity_angle'])
        autoencoder = with_encoder(
            checkpoint.autoencoder(), settings['encoder'], settings['projection_iterations']
        )
        system = CompressedSystem(
            Mechanics(network, gravity), autoencoder, settings['actuated_mass']
        )
        self._law = make_law(settings['law'], system, _law_settings(settings))
        self._network = network
        self._identifier = checkpoint.identifier
        self._names = latent_names(system.latent_size)
        self._mass = settings['actuated_mass']
        self._answers = Answers()
        self._schedule = TargetSchedule()
        self._seen_target: Target | None = None
        self._regulates = False
        self._first_target: Target | None = None
        if settings['target']:
            self._first_target = load_target(settings['target'], network)
            self._law.regulate(self._first_target)  # a bad target is refused now; warms up, too
        self._control_force = self.create_output('control_force')
        self._target_publisher = self.create_output('target') if self._first_target else None
        self.create_input('latent_state', self._control)
        self.create_input('target', self._take_target)

    def activate(self) -> None:
        self._law.restart()
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
        self._schedule.add(from_stamp(message.header.stamp), target)

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
                self._schedule.restart()
                self._law.restart()
            if not self._regulate(stamp):
                return
            try:
                force = self._law.force(latent, latent_velocity, stamp)
                if not (force.shape == (2,) and np.isfinite(force).all()):
                    raise ValueError(f'expected a finite force in the plane, got {force}')
            except Exception as error:  # whatever goes wrong in a law that is not ours
                self.reject('latent_state', MessageError(f'control law: {error}'))
                return
            self.health.saturated += self._law.saturated
            answer = force_message(message.header.stamp, self._mass, force)
            self._answers.remember(stamp, message, answer)
        else:
            self.health.repeated += 1
        self.publish(self._control_force, answer)
        self.health.processed(time.perf_counter() - begin)

    def _regulate(self, stamp: int) -> bool:
        """Give the law the target in force; return whether it has ever had one that it can use."""
        target = self._schedule.in_force(stamp)
        if target is None:
            self.say('waiting for a target on the topic')
        elif target is not self._seen_target:
            self._seen_target = target
            try:
                self._law.regulate(target)
                self._regulates = True
            except Exception as error:  # EquilibriumError, or what a law that is not ours raises
                self.reject('target', MessageError(str(error)))
        return self._regulates


def _law_settings(parameters: Mapping[str, Any]) -> LawSettings:
    """Return what the node's parameters say about the law: they have the names of its fields."""
    text = parameters['law_options']
    try:
        options = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ParameterError(f'law_options: expected YAML, got {text!r}') from error
    options = {} if options is None else options
    if not isinstance(options, dict):
        raise ParameterError(f'law_options: expected names and values as YAML, got {text!r}')
    numbers = {each.name for each in fields(LawSettings)} - {'options'}
    return LawSettings(**{name: parameters[name] for name in numbers}, options=options)


def main(arguments: list[str] | None = None) -> None:
    """Run the node as a process."""
    sys.exit(run_node(ControllerNode, arguments))


if __name__ == '__main__':
    main()
