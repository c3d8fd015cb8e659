"""What the nodes share: parameters, lifecycle with reasons, health, a clean start and end."""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import os
import sys
import time
import traceback
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from dpc_ros.bag.topic import NANOSECONDS
from dpc_ros.nodes.executor import (
    RARE_PERIOD,
    KeptWaitSetExecutor,
    RareCallbackGroup,
    make_executor,
)
from dpc_ros.nodes.health import (
    DIAGNOSTICS,
    Health,
    SequenceCounter,
    diagnostic_array,
)
from dpc_ros.nodes.messages import MessageError
from dpc_ros.nodes.newest import subscribe
from dpc_ros.nodes.parameters import changed_settings, declare_parameters
from dpc_ros.nodes.stop import StopRequest
from dpc_ros.nodes.topics import TOPICS, Topic
from dpc_ros.threads import single_threaded_algebra

CRASHED = os.EX_SOFTWARE  # exit code after an error that is none of the user's
_DIAGNOSTIC_PERIOD = 1.0  # s
# Together longer than the 3 s after which Fast DDS asks again for an acknowledgement it misses.
_ACKNOWLEDGE_PERIODS = 5
_LONGEST_END = 60  # s in which a node lets go of everything
_ACKNOWLEDGE_PERIOD = Duration(seconds=1)
_SPIN_PERIOD = 0.1  # s, within which a Ctrl-C is seen
_REPORT_INTERVAL = 5.0  # s between two log lines about the same
_MOST_LINES = 20  # about messages on one topic in that time
_LONGEST_LINE = 300  # characters of what a message may have put into it


