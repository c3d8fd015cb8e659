"""Simulator node: integrates the body under `control_force` and publishes its `configuration`."""

from __future__ import annotations

import math
import sys
import time

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.qos import QoSProfile
from rclpy.service import Service
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import SetBool, Trigger

from dpc_ros.bag.topic import NANOSECONDS
from dpc_ros.control import LONGEST_GAP
from dpc_ros.network import Body, Gravity, Integrator, Mechanics, load_network
from dpc_ros.nodes.health import NO_WATCHDOG, WATCHDOG_OK
from dpc_ros.nodes.loop_node import LoopNode, run_node
from dpc_ros.nodes.messages import MessageError, from_stamp, read_force, state_message, to_stamp
from dpc_ros.nodes.topics import Topic

_RESET_LEAP = 2 * LONGEST_GAP  # s of the stamps, by which encoder and controller see a reset


class SimulatorNode(LoopNode):
    """Advances the body in lockstep with the controller, or by the wall clock.

    State k carries the stamp k·step, and more by a leap for each reset; `_awaited` is the stamp of
    the state published last. In lockstep the force with that stamp starts the next step. In
    realtime the first force starts a wall timer, which steps under the force that came last.
    """

    def __init__(self, context: Context | None = None) -> None:
        super().__init__('simulator', context)
        self._commands: list[Service] = []
        self._stepper: Timer | None = None
        self._watchdog: Timer | None = None

    def configure(self) -> None:
        settings = self.settings
        network = load_network(settings['network'])
        gravity = Gravity(settings['gravity_magnitude'], settings['gravity_angle'])
        self._step_ns = round(NANOSECONDS / settings['rate'])
        integrator = Integrator(
            Mechanics(network, gravity), self._step_ns / NANOSECONDS, settings['integrator']
        )
        self._body = Body(integrator, settings['actuated_mass'])
        self._body.advance(np.zeros(2))  # compiles the kernels
        self._body.reset()
        self._identifier = self.health.readings['network'] = network.identifier
        self._names = network.coordinate_names if settings['publish_names'] else []
        self._last_step = math.ceil(settings['duration'] * NANOSECONDS / self._step_ns)
        self._realtime = settings['time_mode'] == 'realtime'
        self._step = 0
        self._leapt = 0  # steps left out of the stamps
        self._reset_at = 0  # stamp of the first state since the last reset [ns]
        self._answered = False  # the present state has been, by a force with its stamp
        self._running = False  # a first force has come
        self._paused = False
        self._force = np.zeros(2)
        self._pushes: dict[int, tuple[int, np.ndarray]] = {}
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._configuration = self.create_output('configuration')
        self._clock_publisher = (
            self.create_output('/clock', Topic(ClockMessage, QoSProfile(depth=1)))
            if settings['publish_clock']
            else None
        )
        self.create_input('control_force', self._take_force)
        self.create_input('external_force', self._take_push)
        self._commands = [
            self.create_service(Trigger, '~/reset', self._reset),
            self.create_service(SetBool, '~/pause', self._pause),
            self.create_service(Trigger, '~/step', self._single_step),
        ]

    def activate(self) -> None:
        self._published_at = self._answered_at = self._now()
        self._watchdog = self.create_timer(
            self.settings['resend_interval'], self._watch, clock=self._wall
        )
        self._publish_state()

    def deactivate(self) -> None:
        for timer in (self._watchdog, self._stepper):
            if timer is not None:
                self.destroy_timer(timer)
        self._watchdog = self._stepper = None
        self._running = False
        self.health.watchdog = NO_WATCHDOG

    def clean_up(self) -> None:
        self.deactivate()
        for service in self._commands:
            self.destroy_service(service)
        self._commands = []

    @property
    def _awaited(self) -> int:
        """Stamp of the present state [ns]."""
        return (self._step + self._leapt) * self._step_ns

    @property
    def _at_end(self) -> bool:
        return self._step >= self._last_step > 0

    def _take_force(self, message: WrenchStamped, info: dict[str, int]) -> None:
        if not self.receive('control_force', info):
            return
        try:
            mass, force = read_force(message)
            if mass != self._body.actuated_mass:
                raise MessageError(f'expected mass {self._body.actuated_mass}, got {mass}')
        except MessageError as error:
            self.reject('control_force', error)
            return
        stamp = from_stamp(message.header.stamp)
        if stamp > self._awaited:
            self.reject('control_force', MessageError('its stamp is that of no state so far'))
            return
        self.health.round_trips.answered(stamp)
        if stamp == self._awaited and not self._answered:
            self._answered = True
        elif not self._realtime or stamp < self._reset_at:
            self.health.repeated += 1  # of a state that was published twice, or before a reset
            return
        self._force = force
        self._answered_at = self._now()
        if self._at_end:
            self.finished = self._answered
        elif self._realtime:
            self._start_stepping()
        elif not self._paused:
            self._advance()

    def _start_stepping(self) -> None:
        if self._running:
            return
        self._running = True
        period = self._body.integrator.step / self.settings['real_time_factor']
        self._stepper = self.create_timer(period, self._tick, clock=self._wall)

    def _tick(self) -> None:
        if self._paused or not self.active or self._at_end:
            return
        if self._now() - self._answered_at > self.settings['force_timeout']:
            self.say(f'control_force is stale, using {self.settings["stale_force"]}', problem=True)
            self.health.watchdog = 'control_force is stale'
            if self.settings['stale_force'] == 'zero':
                self._force = np.zeros(2)
        else:
            self.health.watchdog = WATCHDOG_OK
        self._advance()

    def _advance(self) -> None:
        begin = time.perf_counter()
        self._running = True
        self._pushes = {m: push for m, push in self._pushes.items() if push[0] > self._awaited}
        self._body.advance(self._force, {mass: push for mass, (_, push) in self._pushes.items()})
        if not np.isfinite(self._body.configuration).all():
            self.fail(
                f'the body diverged at {self._awaited / NANOSECONDS:g} s: '
                'lower the gains, or raise the rate'
            )
            return
        self._step += 1
        self._answered = False
        self._publish_state()
        self.health.processed(time.perf_counter() - begin)

    def _publish_state(self) -> None:
        if not self.matched(self._configuration):
            return
        stamp = to_stamp(self._awaited)
        if self._clock_publisher is not None:
            self._clock_publisher.publish(ClockMessage(clock=stamp))
        self.health.round_trips.sent(self._awaited)
        self.publish(
            self._configuration,
            state_message(
                stamp, self._identifier, self._body.configuration, self._body.velocity, self._names
            ),
        )
        self._published_at = self._now()

    def _watch(self) -> None:
        """Publish an unanswered state again, give up after the time-out."""
        if not self.active or self._answered or (self._running and not self._must_answer):
            return
        which = 'response_timeout' if self._running else 'startup_timeout'
        limit = self.settings[which]
        if self._paused or limit == 0:
            limit = math.inf
        if self._now() - self._answered_at > limit:
            self.fail(self._timeout_reason(which, limit))
            return
        if not self._running:
            self.say('waiting for the first control_force')
        if self._now() - self._published_at >= self.settings['resend_interval']:
            self._publish_state()

    @property
    def _must_answer(self) -> bool:
        """Whether the run can't go on without the force for the present state."""
        return self._running and (not self._realtime or self._at_end)

    def _timeout_reason(self, parameter: str, limit: float) -> str:
        readers = self._configuration.get_subscription_count()
        writers = self.count_publishers('control_force')
        return (
            f'no control_force for the state at {self._awaited / NANOSECONDS:g} s within '
            f'{parameter} = {limit:g} s (configuration has {readers} subscriptions, control_force '
            f'{writers} publishers): are encoder and controller running, and has the controller '
            'a target?'
        )

    def _take_push(self, message: WrenchStamped, info: dict[str, int]) -> None:
        if not self.receive('external_force', info):
            return
        try:
            mass, force = read_force(message)
            limit = self.settings['force_limit']
            if np.hypot(*force) > limit:
                raise MessageError(f'expected at most {limit:g} N, got {np.hypot(*force):g}')
            self._body.network.mobile_index(mass)
        except ValueError as error:
            self.reject('external_force', MessageError(str(error)))
            return
        end = self._awaited + round(self.settings['external_force_timeout'] * NANOSECONDS)
        self._pushes[mass] = (end, force)

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._body.reset()
        self._force = np.zeros(2)
        self._pushes.clear()
        self._leapt += math.ceil(_RESET_LEAP * NANOSECONDS / self._step_ns)  # stamps rise for ever
        self._reset_at = self._awaited
        self._answered = False
        self._answered_at = self._now()
        if self.active:
            self._publish_state()
        response.success = True
        return response

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._paused = request.data
        self._answered_at = self._now()
        if not self._paused and self._answered and not self._realtime and self.active:
            self._advance()
        response.success = True
        return response

    def _single_step(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        if self._paused and self.active and not self._at_end and (self._realtime or self._answered):
            self._advance()
            response.success = not self.failure
        else:
            response.message = 'expected a paused simulator whose state has been answered'
        return response

    def _now(self) -> float:
        return self._wall.now().nanoseconds / NANOSECONDS


def main(arguments: list[str] | None = None) -> None:
    """Run the node as a process."""
    sys.exit(run_node(SimulatorNode, arguments))


if __name__ == '__main__':
    main()
