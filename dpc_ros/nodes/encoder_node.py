"""Encoder node: (q, q̇) on `configuration` becomes (ξ, ξ̇) on `latent_state`."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from rclpy.context import Context
from rclpy.timer import Timer

from dpc_ros.control import Answers, Controllers, DelayMeter, OnlineEncoder
from dpc_ros.nodes.health import NO_WATCHDOG, WATCHDOG_OK
from dpc_ros.nodes.loop_node import LoopNode, run_node
from dpc_ros.nodes.messages import MessageError, check_within, hear_controller, latent_names
from dpc_ros.nodes.topics import MOST_STATES
from dpc_ros.nodes.turns import Turns
from dpc_ros.nodes.wire import ForceReader, StateMessage, StateReader, state_pattern

if TYPE_CHECKING:
    from dpc_ros.control import LatentObserver

_WATCH_PERIOD = 0.05  # s between two looks whether configurations come
_STALE = 'configuration is stale'
_CLOCKS_DIFFER = 'no loop has the delay that was measured: synchronise the clocks of the hosts'


class EncoderNode(LoopNode):
    """Compresses each configuration by the encoder and its Jacobian, and estimates, if asked to.

    An observer has to know the force that answered the state before: a configuration waits for it.
    """

    def __init__(self, context: Context | None = None) -> None:
        super().__init__('encoder', context)
        self._watchdog: Timer | None = None

    def configure(self) -> None:
        settings = self.settings
        self._encoder = OnlineEncoder(settings)
        network, checkpoint = self._encoder.network, self._encoder.checkpoint
        self._delay = DelayMeter() if settings['measure_delay'] else None
        self._mass = settings['actuated_mass']
        self._rest = network.rest_configuration
        self._controllers = Controllers(settings['controller_timeout'])
        self._configurations = StateReader(network.identifier, network.coordinate_names)
        self._forces = ForceReader()
        self.health.readings |= {
            'network': network.identifier,
            'checkpoint': checkpoint.identifier,
        }
        names = latent_names(self._encoder.autoencoder.latent_size)
        self._latent_states = state_pattern(checkpoint.identifier, len(names), names)
        self._answers = Answers()
        self._begin_anew()
        self._encoder.warm_up()
        self._latent_state = self.create_output('latent_state')
        # An observer that has no time for a state bridges it, rather than be late for all others.
        observes = self._encoder.observer is not None
        newest = 1 if observes else MOST_STATES
        self.create_input('configuration', self._take_configuration, newest, raw=True)
        if observes:
            self.create_input('control_force', self._take_force, raw=True)

    def activate(self) -> None:
        self._begin_anew()
        self._came_at: float | None = None
        self._watchdog = self.create_rare_timer(_WATCH_PERIOD, self._watch)

    def deactivate(self) -> None:
        if self._watchdog is not None:
            self.destroy_timer(self._watchdog)
        self._watchdog = None
        self.health.watchdog = NO_WATCHDOG

    def clean_up(self) -> None:
        self.deactivate()

    def change(self, settings: Mapping[str, Any]) -> None:
        self._controllers.timeout = settings['controller_timeout']

    def _begin_anew(self) -> None:
        self._encoder.restart()
        self._turns = Turns()

    def _take_configuration(self, data: bytes, info: dict[str, int]) -> None:
        if not (self.receive('configuration', info) and self.matched(self._latent_state)):
            return
        try:
            state = self._configurations.read(data)
            self._check_plausible(state.position, state.velocity)
        except MessageError as error:
            self.reject('configuration', error)
            return
        stamp = state.stamp
        self._came_at = self.steady_time()
        if self._delay is not None:
            if self._answers.starts_epoch(stamp):
                self._delay.restart()
            self._delay.configuration(
                stamp,
                info['publication_sequence_number'],
                info['source_timestamp'],
                info['received_timestamp'],
            )
        repeated = self._answers.repeated(stamp, state.content)
        if repeated is None and self._answers.begins_anew(stamp):
            self._begin_anew()
        if repeated is None and self._turns.waits(stamp):
            _, repeated = self._answers.newest  # the controller repeats the force that is missing
        if repeated is not None:
            self.health.repeated += 1
            self.publish(self._latent_state, repeated)
        elif self._encoder.observer is None:
            self._answer(state)
        else:
            for each in self._turns.come(stamp, state):
                self._answer(each)

    def _take_force(self, data: bytes, info: dict[str, int]) -> None:
        if not self.receive('control_force', info):
            return
        newest, _ = self._answers.newest
        if newest < 0:
            return  # the answer to an encoder that was here before
        try:
            stamp, frame, force = self._forces.read(data)
            if frame.mass != self._mass:
                raise MessageError(f'expected mass {self._mass}, got {frame.mass}')
            if self._answers.is_of_former_epoch(stamp):
                self.health.repeated += 1
                return
            if stamp > newest:
                raise MessageError('its stamp is that of no state so far')
            hear_controller(self._controllers, frame, self.steady_time())
            if frame.is_release:
                return
        except MessageError as error:
            self.reject('control_force', error)
            return
        observer = self._encoder.observer
        assert observer is not None
        if self._delay is not None:
            self._measure(self._delay, observer, stamp, info['received_timestamp'])
        observer.acted(stamp, force)
        for each in self._turns.answered(stamp):
            self._answer(each)

    def _check_plausible(self, configuration: np.ndarray, velocity: np.ndarray) -> None:
        displacement = configuration - self._rest
        check_within(displacement, self.settings['largest_displacement'], 'displacement', 'm')
        check_within(velocity, self.settings['largest_speed'], 'speed', 'm/s')

    def _watch(self) -> None:
        """Report where no configuration has come for too long; nothing is published meanwhile."""
        longest = self.settings['configuration_timeout']
        is_stale = (
            self._came_at is not None
            and 0 < longest < self.steady_time() - self._came_at
            and self.active
        )
        self.health.watchdog = _STALE if is_stale else WATCHDOG_OK
        if is_stale:
            self.say(_STALE)

    def _warn(self, problem: str, holds: bool) -> None:
        """Report a problem while it holds."""
        if holds:
            self.health.warning = problem
            self.say(problem)
        elif self.health.warning == problem:
            self.health.warning = ''

    def _measure(
        self, delay: DelayMeter, observer: LatentObserver, stamp: int, received: int
    ) -> None:
        delay.force(stamp, received)
        observer.delay = delay.acting_delay
        if delay.delay is not None:
            self.health.readings['measured delay [ms]'] = f'{1e3 * delay.delay:.3f}'
            self.health.readings['foreseen delay [ms]'] = f'{1e3 * observer.delay:.3f}'
        self._warn(_CLOCKS_DIFFER, not delay.is_believable)

    def _answer(self, state: StateMessage) -> None:
        begin = time.perf_counter()
        stamp, configuration, velocity = state
        try:
            latent, latent_velocity = self._encoder.encode(configuration, velocity, stamp)
        except Exception as error:  # whatever an encoder of another package raises, too
            self.reject('configuration', MessageError(f'encoder: {error}'))
            return
        answer = self._latent_states.write(stamp, latent, latent_velocity)
        self._answers.remember(stamp, state.content, answer)
        self.publish(self._latent_state, answer)
        self.health.processed(time.perf_counter() - begin)


def main(arguments: list[str] | None = None) -> None:
    """Run the node as a process."""
    sys.exit(run_node(EncoderNode, arguments))


if __name__ == '__main__':
    main()