class LoopNode(LifecycleNode):
    """A lifecycle node around one object of the core.

    A subclass fills in `configure` (everything slow; raises ValueError or OSError with the reason)
    and, where it has something to do, `activate`, `deactivate`, `clean_up`, `finish`. Inputs and
    outputs that it creates are destroyed with the rest at clean-up.

    A transition that fails with a reason leaves the node in the state that it was in. One that
    raises anything else is an error in the node: it lets go of everything and is unconfigured.
    While the node starts by itself (`autostart`) either is the end of it.

    Parameters that are declared as live can be set while it runs. What comes in one
    `set_parameters_atomically` is taken as a whole or refused as a whole, with the reason: each
    value is held against its declaration, then `check_change` sees them together, then `change`
    applies them.

    Its callbacks must run one after the other, in one thread, as they do in `make_executor`'s.

    Attributes:
        acts_to_the_end: whether it goes on while it is finishing (a recorder does).
        gathering_s: time [s] for which it may let messages gather, where it is alone in a process.
        niceness: by how much it gives way to others once it has started, likewise.
        kind: which of the nodes it is, and its name where it isn't remapped.
        settings: its parameters by name, those in force.
        health: its counts.
        failure: why it failed; empty while all is well.
        finished: whether it has done what it was started for.
    """

    acts_to_the_end = False
    gathering_s = 0.0
    niceness = 0

    def __init__(self, kind: str, context: Context | None = None) -> None:
        super().__init__(kind, context=context)
        self.kind = kind
        try:
            self.settings: Mapping[str, Any] = declare_parameters(self, kind)
        except ValueError:
            self.destroy_node()
            raise
        self.health = Health()
        self.failure = ''
        self.finished = False
        self.active = False
        self._configured = False
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._rare = RareCallbackGroup()
        self._outputs: list[Publisher] = []
        self._inputs: list[Subscription] = []
        self._matched = False
        self._said: dict[tuple[str, str], float] = {}  # time [s] by source and line
        self._sequences: defaultdict[str, SequenceCounter] = defaultdict(SequenceCounter)
        self._starting = False
        self._error: Exception | None = None  # that it met while it started by itself
        self._serve_transitions()
        self._diagnostics = self.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        self.create_rare_timer(_DIAGNOSTIC_PERIOD, self.report)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)

    def configure(self) -> None:
        """Load and warm up; the node is inactive afterwards.

        A ValueError or OSError is the reason why it can't: at start-up the process ends with it,
        later the node stays unconfigured.
        """

    def activate(self) -> None:
        """Begin to act."""

    def deactivate(self) -> None:
        """Stop acting; a later `activate` goes on."""

    def clean_up(self) -> None:
        """Let go of what else `configure` made; it may have stopped half-way."""

    def check_change(self, settings: Mapping[str, Any]) -> None:
        """Make sure that a configured node can take other parameters; change nothing yet.

        Args:
            settings: all parameters by name, the new values among them; each fits its declaration.

        Raises:
            ValueError: it can't, and why; everything stays as it was.
        """

    def change(self, settings: Mapping[str, Any]) -> None:
        """Apply parameters that `check_change` has let pass; `self.settings` has them by now."""

    def is_drained(self) -> bool:
        """Return whether all that was published before this was first asked has come."""
        return True

    def finish(self) -> None:
        """Do what is left to do at the end, after the last callback."""

    def start(self) -> bool:
        """Configure and activate, where `autostart` says so; return whether that worked.

        Raises:
            Exception: what a transition raised that is no reason, but an error in the node.
        """
        if not self.settings['autostart']:
            return True
        success = TransitionCallbackReturn.SUCCESS
        self._starting = True
        started = self.trigger_configure() == success and self.trigger_activate() == success
        self._starting = False
        if self._error is not None:
            raise self._error
        return started

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = self._transition(self.configure, undo=self._clean_up)
        self._configured = result == TransitionCallbackReturn.SUCCESS
        if self._configured:
            single_threaded_algebra()  # of the libraries that it has loaded
            self.get_logger().info('configured')  # the first line that is logged takes long, too
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.health.restart()
        result = self._transition(self.activate, undo=self.deactivate)
        self.active = result == TransitionCallbackReturn.SUCCESS
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.active = False
        return self._transition(self.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._transition(self._clean_up)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.active = False
        self.finished = True
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of everything after a transition that raised; give up where even that raises."""
        self.active = False
        result = self._transition(self._clean_up)
        if result != TransitionCallbackReturn.SUCCESS:
            self.failure = self.failure or 'it could not let go of what it had configured'
        return result

    def create_output(self, topic: str, entry: Topic | None = None) -> Publisher:
        """Return the publisher of a topic of the loop, or of any topic by its type and quality."""
        entry = entry or TOPICS[topic]
        publisher = self.create_publisher(entry.message_type, topic, entry.qos)
        self._outputs.append(publisher)
        return publisher

    def create_input(
        self,
        topic: str,
        callback: Callable[..., None],
        newest: int | None = None,
        raw: bool = False,
    ) -> None:
        """Subscribe to a topic of the loop.

        Args:
            topic: its name.
            callback: takes the message, and its info where it has a second argument.
            newest: how many it takes of those that wait while the node is held up, if not all; it
                then takes their info, too.
            raw: whether it takes the bytes of a message instead.
        """
        earlier = tuple(self._inputs)
        self._inputs.append(subscribe(self, topic, callback, newest, raw, earlier))

    def create_rare_timer(self, period: float, callback: Callable[[], None]) -> Timer:
        """Return a timer that may be late by `RARE_PERIOD` while messages come.

        Args:
            period: [s]; where it is shorter than that the timer is one as any other.
            callback: what it calls.
        """
        group = self._rare if period >= RARE_PERIOD else None
        return self.create_timer(period, callback, group, self._steady_clock)

    def receive(self, topic: str, info: dict[str, int]) -> bool:
        """Count a message and those lost before it; return whether the node acts on messages.

        Numbers of several publishers can't be told apart: then nothing is counted as lost, but
        that there are several is said.
        """
        self.health.arrived(info)
        gap = self._sequences[topic].gap(info['publication_sequence_number'])
        several = f'{topic} has several publishers'
        if gap and self.count_publishers(topic) > 1:
            self.health.warning = several
            self.say(f'{several}: stop all but one', problem=True)
        else:
            self.health.lost[topic] += gap
            if self.health.warning == several and self.count_publishers(topic) <= 1:
                self.health.warning = ''
        return self.active

    def matched(self, *publishers: Publisher) -> bool:
        """Return whether the nodes that publishers are to wait for were all subscribed, once.

        A node that is expected as `<name>@<topic>` must be subscribed to that topic, one that is
        expected by name to any. Their endpoints are known from the graph; a publisher is matched
        with all that it can reach when it has as many subscriptions as there are endpoints that
        fit it.
        """
        if not self._matched:
            readers = {each.topic_name: self._readers(each) for each in publishers}
            missing = [
                expected
                for expected in self.settings['expected_subscribers']
                if not self._is_among(expected, readers)
            ]
            if missing:
                self.say(f'waiting for {", ".join(sorted(missing))} on {", ".join(readers)}')
                return False
            for publisher in publishers:
                count = len(readers[publisher.topic_name])
                found = publisher.get_subscription_count()
                if found < count:
                    self.say(
                        f'waiting for {count} subscriptions of {publisher.topic_name}, '
                        f'matched with {found}: is one of another type?'
                    )
                    return False
            self._matched = True
        return True

    def _readers(self, publisher: Publisher) -> list[str]:
        """Return the nodes of the endpoints that fit a publisher."""
        return [
            endpoint.node_name
            for endpoint in self.get_subscriptions_info_by_topic(publisher.topic_name)
            if _fits(publisher.qos_profile, endpoint.qos_profile)
        ]

    def _is_among(self, expected: str, readers: Mapping[str, list[str]]) -> bool:
        name, at, topic = expected.partition('@')
        if at:
            return name in readers.get(self.resolve_topic_name(topic), ())
        return any(name in names for names in readers.values())

    def publish(self, publisher: Publisher, message: Any) -> None:
        """Publish and count."""
        publisher.publish(message)
        self.health.sent()

    def reject(self, topic: str, error: MessageError) -> None:
        """Note a message that can't be used, and go on."""
        self.health.rejected[f'{topic}: {error}'] += 1
        text = f'rejected a message on {topic}: {error}'
        self.say(text[:_LONGEST_LINE], problem=True, source=topic)

    def steady_time(self) -> float:
        """Return the time of a clock that nobody sets [s]."""
        return time.monotonic()

    def say(self, text: str, problem: bool = False, source: str = '') -> None:
        """Log a line, the same one only every few seconds.

        Args:
            text: the line.
            problem: whether it is an error.
            source: whose different lines are to be no flood, where others make them up.
        """
        now = self.steady_time()
        self._said = {
            line: time for line, time in self._said.items() if now - time < _REPORT_INTERVAL
        }
        same_source = sum(1 for known, _ in self._said if known == source)
        if (source, text) in self._said or (source and same_source >= _MOST_LINES):
            return
        self._said[source, text] = now
        if problem:
            self.get_logger().error(text)
        else:
            self.get_logger().info(text)

    def fail(self, reason: str) -> None:
        """Give up: the process ends with the reason and exit code 1."""
        self.failure = reason
        self.active = False
        if self.context.ok():
            self.report()

    def wait_until_acknowledged(self) -> None:
        """Block until every matched subscription has what was published; report meanwhile."""
        periods = 0
        for publisher in self._outputs:
            while not publisher.wait_for_all_acked(_ACKNOWLEDGE_PERIOD):
                self.report()
                periods += 1
                if periods >= _ACKNOWLEDGE_PERIODS:
                    self.get_logger().warning(f'not all of {publisher.topic_name} was acknowledged')
                    break

    def close(self) -> None:
        """Let go of everything; the node is of no use afterwards."""
        self._clean_up()
        self.destroy_node()

    def _transition(
        self, action: Callable[[], None], undo: Callable[[], None] | None = None
    ) -> TransitionCallbackReturn:
        """Do what a transition asks for.

        Args:
            action: what is to be done.
            undo: lets go of what a refused action, one that gave a reason, has done so far; without
                it there is no reason to refuse.
        """
        try:
            action()
        except Exception as error:
            if undo is not None and isinstance(error, (ValueError, OSError)):
                undo()
                self._refuse(str(error))
                return TransitionCallbackReturn.FAILURE
            if self._starting:
                self._error = error
            else:
                traceback.print_exc()  # rclpy would swallow it
                self.get_logger().error(f'unexpected {type(error).__name__}: {error}')
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _refuse(self, reason: str) -> None:
        if self._starting:
            self.failure = reason
        else:
            self.get_logger().error(reason)

    def _serve_transitions(self) -> None:
        """Refuse a transition that there is none of from here; rclpy would end the process."""
        service = self._service_change_state
        change = service.callback

        def change_or_refuse(
            request: ChangeState.Request, response: ChangeState.Response
        ) -> ChangeState.Response:
            try:
                return change(request, response)
            except RuntimeError:  # the base of what rclpy raises; rcl has said in the log why
                response.success = False
                return response

        service.callback = change_or_refuse

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            settings = changed_settings(self.kind, self.settings, parameters)
            if self._configured:
                self.check_change(settings)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_parameters(self, parameters: list[Parameter]) -> None:
        self.settings = changed_settings(self.kind, self.settings, parameters)
        if self._configured:
            self.change(self.settings)

    def _clean_up(self) -> None:
        self._configured = False
        self.clean_up()
        for publisher in self._outputs:
            self.destroy_publisher(publisher)
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._outputs.clear()
        self._inputs.clear()
        self._sequences.clear()
        self.health.readings.clear()
        self._matched = False

    def report(self) -> None:
        """Publish the node's health; who blocks for long calls this now and then."""
        _, state = self._state_machine.current_state
        status = self.health.report(
            self.get_name(), self.get_fully_qualified_name(), state, self.failure
        )
        self._diagnostics.publish(diagnostic_array(self.get_clock().now().to_msg(), status))


def _fits(offered: QoSProfile, requested: QoSProfile) -> bool:
    """Return whether DDS matches a publisher with a subscription."""
    return (
        offered.durability == DurabilityPolicy.TRANSIENT_LOCAL
        or requested.durability == DurabilityPolicy.VOLATILE
    ) and (
        offered.reliability == ReliabilityPolicy.RELIABLE
        or requested.reliability == ReliabilityPolicy.BEST_EFFORT
    )


def run_node(make_node: Callable[[Context], LoopNode], arguments: list[str] | None = None) -> int:
    """Run one node in this process until it has finished, failed, or is told to stop.

    Returns:
        the exit code: 0 after the end or a Ctrl-C, 1 after a failure, 2 for bad parameters,
        `CRASHED` after an error in the node itself.
    """
    with contextlib.ExitStack() as stack:
        try:
            stop = stack.enter_context(StopRequest(arguments))
            node = make_node(stop.context)
        except ValueError as error:
            print(f'error: {error}', file=sys.stderr)
            return 2
        code = _run(node, stop)
    faulthandler.cancel_dump_traceback_later()
    return code


def _run(node: LoopNode, stop: StopRequest) -> int:
    executor = make_executor(
        node.settings['executor'], context=stop.context, gathering_s=node.gathering_s
    )
    executor.add_node(node)
    single_threaded_algebra()
    code = 0
    try:
        if node.start():
            _give_way(node.niceness)
            with spared_by_collections():
                spin_until(executor, lambda: bool(stop or node.failure or node.finished))
            finish(executor, [node])
    except Exception as error:  # of whatever a callback calls; what was recorded is kept
        traceback.print_exc()
        node.failure, code = f'unexpected {type(error).__name__}: {error}', CRASHED
    finally:
        # Fast DDS can wait for ever for a lock of a process that was killed.
        faulthandler.dump_traceback_later(_LONGEST_END, exit=True)
        executor.shutdown()
        node.close()
    if node.failure:
        print(f'error: {node.kind}: {node.failure}', file=sys.stderr)
        return code or 1
    return 0


def _give_way(niceness: int) -> None:
    """Let all threads of this process give way to others; on Linux each has a niceness."""
    if niceness:
        for thread in os.listdir('/proc/self/task'):
            with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
                os.setpriority(os.PRIO_PROCESS, int(thread), niceness)


@contextlib.contextmanager
def spared_by_collections() -> Iterator[None]:
    """Let the garbage collector pass over all that is there by now: to look at it takes ms.

    What a node makes that is configured later it does look at.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def set_period(timer: Timer, seconds: float) -> None:
    """Let a timer run out after some time [s] from now on, if that is another than so far."""
    period_ns = round(seconds * NANOSECONDS)
    if timer.timer_period_ns != period_ns:
        timer.timer_period_ns = period_ns
        timer.reset()


def spin_until(executor: Executor, condition: Callable[[], bool]) -> None:
    """Run callbacks until a condition holds."""
    if isinstance(executor, KeptWaitSetExecutor):
        executor.spin_until(condition)
        return
    while not condition():
        executor.spin_once(timeout_sec=_SPIN_PERIOD)


def finish(executor: Executor, nodes: list[LoopNode]) -> None:
    """Let nodes end in order: the loop stands still, then each takes what is on its way to it."""
    for node in nodes:
        node.active = node.active and node.acts_to_the_end
    for node in nodes:
        node.wait_until_acknowledged()
        spin_until(executor, node.is_drained)
        node.finish()
