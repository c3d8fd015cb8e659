"""Executors of the nodes: rclpy's single-threaded one, and a faster one that keeps its wait set.

For every callback rclpy's executors collect all entities (subscriptions, timers, services …) of
their nodes anew and wrap the callback in a task that wakes the executor twice more. That costs
several times the hop of a message itself. `KeptWaitSetExecutor` collects them once and again only
when they change. A node has some twenty services and events, which rcl has to be told of again for
each wait: while messages come it waits without them, and without what is in a `RareCallbackGroup`,
and looks at all now and then.

It relies on these names of rclpy that are not public, all alike in Jazzy and Kilted:

- `rclpy.impl.implementation_singleton` for `WaitSet`, which has no public name;
- `Executor._take_timer` and its siblings, which take what has arrived and give the call of the
  user's callback: the code that knows what each distribution hands to a callback;
- `Subscription._callback_type`, whether the callback wants the message info: the one kind of
  entity that is taken here, as every message of the loop passes there;
- of the base class `_guard`, triggered when entities, nodes or tasks come or go, `_sigint_gc`,
  triggered by rclpy's signal handler, and the `_tasks`, `_tasks_lock`, `_nodes` and `_is_shutdown`
  behind its public methods;
- `GuardCondition._executor_triggered`, where executors keep a trigger that could not run yet;
- `Executor._spin_once_until_future_complete`, which Kilted's `spin_until_future_complete` calls.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from inspect import iscoroutinefunction
from typing import Any, NamedTuple

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import (
    Executor,
    ExternalShutdownException,
    SingleThreadedExecutor,
    TimeoutObject,
)
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.task import Future, Task
from rclpy.timer import Timer
from rclpy.waitable import NumberOfEntities

# A wait in C++ ends neither at a signal that only Python handles nor at a future that another
# thread sets: the executor looks for both this often.
LONGEST_WAIT_S = 0.1

# While messages come, services and what else is rare is looked at as often as this.
RARE_PERIOD = 0.02  # s

_LARGEST_BATCH = 1000  # messages of one subscription in a row, so that none starves the others

# Kinds of entities in the order in which those that are ready together run, as in rclpy.
_HANDLE_KINDS = ('timer', 'subscription', 'guard_condition', 'client', 'service')
_URGENT_KINDS = ('timer', 'subscription', 'guard_condition')

_Call = Callable[[], Coroutine[Any, Any, None]]


class _Entity(NamedTuple):
    """What an executor waits on: a timer, subscription …, or a waitable made of several."""

    kind: str
    member: Any
    node: Node
    is_plain: bool  # a subscription whose callback is no coroutine: this is where messages pass


def take_and_call(subscription: Subscription) -> bool:
    """Call a subscription's callback with the next message; return False where none waits."""
    try:
        with subscription.handle:
            message_and_info = subscription.handle.take_message(
                subscription.msg_type, subscription.raw
            )
    except InvalidHandle:
        return False
    if message_and_info is None:
        return False
    if subscription._callback_type is Subscription.CallbackType.MessageOnly:
        subscription.callback(message_and_info[0])
    else:
        subscription.callback(*message_and_info)
    return True


class RareCallbackGroup(MutuallyExclusiveCallbackGroup):
    """A group whose callbacks are in no hurry: while messages come they run only now and then.

    A subscription takes one message each time: on a busy topic it has a depth of one, or its
    callback takes the others, too (`newest.subscribe`).
    """


def _is_urgent(entity: _Entity) -> bool:
    is_rare = isinstance(entity.member.callback_group, RareCallbackGroup)
    return entity.kind in _URGENT_KINDS and not is_rare


