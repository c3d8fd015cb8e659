"""Simulator node: integrates the body under `control_force` and publishes its `configuration`."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.context import Context
from rclpy.qos import QoSProfile
from rclpy.service import Service
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import SetBool, Trigger

from dpc_ros.bag.topic import NANOSECONDS
from dpc_ros.control import LONGEST_GAP, Controllers, Patience, approach
from dpc_ros.finite import all_finite
from dpc_ros.network import Body, Gravity, Integrator, Mechanics, load_network
from dpc_ros.nodes.health import NO_WATCHDOG, PAUSED_READING, WATCHDOG_OK
from dpc_ros.nodes.loop_node import LoopNode, run_node
from dpc_ros.nodes.messages import (
    MessageError,
    hear_controller,
    read_force,
    read_stamp,
    to_stamp,
)
from dpc_ros.nodes.topics import Topic
from dpc_ros.nodes.wire import ForceReader, state_pattern

_RESET_LEAP = 2 * LONGEST_GAP  # s of the stamps, by which encoder and controller see a reset
_STALE = 'control_force is stale'
_MISSED = 'missed steps'  # whose time passed before the one before was over, or while stopped
_LIMITED = 'rate-limited steps'


class SimulatorNode(LoopNode):
    """Advances the body in lockstep with the controller, or by the wall clock.

    State k carries the stamp k·step, and more by a leap for each reset; `_awaited` is the stamp of
    the state published last. In lockstep the force with that stamp starts the next step. In
    realtime the first force starts a wall timer, which steps under the newest force.

    What commands the body must be one controller, and no force may be too strong: else it is
    rejected, the body waits in lockstep, and in realtime nothing acts from the next step on.
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
        self.health.readings['network'] = network.identifier
        self._states = state_pattern(
            network.identifier,
            network.configuration_size,
            network.coordinate_names if settings['publish_names'] else [],
        )
        self._forces = ForceReader()
        self._last_step = math.ceil(settings['duration'] * NANOSECONDS / self._step_ns)
        self._realtime = settings['time_mode'] == 'realtime'
        self._step = 0
        self._leapt = 0  # steps left out of the stamps
        self._answered = False  # the present state has been, by a force with its stamp
        self._running = False  # a first force has come
        self._set_paused(False)
        self._answer_stamp = -1  # of the newest force that was taken, or of the reset [ns]
        self._controllers = Controllers(settings['controller_timeout'])
        self._patience = Patience(settings['resend_interval'])
        self._refusal = ''  # why the last force was rejected, where none was taken since
        self._warned = ''
        self._limited = 0  # steps
        self._let_go()
        self._pushes: dict[int, tuple[int, np.ndarray]] = {}
        self._configuration = self.create_output('configuration')
        self._clock_publisher = (
            self.create_output('/clock', Topic(ClockMessage, QoSProfile(depth=1)))
            if settings['publish_clock']
            else None
        )
        self.create_input('control_force', self._take_force, raw=True)
        self.create_input('external_force', self._take_push)
        self._commands = [
            self.create_service(Trigger, '~/reset', self._reset),
            self.create_service(SetBool, '~/pause', self._pause),
            self.create_service(Trigger, '~/step', self._single_step),
        ]

    def activate(self) -> None:
        self._published_at = self.steady_time()
        self._begin_waiting()
        self._watchdog = self.create_rare_timer(self.settings['resend_interval'] / 2, self._watch)
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

    def change(self, settings: Mapping[str, Any]) -> None:
        self._controllers.timeout = settings['controller_timeout']
        if self._stepper is not None and self._factor != settings['real_time_factor']:
            self.destroy_timer(self._stepper)
            self._create_stepper()

    @property
    def _awaited(self) -> int:
        """Stamp of the present state [ns]."""
        return (self._step + self._leapt) * self._step_ns

    @property
    def _at_end(self) -> bool:
        return self._step >= self._last_step > 0

    def _take_force(self, data: bytes, info: dict[str, int]) -> None:
        if not self.receive('control_force', info):
            return
        try:
            stamp, frame, force = self._forces.read(data)
            if frame.mass != self._body.actuated_mass:
                raise MessageError(f'expected mass {self._body.actuated_mass}, got {frame.mass}')
            if stamp > self._awaited:
                raise MessageError('its stamp is that of no state so far')
            hear_controller(self._controllers, frame, self.steady_time())
            if self._is_passed(stamp) or (frame.is_release and not self._realtime):
                self.health.repeated += 1
                return
            self._check_strength(force, self.settings['control_force_limit'])
        except MessageError as error:
            if self._realtime:
                self._let_go()
            self._refuse_force(error)
            return
        self.health.round_trips.answered(stamp)
        self._force, self._answer_stamp, self._refusal = force, stamp, ''
        self._answered = self._answered or stamp == self._awaited
        self._begin_waiting()
        if self._at_end:
            self.finished = self._answered
        elif self._realtime:
            self._start_stepping()
        elif not self._paused:
            self._advance()

    def _is_passed(self, stamp: int) -> bool:
        """Return whether a force comes too late to count, or a second time.

        In realtime a second one for the newest state may take back the first.
        """
        if self._realtime:
            return stamp < self._answer_stamp
        return stamp != self._awaited or self._answered

    def _check_strength(self, force: np.ndarray, limit: float) -> None:
        strength = math.hypot(*force)
        if strength > limit:
            raise MessageError(f'expected at most {limit:g} N, got {strength:g}')

    def _refuse_force(self, error: MessageError) -> None:
        self._refusal = str(error)
        self.reject('control_force', error)
        self._warn()

    def _let_go(self) -> None:
        """Let no control force act from the next step on, however fast one may change."""
        self._force = self._acting = np.zeros(2)

    def _begin_waiting(self) -> None:
        self._answered_at = self.steady_time()
        self._patience.begin(self._answered_at)

    def _start_stepping(self) -> None:
        if self._stepper is not None:
            return
        self._running = True
        self.health.readings[_MISSED] = '0'
        self._missed = 0
        self._create_stepper()

    def _create_stepper(self) -> None:
        self._factor = self.settings['real_time_factor']
        period = self._body.integrator.step / self._factor
        self._stepper = self.create_timer(period, self._tick, clock=self._steady_clock)
        self._next_tick = (
            self._steady_clock.now().nanoseconds + self._stepper.time_until_next_call()
        )

    def _tick(self) -> None:
        self._count_missed()
        if self._paused or not self.active or self._at_end:
            return
        self._let_go_if_stale()
        self._warn()
        self._advance()

    def _let_go_if_stale(self) -> None:
        limit = self.settings['force_timeout']
        # It may have been long on its way: the state that it answers tells, in ticks.
        age_ns = (self._awaited - self._answer_stamp) / self.settings['real_time_factor']
        is_stale = age_ns > limit * NANOSECONDS or self.steady_time() - self._answered_at > limit
        if is_stale:
            self.say(f'control_force is stale, using {self.settings["stale_force"]}', problem=True)
            if self.settings['stale_force'] == 'zero':
                self._let_go()
        self.health.watchdog = _STALE if is_stale else WATCHDOG_OK

    def _count_missed(self) -> None:
        """Count the ticks that the timer has left out since the last one."""
        assert self._stepper is not None
        following = self._steady_clock.now().nanoseconds + self._stepper.time_until_next_call()
        missed = round((following - self._next_tick) / self._stepper.timer_period_ns) - 1
        self._next_tick = following
        if missed > 0:
            self._missed += missed
            self.health.readings[_MISSED] = str(self._missed)

    def _warn(self) -> None:
        """Report what is wrong now, and no longer what was."""
        problem = self._controllers.conflict(self.steady_time())
        if problem or self.health.warning == self._warned:
            self.health.warning = problem
        self._warned = problem

    def _advance(self) -> None:
        begin = time.perf_counter()
        self._running = True
        self._pushes = {m: push for m, push in self._pushes.items() if push[0] > self._awaited}
        pushes = {mass: push for mass, (_, push) in self._pushes.items()}
        self._body.advance(self._acting_force(), pushes)
        if not (all_finite(self._body.configuration) and all_finite(self._body.velocity)):
            self.fail(
                f'the body diverged at {self._awaited / NANOSECONDS:g} s: '
                'lower the gains, or raise the rate'
            )
            return
        self._step += 1
        self._answered = False
        self._publish_state()
        self.health.processed(time.perf_counter() - begin)

    def _acting_force(self) -> np.ndarray:
        """Return the force of this step: the commanded one, or what is allowed of the way to it."""
        rate = self.settings['force_rate_limit']
        before, self._acting = self._acting, self._force
        if rate:
            self._acting = approach(before, self._force, rate * self._body.integrator.step)
            if self._acting is not self._force:
                self._limited += 1
                self.health.readings[_LIMITED] = str(self._limited)
        return self._acting

    def _publish_state(self) -> None:
        if not self.matched(self._configuration):
            return
        if self._clock_publisher is not None:
            self._clock_publisher.publish(ClockMessage(clock=to_stamp(self._awaited)))
        self.health.round_trips.sent(self._awaited)
        self.publish(
            self._configuration,
            self._states.write(self._awaited, self._body.configuration, self._body.velocity),
        )
        self._published_at = self.steady_time()

    def _watch(self) -> None:
        """Publish an unanswered state again, give up after the time-out."""
        waited = self._patience.look(self.steady_time())
        self._warn()
        if not self.active or self._answered or (self._running and not self._must_answer):
            return
        which = 'response_timeout' if self._running else 'startup_timeout'
        limit = self.settings[which]
        if self._paused or limit == 0:
            limit = math.inf
        if waited > limit:
            self.fail(self._timeout_reason(which, limit))
            return
        if not self._running:
            self.say('waiting for the first control_force')
        if self.steady_time() - self._published_at >= self.settings['resend_interval']:
            self._publish_state()

    @property
    def _must_answer(self) -> bool:
        """Whether the run can't go on without the force for the present state."""
        return self._running and (not self._realtime or self._at_end)

    def _timeout_reason(self, parameter: str, limit: float) -> str:
        readers = self._configuration.get_subscription_count()
        writers = self.count_publishers('control_force')
        refused = f'; the last one was rejected: {self._refusal}' if self._refusal else ''
        return (
            f'no control_force for the state at {self._awaited / NANOSECONDS:g} s within '
            f'{parameter} = {limit:g} s (configuration has {readers} subscriptions, control_force '
            f'{writers} publishers): are encoder and controller running, and has the controller '
            f'a target?{refused}'
        )

    def _take_push(self, message: WrenchStamped, info: dict[str, int]) -> None:
        if not self.receive('external_force', info):
            return
        try:
            frame, force = read_force(message)
            read_stamp(message.header.stamp)
            self._check_strength(force, self.settings['force_limit'])
            self._body.network.mobile_index(frame.mass)
        except ValueError as error:
            self.reject('external_force', MessageError(str(error)))
            return
        end = self._awaited + round(self.settings['external_force_timeout'] * NANOSECONDS)
        self._pushes[frame.mass] = (end, force)

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._body.reset()
        self._let_go()
        self._pushes.clear()
        self._leapt += math.ceil(_RESET_LEAP * NANOSECONDS / self._step_ns)  # stamps rise for ever
        self._answer_stamp = self._awaited  # all before is passed
        self._answered = False
        self._begin_waiting()
        if self.active:
            self._publish_state()
        response.success = True
        return response

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._set_paused(request.data)
        self.report()  # now, to all who show it
        self._patience.begin(self.steady_time())  # of the force, time goes on
        if not self._paused and self._answered and not self._realtime and self.active:
            self._advance()
        response.success = True
        return response

    def _set_paused(self, paused: bool) -> None:
        self._paused = paused
        self.health.readings[PAUSED_READING] = str(paused).lower()

    def _single_step(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        if self._paused and self.active and not self._at_end and (self._realtime or self._answered):
            if self._realtime:
                self._let_go_if_stale()
            self._advance()
            response.success = not self.failure
        else:
            response.message = 'expected a paused simulator whose state has been answered'
        return response


def main(arguments: list[str] | None = None) -> None:
    """Run the node as a process."""
    sys.exit(run_node(SimulatorNode, arguments))


if __name__ == '__main__':
    main()
