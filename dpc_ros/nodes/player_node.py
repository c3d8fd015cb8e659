"""Player node: replays a log, byte by byte, by the clock or in lockstep with the controller."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from typing import TypeVar

from geometry_msgs.msg import WrenchStamped
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.service import Service
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import SetBool, Trigger

from dpc_ros.bag import QosProfile, RawMessage, read_topics
from dpc_ros.bag import Topic as LoggedTopic
from dpc_ros.bag.playback import Excerpt, Step, lockstep_steps, stamp_of_header
from dpc_ros.bag.topic import INFINITE_NS, NANOSECONDS
from dpc_ros.control import Patience
from dpc_ros.nodes.loop_node import LoopNode, run_node
from dpc_ros.nodes.message_definition import check_definition, find_message_class
from dpc_ros.nodes.messages import MessageError, read_stamp, to_stamp
from dpc_ros.nodes.topics import LOOP_QOS, Topic

# Of the nodes that are replayed to.
_ANSWERS = ('latent_state', 'control_force', 'target_in_force', 'parameters_in_force')
_CLOCK = '/clock'
_MATCHING_PERIOD = 0.05  # s between two looks whether the expected nodes are there
_BURST = 64  # messages that are due after which services are served
_LEAST_PERIOD_NS = 1000  # ns, of a timer that is to run at once

_Part = TypeVar('_Part', RawMessage, Step)


class PlayerNode(LoopNode):
    """Publishes the recorded bytes of a log on its topics again.

    By the clock each message comes at its recorded time after the first, times the rate. In
    lockstep a configuration comes when the force with the stamp of the one before has come.
    """

    def __init__(self, context: Context | None = None) -> None:
        super().__init__('player', context)
        self._commands: list[Service] = []
        self._timer: Timer | None = None
        self._players: dict[str, Publisher] = {}
        self._messages: Iterator[RawMessage] | None = None
        self._steps: Iterator[Step] | None = None

    def configure(self) -> None:
        settings = self.settings
        if not settings['bag']:
            raise ValueError('bag: expected the folder of a log or an MCAP file, got none')
        self._lockstep = settings['time_mode'] == 'lockstep'
        self._configuration = self._in_namespace('configuration')
        topics = self._choose(read_topics(settings['bag']))
        for name, topic in topics.items():
            message_type = find_message_class(topic.type_name)
            check_definition(message_type, topic.definition)
            entry = Topic(message_type, offered_quality(topic.offered_qos_profiles))
            self._players[name] = self.create_output(name, entry)
        self._excerpt = Excerpt(
            settings['bag'],
            frozenset(topics),
            frozenset(name for name, each in self._players.items() if _is_latched(each)),
            settings['start_time'],
            settings['duration'],
        )
        self._excerpt.span_ns()  # a start behind the end is refused now
        self.health.readings['bag'] = settings['bag']
        if settings['publish_clock'] and settings['clock_source'] == 'stamp':
            self._require(self._configuration, topics, 'clock_source is stamp')
        self._clock_publisher = (
            self.create_output(_CLOCK, Topic(ClockMessage, QoSProfile(depth=1)))
            if settings['publish_clock']
            else None
        )
        if self._lockstep:
            self._require(self._configuration, topics, 'time_mode is lockstep')
            self.create_input('control_force', self._take_force)
        self._commands = [
            self.create_service(SetBool, '~/pause', self._pause),
            self.create_service(Trigger, '~/step', self._single_step),
        ]
        self._paused = settings['start_paused']
        self._begun = self._running = False
        self._answered = True
        self._step: Step | None = None
        self._following: RawMessage | None = None

    def activate(self) -> None:
        self._published_at = self.steady_time()
        self._patience = Patience(_MATCHING_PERIOD)
        self._patience.begin(self._published_at)
        if self._begun and not self._lockstep:
            self._anchor()  # it goes on where it was, and catches up with nothing
        tick = self._watch if self._lockstep else self._tick
        self._timer = self.create_timer(_MATCHING_PERIOD, tick, clock=self._steady_clock)

    def deactivate(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
        self._timer = None

    def clean_up(self) -> None:
        self.deactivate()
        for service in self._commands:
            self.destroy_service(service)
        self._commands = []
        self._players = {}
        self._messages = self._steps = None  # they keep the files of the log open

    def _choose(self, recorded: dict[str, LoggedTopic]) -> dict[str, LoggedTopic]:
        answers = {self._in_namespace(name) for name in _ANSWERS if self._lockstep}
        made = {_CLOCK} if self.settings['publish_clock'] else set()  # here, or by the controller
        made |= {self._in_namespace('control_force')} & answers
        chosen = [self._in_namespace(name) for name in self.settings['topics']]
        if not chosen:
            chosen = [name for name in recorded if name not in answers | made]
        for name in chosen:
            self._require(name, recorded, 'it is to be replayed')
            if name in made:
                raise ValueError(
                    f'topics: {name} can not be replayed where publish_clock or lockstep asks for '
                    'a new one: leave it out'
                )
        return {name: recorded[name] for name in chosen}

    def _require(self, name: str, topics: dict[str, LoggedTopic], reason: str) -> None:
        if name not in topics:
            raise ValueError(
                f'{self.settings["bag"]}: expected the topic {name}, as {reason}, got '
                f'{", ".join(sorted(topics)) or "none"}: name topics in full, or start the player '
                'in the namespace of the log'
            )

    def _in_namespace(self, topic: str) -> str:
        """Return the name in the log, whatever it is remapped to now."""
        return topic if topic.startswith('/') else f'{self.get_namespace().rstrip("/")}/{topic}'

    def _begin(self) -> None:
        """Go to the start of the log."""
        self._begun = True
        if self._lockstep:
            force = self._in_namespace('control_force')
            self._steps = lockstep_steps(self._excerpt, self._configuration, force)
        else:
            self._messages = self._excerpt.messages()
            self._start_ns, _ = self._excerpt.span_ns()
            self._take_following()
            self._anchor()

    def _tick(self) -> None:
        """Publish what is due, and be back when the next message is."""
        if not self.active or self._timer is None or not self.matched(*self._players.values()):
            return
        if not self._begun:
            self._begin()
        if self._paused or self.finished:
            self._tick_again(_MATCHING_PERIOD)
            return
        for _ in range(_BURST):
            if self._following is None or self._wait_time(self._following) > 0:
                break
            self._play_following()
        wait = 0.0 if self._following is None else self._wait_time(self._following)
        self._tick_again(wait)

    def _tick_again(self, wait: float) -> None:
        assert self._timer is not None
        self._timer.timer_period_ns = max(round(wait * NANOSECONDS), _LEAST_PERIOD_NS)
        self._timer.reset()

    def _wait_time(self, message: RawMessage) -> float:
        """Return the wall time until a message is due [s]."""
        rate = self.settings['rate']
        if not rate:
            return 0.0
        recorded = (message.log_time_ns - self._anchor_ns) / NANOSECONDS
        return self._anchor_at + recorded / rate - self.steady_time()

    def _anchor(self) -> None:
        """Let the next message be due now; the log's start be due now before the first."""
        self._anchor_at = self.steady_time()
        if self._following is not None:
            self._anchor_ns = max(self._following.log_time_ns, self._start_ns)

    def _take_following(self) -> None:
        self._following = self._read_next(self._messages)
        if self._following is None:
            self._come_to_the_end()

    def _read_next(self, parts: Iterator[_Part] | None) -> _Part | None:
        assert parts is not None  # it has begun
        try:
            return next(parts, None)
        except ValueError as error:
            self.fail(str(error))
            return None

    def _play_following(self) -> None:
        assert self._following is not None
        self._play(self._following)
        self._take_following()

    def _come_to_the_end(self) -> None:
        if self.settings['loop'] and self.health.published and not self.failure:
            self._begin()
            if self._lockstep:
                self._advance()
        else:
            self.finished = True

    def _play(self, message: RawMessage) -> None:
        if self._clock_publisher is not None:
            is_state = message.topic == self._configuration
            if self.settings['clock_source'] == 'log_time':
                self._clock_publisher.publish(ClockMessage(clock=to_stamp(message.log_time_ns)))
            elif is_state:
                self._clock_publisher.publish(
                    ClockMessage(clock=to_stamp(stamp_of_header(message)))
                )
        begin = time.perf_counter()
        self.publish(self._players[message.topic], message.cdr)
        self.health.processed(time.perf_counter() - begin)

    def _advance(self) -> None:
        """Publish the next configuration, and before it what counts for its force."""
        step = self._read_next(self._steps)
        if step is None:
            self._step = None
            self._come_to_the_end()
            return
        for message in step.before:
            self._play(message)
        if step.before:
            self.wait_until_acknowledged()
        self._step, self._answered = step, False
        self._patience.begin(self.steady_time())
        self._play_state(step)

    def _play_state(self, step: Step) -> None:
        self.health.round_trips.sent(step.stamp)
        self._play(step.configuration)
        self._published_at = self.steady_time()

    def _take_force(self, message: WrenchStamped, info: dict[str, int]) -> None:
        if not self.receive('control_force', info):
            return
        try:
            stamp = read_stamp(message.header.stamp)
        except MessageError as error:
            self.reject('control_force', error)
            return
        self.health.round_trips.answered(stamp)
        if self._step is None or self._answered or stamp != self._step.stamp:
            self.health.repeated += 1  # the answer to a state that was published twice
            return
        self._answered = self._running = True
        if not self._paused:
            self._advance()

    def _watch(self) -> None:
        """Begin; publish a configuration that is not answered again, give up after the time-out."""
        if not self.active or not self.matched(*self._players.values()):
            return
        if not self._begun:
            self._begin()
            if not self._paused:
                self._advance()
            return
        if self._step is None or self._answered:
            return
        which = 'response_timeout' if self._running else 'startup_timeout'
        limit = self.settings[which] or math.inf
        if self._patience.look(self.steady_time()) > limit:
            self.fail(
                f'no control_force for the configuration at {self._step.stamp / NANOSECONDS:g} s '
                f'within {which} = {limit:g} s: are encoder and controller running, and has the '
                'controller a target?'
            )
        elif self.steady_time() - self._published_at >= self.settings['resend_interval']:
            self._play_state(self._step)

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        was_paused, self._paused = self._paused, request.data
        if was_paused and not self._paused and self._begun and self.active:
            if not self._lockstep:
                self._anchor()
            elif self._answered and not self.finished:
                self._advance()
        response.success = True
        return response

    def _single_step(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        if not (self._paused and self._begun and self.active and self._answered):
            response.message = (
                'expected a paused player whose expected subscribers are there and whose last '
                'configuration has been answered'
            )
        elif self.finished:
            response.message = 'the log is at its end'
        else:
            response.success = True
            if self._lockstep:
                self._advance()
            else:
                self._play_following()
        return response


def offered_quality(profiles: tuple[QosProfile, ...]) -> QoSProfile:
    """Return a quality that suits whoever a log's publishers of a topic suited.

    The graph does not tell history and depth, so that many logs don't: a transient local topic is
    taken to keep its newest message, any other as many as one of the loop.
    """
    reliable = not profiles or any(each.reliability != 'best_effort' for each in profiles)
    latched = any(each.durability == 'transient_local' for each in profiles)
    known = max((each.depth for each in profiles if each.history == 'keep_last'), default=0)
    quality = QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=known or (1 if latched else LOOP_QOS.depth),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
    if profiles and all(each.liveliness == 'manual_by_topic' for each in profiles):
        quality.liveliness = LivelinessPolicy.MANUAL_BY_TOPIC
    for duration in ('deadline', 'lifespan', 'liveliness_lease_duration'):
        longest = max((getattr(each, f'{duration}_ns') for each in profiles), default=INFINITE_NS)
        if 0 < longest < INFINITE_NS:
            setattr(quality, duration, Duration(nanoseconds=longest))
    return quality


def _is_latched(publisher: Publisher) -> bool:
    return publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL


def main(arguments: list[str] | None = None) -> None:
    """Run the node as a process."""
    sys.exit(run_node(PlayerNode, arguments))


if __name__ == '__main__':
    main()