class _KeptWaitSet:
    """The wait set of given entities, and the way back from what rcl reports to them.

    From a wait until `release` it holds the handles of the entities, so that one that is destroyed
    meanwhile stays valid for rcl.

    Args:
        entities: what the nodes of an executor wait on.
        guards: guard conditions of the executor itself.
        context: context of the nodes.
    """

    def __init__(
        self, entities: list[_Entity], guards: list[GuardCondition], context: Context
    ) -> None:
        self.entities = entities
        self._context_handle = context.handle
        self._guard_handles = [guard.handle for guard in guards]
        self._by_pointer: dict[str, dict[int, _Entity]] = {kind: {} for kind in _HANDLE_KINDS}
        for entity in entities:
            if entity.kind != 'waitable':
                self._by_pointer[entity.kind][entity.member.handle.pointer] = entity
        size = NumberOfEntities(
            len(self._by_pointer['subscription']),
            len(self._by_pointer['guard_condition']) + len(guards),
            len(self._by_pointer['timer']),
            len(self._by_pointer['client']),
            len(self._by_pointer['service']),
        )
        for entity in entities:
            if entity.kind == 'waitable':
                size += entity.member.get_num_entities()
        with context.handle:
            self._wait_set = rclpy_implementation.WaitSet(
                size.num_subscriptions,
                size.num_guard_conditions,
                size.num_timers,
                size.num_clients,
                size.num_services,
                size.num_events,
                context.handle,
            )
        self._held: list[Any] = []
        self._additions: list[tuple[Any, Callable[[Any], Any], Any]] = []
        self._waitables: list[_Entity] = []
        self._waited_waitables: list[_Entity] = []

    def wait(self, timeout_ns: int, may_run: Callable[[Any], bool] | None) -> set[int]:
        """Wait until an entity or a guard condition is ready, or until the timeout.

        Args:
            timeout_ns: longest wait [ns].
            may_run: which entities to wait on; all of them if None.

        Returns:
            Pointers of the guard conditions that are ready.
        """
        if not self._held:
            self._hold()
        wait_set = self._wait_set
        # A wait leaves only what was ready in the set.
        wait_set.clear_entities()
        for handle in self._guard_handles:
            wait_set.add_guard_condition(handle)
        for member, add_to_wait_set, argument in self._additions:
            if may_run is None or may_run(member):
                add_to_wait_set(argument)
        self._waited_waitables = []
        for entity in self._waitables:
            if may_run is None or may_run(entity.member):
                try:
                    entity.member.add_to_wait_set(wait_set)
                except InvalidHandle:
                    continue
                self._waited_waitables.append(entity)
        wait_set.wait(timeout_ns)
        guards_ready = set(wait_set.get_ready_entities('guard_condition'))
        # A wait resets guard conditions: the trigger has to outlive it until the callback runs.
        for pointer, entity in self._by_pointer['guard_condition'].items():
            if pointer in guards_ready:
                entity.member._executor_triggered = True
        return guards_ready

    def ready_entities(self) -> list[_Entity]:
        """Return the entities that the last wait found ready, in the order in which they run."""
        wait_set = self._wait_set
        ready = [entity for entity in self._waited_waitables if entity.member.is_ready(wait_set)]
        for kind, by_pointer in self._by_pointer.items():
            if by_pointer:
                for pointer in wait_set.get_ready_entities(kind):
                    # Waitables and the executor itself add members to the set that aren't here.
                    if pointer in by_pointer:
                        ready.append(by_pointer[pointer])
        return ready

    def retrigger_guard_conditions(self) -> None:
        """Trigger again the guard conditions whose callbacks had to wait."""
        for entity in self._by_pointer['guard_condition'].values():
            if entity.member._executor_triggered:
                with suppress(InvalidHandle):
                    entity.member.trigger()

    def release(self) -> None:
        """Let go of the handles; those that were destroyed meanwhile are freed by this."""
        while self._held:
            self._held.pop().__exit__(None, None, None)

    def _hold(self) -> None:
        for handle in (self._context_handle, *self._guard_handles):
            handle.__enter__()
            self._held.append(handle)
        self._additions, self._waitables = [], []
        adders = {kind: getattr(self._wait_set, f'add_{kind}') for kind in _HANDLE_KINDS}
        for entity in self.entities:
            is_waitable = entity.kind == 'waitable'
            handle = entity.member if is_waitable else entity.member.handle
            try:
                handle.__enter__()
            except InvalidHandle:
                continue
            self._held.append(handle)
            if is_waitable:
                self._waitables.append(entity)
            else:
                self._additions.append((entity.member, adders[entity.kind], handle))


class KeptWaitSetExecutor(Executor):
    """Runs callbacks in the thread that spins, as `SingleThreadedExecutor`, with less overhead.

    Callbacks, services, actions, events, tasks and coroutines behave as with rclpy's executor, and
    exceptions leave `spin` in the same way. Between two waits each ready entity runs once, so no
    busy topic starves another. Signals are handled within `LONGEST_WAIT_S` even where rclpy's
    signal handlers are not installed.

    Args:
        context: of the nodes.
        gathering_s: time [s] for which messages gather before each wait; a subscription is then
            emptied at once. It makes many messages cheap where none is urgent.
    """

    def __init__(self, *, context: Context | None = None, gathering_s: float = 0.0) -> None:
        super().__init__(context=context)
        self._gathering_s = gathering_s
        self._kept: _KeptWaitSet | None = None
        self._urgent: _KeptWaitSet | None = None  # the same without what is rare
        self._urgent_until = -math.inf  # by the clock of `time.monotonic`
        self._holds_between_waits = False
        self._ready: deque[_Entity] = deque()
        self._resumable: deque[tuple[Task, Any, Node | None]] = deque()
        self._resumed_since_wait = False
        self._running = 0
        self._takes: dict[str, Callable[[Any], _Call | None]] = {
            'timer': self._take_ready_timer,
            'subscription': self._take_subscription,
            'guard_condition': self._take_guard_condition,
            'client': self._take_client,
            'service': self._take_service,
            'waitable': self._take_waitable,
        }

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Run one callback, the next that is ready within the timeout.

        Args:
            timeout_sec: longest wait [s]; for ever if None or negative, none at all if 0.

        Raises:
            ExternalShutdownException: the context was shut down.
        """
        self._spin_once(timeout_sec, lambda: False)

    def spin_once_until_future_complete(
        self, future: Future, timeout_sec: float | TimeoutObject | None = None
    ) -> None:
        """Run one callback as `spin_once` does, unless the future completes before."""

        def is_complete() -> bool:
            return future.done() or future.cancelled()

        def wake(_: Future) -> None:
            self.wake()

        if is_complete():
            return
        future.add_done_callback(wake)
        try:
            self._spin_once(timeout_sec, is_complete)
        finally:
            future.remove_done_callback(wake)

    _spin_once_until_future_complete = spin_once_until_future_complete

    def spin(self) -> None:
        """Run callbacks until the executor or the context is shut down."""
        with self._holding():
            super().spin()

    def spin_until(self, condition: Callable[[], bool]) -> None:
        """Run callbacks until a condition holds, or the executor is shut down.

        The condition is looked at after each callback.

        Args:
            condition: where nothing happens, it is looked at within `LONGEST_WAIT_S`.

        Raises:
            ExternalShutdownException: the context was shut down.
        """
        with self._holding():
            while not (self._is_shutdown or condition()):
                if not self._run_next():
                    self._prepare_next(LONGEST_WAIT_S)
                    self._run_next()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop spinning; see `rclpy.executors.Executor.shutdown`."""
        finished = super().shutdown(timeout_sec)
        # While a thread spins the handles are in rcl's hands: that thread lets go of them.
        if not self._holds_between_waits:
            self._kept = self._urgent = None
        return finished

    @contextmanager
    def _holding(self) -> Iterator[None]:
        """Hold the handles from one wait to the next: to take them each time costs more than it."""
        self._holds_between_waits = True
        try:
            yield
        finally:
            self._holds_between_waits = False
            self._forget_wait_set()

    def _spin_once(
        self, timeout_sec: float | TimeoutObject | None, is_over: Callable[[], bool]
    ) -> None:
        timeout = timeout_sec.timeout if isinstance(timeout_sec, TimeoutObject) else timeout_sec
        deadline = math.inf if timeout is None or timeout < 0 else time.monotonic() + timeout
        while not self._is_shutdown and not is_over():
            if self._run_next():
                return
            remaining = max(0.0, deadline - time.monotonic())
            unchanged = self._prepare_next(min(remaining, LONGEST_WAIT_S))
            if unchanged and not self._ready and time.monotonic() >= deadline:
                return

    def _prepare_next(self, timeout_sec: float) -> bool:
        """Line up what can run next; wait for it only if no task can go on.

        Returns:
            False if nothing was waited for, or the entities have changed meanwhile.
        """
        if self._tasks and not self._resumed_since_wait:
            self._resumed_since_wait = True
            self._collect_tasks()
            return False
        self._resumed_since_wait = False
        return self._wait(timeout_sec)

    def _run_next(self) -> bool:
        """Run what is next among the ready; return False if nothing was."""
        while self._resumable:
            task, _, node = self._resumable.popleft()
            if not task.done() and (node is None or node in self._nodes):
                self._resume(task)
                return True
        while self._ready:
            entity = self._ready.popleft()
            if entity.member.callback_group.beginning_execution(entity.member):
                self._run(entity)
                return True
        return False

    def _run(self, entity: _Entity) -> None:
        """Run the callback of an entity whose callback group has been entered."""
        self._running += 1
        try:
            if entity.is_plain:
                self._take_and_call_subscription(entity.member)
                return
            call = self._take_and_call(entity)
            try:
                call.send(None)
            except StopIteration:
                return
        finally:
            self._running -= 1
        # The callback awaits something: it goes on as a task.
        with self._tasks_lock:
            self._tasks.append((Task(call, executor=self), entity.member, entity.node))

    def _take_and_call_subscription(self, subscription: Subscription) -> None:
        """Do as `_take_and_call`, without its coroutines: this is where the messages pass."""
        try:
            for _ in range(_LARGEST_BATCH if self._gathering_s else 1):
                if not take_and_call(subscription):
                    return
        finally:
            subscription.callback_group.ending_execution(subscription)

    async def _take_and_call(self, entity: _Entity) -> None:
        try:
            try:
                call = self._takes[entity.kind](entity.member)
            except InvalidHandle:
                # A callback has destroyed the entity since the wait.
                return
            if call is not None:
                await call()
        finally:
            entity.member.callback_group.ending_execution(entity.member)

    def _take_ready_timer(self, timer: Timer) -> _Call | None:
        """Take a timer, unless a callback has cancelled or reset it since the wait."""
        return self._take_timer(timer) if timer.is_ready() else None

    def _resume(self, task: Task) -> None:
        self._running += 1
        try:
            task()
        finally:
            self._running -= 1
        # Raises what the task raised.
        task.result()

    def _collect_tasks(self) -> None:
        """Forget tasks that are over and line up the others, oldest first."""
        with self._tasks_lock:
            self._tasks = [
                entry for entry in self._tasks if not (entry[0].done() or entry[0].cancelled())
            ]
            self._resumable.extend(entry for entry in self._tasks if not entry[0].executing())

    def _wait(self, timeout_sec: float) -> bool:
        """Wait for ready entities and line them up; return False if the entities have changed."""
        if self._gathering_s:
            time.sleep(self._gathering_s)
        guard, interrupt = self._guard, self._sigint_gc
        if guard is None or interrupt is None:
            return True
        if self._kept is None or self._urgent is None:
            self._check_context()
            entities = self._entities()
            urgent = [entity for entity in entities if _is_urgent(entity)]
            self._kept = _KeptWaitSet(entities, [guard, interrupt], self._context)
            self._urgent = _KeptWaitSet(urgent, [guard, interrupt], self._context)
        every = self._kept
        kept, timeout_sec = self._next_wait(every, self._urgent, timeout_sec)
        if kept is every:  # to ask each time costs more than to look for a message
            self._check_context()
        # Only a suspended coroutine, or a callback that spins itself, keeps a group busy.
        restricted = bool(self._tasks) or self._running > 0
        try:
            kept.retrigger_guard_conditions()
            guards_ready = kept.wait(
                int(timeout_sec * 1e9), self.can_execute if restricted else None
            )
            if self._is_shutdown:
                return True
            if guards_ready:  # a shutdown triggers the guard
                self._check_context()
            if guard.handle.pointer in guards_ready and self._entities() != every.entities:
                self._forget_wait_set()
                return False
            ready = kept.ready_entities()
        finally:
            if not self._holds_between_waits:
                kept.release()
        self._ready.extend(ready)
        if kept is every and any(entity.kind == 'subscription' for entity in ready):
            self._urgent_until = time.monotonic() + RARE_PERIOD
        return True

    def _check_context(self) -> None:
        if not self._context.ok():
            raise ExternalShutdownException

    def _next_wait(
        self, every: _KeptWaitSet, urgent: _KeptWaitSet, timeout_sec: float
    ) -> tuple[_KeptWaitSet, float]:
        """Return on what to wait next, and for how long at most [s]."""
        remaining = self._urgent_until - time.monotonic()
        if self._holds_between_waits and remaining > 0:
            return urgent, min(timeout_sec, remaining)
        return every, timeout_sec

    def _forget_wait_set(self) -> None:
        for kept in (self._kept, self._urgent):
            if kept is not None:
                kept.release()
        self._kept = self._urgent = None

    def _entities(self) -> list[_Entity]:
        """List what the executor's nodes wait on now."""
        entities: list[_Entity] = []
        for node in self.get_nodes():
            for kind, members in (
                ('timer', node.timers),
                ('subscription', node.subscriptions),
                ('guard_condition', node.guards),
                ('client', node.clients),
                ('service', node.services),
                ('waitable', node.waitables),
            ):
                entities.extend(
                    _Entity(
                        kind,
                        member,
                        node,
                        kind == 'subscription' and not iscoroutinefunction(member.callback),
                    )
                    for member in members
                )
        return entities


_EXECUTORS: dict[str, type[Executor]] = {
    'kept_wait_set': KeptWaitSetExecutor,
    'single_threaded': SingleThreadedExecutor,
}


def make_executor(
    name: str, *, context: Context | None = None, gathering_s: float = 0.0
) -> Executor:
    """Return a new executor: `kept_wait_set`, or rclpy's `single_threaded`.

    Args:
        name: of the kind.
        context: of the nodes.
        gathering_s: see `KeptWaitSetExecutor`; rclpy's has no such thing.

    Raises:
        ValueError: another name.
    """
    if name not in _EXECUTORS:
        raise ValueError(f'unknown executor {name!r}: choose one of {", ".join(_EXECUTORS)}')
    if name == 'kept_wait_set':
        return KeptWaitSetExecutor(context=context, gathering_s=gathering_s)
    return _EXECUTORS[name](context=context)
