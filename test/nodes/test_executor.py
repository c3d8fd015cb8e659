"""Both executors behave alike, over real DDS."""

import gc
import itertools
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from domain_coordinator import domain_id
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Int64
from std_srvs.srv import SetBool, Trigger

from dpc_ros.nodes.discovery import prompt_dds
from dpc_ros.nodes.executor import KeptWaitSetExecutor, RareCallbackGroup, make_executor

EXECUTORS = ('kept_wait_set', 'single_threaded')
GIVE_UP_S = 30.0
DEPTH = 100


class Ros:
    """One executor in a context and a domain of its own."""

    def __init__(self, executor_name, domain, gathering_s=0.0):
        self.context = Context()
        with prompt_dds():
            self.context.init(args=[], domain_id=domain)
        self.executor = make_executor(executor_name, context=self.context, gathering_s=gathering_s)
        self.nodes = []

    def node(self, name, node_class=Node):
        node = node_class(name, context=self.context)
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def spin_until(self, condition):
        deadline = time.monotonic() + GIVE_UP_S
        while not condition():
            assert time.monotonic() < deadline, 'gave up waiting'
            self.executor.spin_once(timeout_sec=0.1)

    def spin_until_matched(self, *publishers):
        for publisher in publishers:
            self.spin_until(lambda publisher=publisher: publisher.get_subscription_count() > 0)

    def call(self, client, request):
        self.spin_until(client.service_is_ready)
        future = client.call_async(request)
        self.executor.spin_until_future_complete(future, timeout_sec=GIVE_UP_S)
        assert future.done()
        return future.result()

    def let_pass(self, node, ticks=5):
        """Spin until a new timer has fired some times: what was due before has had its chance."""
        passed = []
        timer = node.create_timer(0.01, lambda: passed.append(None))
        self.spin_until(lambda: len(passed) >= ticks)
        node.destroy_timer(timer)

    def close(self):
        self.executor.shutdown()
        for node in self.nodes:
            node.destroy_node()
        self.context.try_shutdown()
        if any(isinstance(node, LifecycleNode) for node in self.nodes):
            self.nodes.clear()
            gc.collect()  # it and its services refer to each other, and keep sockets


@pytest.fixture(
    params=[*((name, 0.0) for name in EXECUTORS), ('kept_wait_set', 0.002)],
    ids=[*EXECUTORS, 'gathering'],
)
def ros(request):
    with domain_id() as domain:
        name, gathering_s = request.param
        ros = Ros(name, domain, gathering_s)
        yield ros
        ros.close()


def int_callback(shape, values):
    return {
        'message': lambda message: values.append(message.data),
        'message_info': lambda message, info: values.append(
            message.data if info['source_timestamp'] > 0 else None
        ),
        'raw': lambda raw: values.append(deserialize_message(raw, Int64).data),
        'raw_info': lambda raw, info: values.append(
            deserialize_message(raw, Int64).data if info['source_timestamp'] > 0 else None
        ),
    }[shape]


@pytest.mark.parametrize('shape', ['message', 'message_info', 'raw', 'raw_info'])
def test_every_message_arrives_in_order(ros, shape):
    sender, receiver = ros.node('sender'), ros.node('receiver')
    publisher = sender.create_publisher(Int64, 'numbers', DEPTH)
    values = []
    receiver.create_subscription(
        Int64, 'numbers', int_callback(shape, values), DEPTH, raw=shape.startswith('raw')
    )
    ros.spin_until_matched(publisher)
    for number in range(DEPTH):
        publisher.publish(Int64(data=number))
    ros.spin_until(lambda: len(values) >= DEPTH)
    assert values == list(range(DEPTH))


def test_message_fields_arrive(ros):
    node = ros.node('both')
    publisher = node.create_publisher(JointState, 'state', 1)
    received = []
    node.create_subscription(JointState, 'state', received.append, 1)
    ros.spin_until_matched(publisher)
    message = JointState(name=['a', 'b'], position=[1.0, 2.0], velocity=[-1.0, 0.5])
    publisher.publish(message)
    ros.spin_until(lambda: received)
    assert received == [message]


def test_timer_fires_until_cancelled(ros):
    node = ros.node('clockwork')
    fired = []

    def tick():
        fired.append(None)
        if len(fired) == 3:
            timer.cancel()

    timer = node.create_timer(0.001, tick)
    ros.spin_until(lambda: len(fired) == 3)
    ros.let_pass(node)
    assert len(fired) == 3
    timer.reset()
    ros.spin_until(lambda: len(fired) > 3)


def test_timer_cancelled_by_another_callback_of_the_same_wait_does_not_run(ros):
    node = ros.node('clockwork')
    fired = []

    def tick(name):
        fired.append(name)
        for timer in timers:
            timer.cancel()

    timers = [node.create_timer(0.001, lambda name=name: tick(name)) for name in ('a', 'b')]
    deadline = time.monotonic() + GIVE_UP_S
    while not all(timer.is_ready() for timer in timers):
        assert time.monotonic() < deadline
    ros.let_pass(node)
    assert len(fired) == 1


def test_spin_once_runs_one_callback(ros):
    node = ros.node('clockwork')
    fired = []
    timers = [node.create_timer(0.001, lambda: fired.append(None)) for _ in range(3)]
    deadline = time.monotonic() + GIVE_UP_S
    while not all(timer.is_ready() for timer in timers):
        assert time.monotonic() < deadline
    for count in range(1, 4):
        ros.executor.spin_once(timeout_sec=GIVE_UP_S)
        assert len(fired) == count


def test_spin_once_without_timeout_returns_when_nothing_is_ready(ros):
    ros.node('idle')
    for _ in range(3):
        ros.executor.spin_once(timeout_sec=0)


def test_spin_once_without_timeout_sees_a_new_timer(ros):
    node = ros.node('clockwork')
    ros.executor.spin_once(timeout_sec=0)
    fired = []
    timer = node.create_timer(0.001, lambda: fired.append(None))
    deadline = time.monotonic() + GIVE_UP_S
    while not timer.is_ready():
        assert time.monotonic() < deadline
    ros.executor.spin_once(timeout_sec=0)
    assert fired == [None]


def test_service_answers_client_of_another_node(ros):
    server, caller = ros.node('server'), ros.node('caller')

    def answer(request, response):
        response.success, response.message = request.data, 'answered'
        return response

    server.create_service(SetBool, 'switch', answer)
    client = caller.create_client(SetBool, 'switch')
    for on in (True, False):
        response = ros.call(client, SetBool.Request(data=on))
        assert (response.success, response.message) == (on, 'answered')


def test_parameter_services(ros):
    server, caller = ros.node('server'), ros.node('caller')
    server.declare_parameter('rate', 1.0)
    set_parameters = caller.create_client(
        SetParametersAtomically, 'server/set_parameters_atomically'
    )
    get_parameters = caller.create_client(GetParameters, 'server/get_parameters')
    rate = Parameter('rate', value=200.0).to_parameter_msg()
    response = ros.call(set_parameters, SetParametersAtomically.Request(parameters=[rate]))
    assert response.result.successful
    response = ros.call(get_parameters, GetParameters.Request(names=['rate']))
    assert [value.double_value for value in response.values] == [200.0]
    assert server.get_parameter('rate').value == 200.0


class Configured(LifecycleNode):
    """Subscribes while it is configured."""

    def __init__(self, name, **arguments):
        super().__init__(name, **arguments)
        self.values = []
        self.subscription = None

    def on_configure(self, state):
        self.subscription = self.create_subscription(Int64, 'numbers', self.on_number, DEPTH)
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state):
        self.destroy_subscription(self.subscription)
        return TransitionCallbackReturn.SUCCESS

    def on_number(self, message):
        self.values.append(message.data)


def test_lifecycle_node_changes_state_through_its_service(ros):
    managed, manager = ros.node('managed', Configured), ros.node('manager')
    publisher = manager.create_publisher(Int64, 'numbers', DEPTH)
    client = manager.create_client(ChangeState, 'managed/change_state')

    def change(transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        assert ros.call(client, request).success

    change(Transition.TRANSITION_CONFIGURE)
    change(Transition.TRANSITION_ACTIVATE)
    assert managed._state_machine.current_state[0] == State.PRIMARY_STATE_ACTIVE
    ros.spin_until_matched(publisher)
    publisher.publish(Int64(data=7))
    ros.spin_until(lambda: managed.values == [7])
    change(Transition.TRANSITION_DEACTIVATE)
    change(Transition.TRANSITION_CLEANUP)
    ros.spin_until(lambda: publisher.get_subscription_count() == 0)


def test_subscription_created_in_a_callback_receives(ros):
    node = ros.node('both')
    publisher = node.create_publisher(Int64, 'numbers', DEPTH)
    values = []

    def subscribe_once():
        timer.cancel()
        node.create_subscription(
            Int64, 'numbers', lambda message: values.append(message.data), DEPTH
        )

    timer = node.create_timer(0.001, subscribe_once)
    ros.spin_until_matched(publisher)
    publisher.publish(Int64(data=1))
    ros.spin_until(lambda: values == [1])


def test_subscription_destroyed_in_a_callback_stops(ros):
    node = ros.node('both')
    publisher = node.create_publisher(Int64, 'numbers', DEPTH)
    values, others = [], []

    def on_number(message):
        values.append(message.data)
        node.destroy_subscription(subscription)

    subscription = node.create_subscription(Int64, 'numbers', on_number, DEPTH)
    node.create_subscription(Int64, 'numbers', lambda m: others.append(m.data), DEPTH)
    ros.spin_until(lambda: publisher.get_subscription_count() == 2)
    publisher.publish(Int64(data=0))
    ros.spin_until(lambda: publisher.get_subscription_count() == 1 and others == [0])
    publisher.publish(Int64(data=1))
    ros.spin_until(lambda: others == [0, 1])
    assert values == [0]


def test_entities_that_destroy_each_other_in_one_wait(ros):
    node = ros.node('clockwork')
    fired = []

    def tick():
        fired.append(None)
        for timer in timers:
            node.destroy_timer(timer)

    timers = [node.create_timer(0.001, tick) for _ in range(3)]
    deadline = time.monotonic() + GIVE_UP_S
    while not all(timer.is_ready() for timer in timers):
        assert time.monotonic() < deadline
    ros.let_pass(node)
    assert len(fired) == 1


def test_entity_destroyed_between_spins_is_gone_at_once(ros):
    node = ros.node('both')
    publisher = node.create_publisher(Int64, 'numbers', DEPTH)
    subscription = node.create_subscription(Int64, 'numbers', lambda message: None, DEPTH)
    ros.spin_until_matched(publisher)
    node.destroy_subscription(subscription)
    deadline = time.monotonic() + GIVE_UP_S
    while publisher.get_subscription_count() > 0:
        assert time.monotonic() < deadline, 'the executor kept the subscription alive'


def test_removed_node_no_longer_runs(ros):
    node, leaving = ros.node('staying'), ros.node('leaving')
    fired = []
    leaving.create_timer(0.001, lambda: fired.append(None))
    ros.spin_until(lambda: fired)
    ros.executor.remove_node(leaving)
    count = len(fired)
    ros.let_pass(node)
    # What was ready before the removal may run still.
    assert len(fired) <= count + 1
    ros.executor.add_node(leaving)
    ros.spin_until(lambda: len(fired) > count + 1)


class DeliberateError(Exception):
    """Raised by callbacks of these tests."""


def raise_deliberately(*_):
    raise DeliberateError


async def raise_in_coroutine(*_):
    raise DeliberateError


@pytest.mark.parametrize('callback', [raise_deliberately, raise_in_coroutine])
@pytest.mark.parametrize('entity', ['subscription', 'timer', 'service', 'guard', 'task'])
def test_exception_of_a_callback_leaves_spin_and_spinning_can_go_on(ros, entity, callback):
    node = ros.node('faulty')
    if entity == 'subscription':
        publisher = node.create_publisher(Int64, 'numbers', DEPTH)
        node.create_subscription(Int64, 'numbers', callback, DEPTH)
        ros.spin_until_matched(publisher)
        publisher.publish(Int64())
    elif entity == 'timer':
        timer = node.create_timer(0.001, callback)
    elif entity == 'service':
        node.create_service(Trigger, 'fail', callback)
        client = node.create_client(Trigger, 'fail')
        ros.spin_until(client.service_is_ready)
        client.call_async(Trigger.Request())
    elif entity == 'guard':
        node.create_guard_condition(callback).trigger()
    else:
        ros.executor.create_task(callback)
    with pytest.raises(DeliberateError):
        ros.executor.spin()
    if entity == 'timer':
        timer.cancel()
    ros.let_pass(node)


def test_incompatible_qos_is_reported_to_both_ends(ros):
    sender, receiver = ros.node('sender'), ros.node('receiver')
    reported = []
    receiver.create_subscription(
        Int64,
        'numbers',
        lambda message: None,
        QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE),
        event_callbacks=SubscriptionEventCallbacks(
            incompatible_qos=lambda event: reported.append('subscription')
        ),
    )
    sender.create_publisher(
        Int64,
        'numbers',
        QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT),
        event_callbacks=PublisherEventCallbacks(
            incompatible_qos=lambda event: reported.append('publisher')
        ),
    )
    ros.spin_until(lambda: len(reported) == 2)
    assert sorted(reported) == ['publisher', 'subscription']


def test_guard_condition_triggered_by_another_thread(ros):
    node = ros.node('guarded')
    called = []
    guard = node.create_guard_condition(lambda: called.append(threading.current_thread()))
    thread = threading.Thread(target=guard.trigger)
    thread.start()
    ros.spin_until(lambda: called)
    thread.join()
    assert called == [threading.main_thread()]


def test_tasks_and_coroutines(ros):
    ros.node('idle')
    gate = Future()

    async def behind_gate(number):
        return number * await gate

    waiting = ros.executor.create_task(behind_gate, 6)
    direct = ros.executor.create_task(lambda: 'done')
    ros.executor.spin_until_future_complete(direct, timeout_sec=GIVE_UP_S)
    assert direct.result() == 'done'
    assert not waiting.done()
    gate.set_result(7)
    ros.executor.spin_until_future_complete(waiting, timeout_sec=GIVE_UP_S)
    assert waiting.result() == 42


def test_future_set_by_another_thread_ends_spinning(ros):
    ros.node('idle')
    future = Future()
    thread = threading.Thread(target=future.set_result, args=(1,))
    thread.start()
    ros.executor.spin_until_future_complete(future, timeout_sec=GIVE_UP_S)
    thread.join()
    assert future.result() == 1


def test_spin_until_future_complete_gives_up(ros):
    ros.node('idle')
    future = Future()
    ros.executor.spin_until_future_complete(future, timeout_sec=0.01)
    assert not future.done()


def test_coroutine_callback_calls_a_service(ros):
    server, caller = ros.node('server'), ros.node('caller')

    async def answer(request, response):
        response.success = True
        return response

    server.create_service(Trigger, 'act', answer)
    client = caller.create_client(Trigger, 'act', callback_group=ReentrantCallbackGroup())
    ros.spin_until(client.service_is_ready)
    results = []

    async def call():
        timer.cancel()
        results.append((await client.call_async(Trigger.Request())).success)

    timer = caller.create_timer(0.001, call)
    ros.spin_until(lambda: results)
    assert results == [True]


def test_suspended_coroutine_blocks_its_callback_group_only(ros):
    node = ros.node('both')
    publisher = node.create_publisher(Int64, 'numbers', DEPTH)
    gate, started, finished, ticks = Future(), [], [], []

    async def on_number(message):
        started.append(message.data)
        await gate
        finished.append(message.data)

    node.create_subscription(Int64, 'numbers', on_number, DEPTH)
    node.create_timer(0.005, lambda: ticks.append(None), callback_group=ReentrantCallbackGroup())
    ros.spin_until_matched(publisher)
    for number in range(3):
        publisher.publish(Int64(data=number))
    ros.spin_until(lambda: started)
    count = len(ticks)
    ros.spin_until(lambda: len(ticks) > count + 3)
    assert (started, finished) == ([0], [])
    gate.set_result(None)
    ros.spin_until(lambda: finished == [0, 1, 2])


def test_callback_may_spin_for_a_future(ros):
    node = ros.node('both')
    node.create_service(
        Trigger,
        'act',
        lambda request, response: response,
        callback_group=ReentrantCallbackGroup(),
    )
    client = node.create_client(Trigger, 'act', callback_group=ReentrantCallbackGroup())
    ros.spin_until(client.service_is_ready)
    depth, results = itertools.count(), []

    def call():
        assert next(depth) == 0, 'the callback group let its callback run inside itself'
        future = client.call_async(Trigger.Request())
        ros.executor.spin_until_future_complete(future, timeout_sec=GIVE_UP_S)
        results.append(future.result())
        timer.cancel()

    timer = node.create_timer(0.001, call)
    ros.spin_until(lambda: results)


def test_busy_topic_starves_no_timer(ros):
    node = ros.node('both')
    publisher = node.create_publisher(Int64, 'numbers', DEPTH)
    node.create_subscription(Int64, 'numbers', publisher.publish, DEPTH)
    ros.spin_until_matched(publisher)
    ticks = []
    node.create_timer(0.001, lambda: ticks.append(None))
    for number in range(DEPTH // 2):
        publisher.publish(Int64(data=number))
    ros.spin_until(lambda: len(ticks) >= 3)


@pytest.mark.parametrize('ros', [('kept_wait_set', 0.0)], indirect=True)
def test_busy_topic_starves_no_rare_callback(ros):
    node = ros.node('both')
    publisher = node.create_publisher(Int64, 'numbers', DEPTH)
    node.create_subscription(Int64, 'numbers', publisher.publish, DEPTH)
    found = []
    group = RareCallbackGroup()
    for kind in ('newest', 'all'):
        depth = 1 if kind == 'newest' else DEPTH
        node.create_subscription(
            Int64, 'numbers', lambda _, kind=kind: found.append(kind), depth, callback_group=group
        )
    node.create_timer(0.001, lambda: found.append('timer'), callback_group=group)
    ros.spin_until_matched(publisher)
    publisher.publish(Int64())
    ros.executor.spin_until(lambda: all(found.count(k) > 3 for k in ('newest', 'all', 'timer')))


@pytest.mark.parametrize('ros', [('kept_wait_set', 0.0)], indirect=True)
def test_shutdown_in_a_callback_ends_spinning_until_something_holds(ros):
    ros.node('quitter').create_timer(0.001, ros.executor.shutdown)
    ros.executor.spin_until(lambda: False)


@pytest.mark.parametrize('what', ['executor', 'context'])
def test_shutdown_in_a_callback_ends_spin(ros, what):
    node = ros.node('quitter')
    node.create_timer(0.001, lambda: getattr(ros, what).shutdown())
    ros.executor.spin()


@pytest.mark.parametrize('what', ['executor', 'context'])
def test_shutdown_by_another_thread_ends_spin(ros, what):
    node = ros.node('quitter')
    spinning = threading.Event()
    timer = node.create_timer(0.001, lambda: (spinning.set(), timer.cancel()))

    def shut_down():
        assert spinning.wait(GIVE_UP_S)
        getattr(ros, what).shutdown()

    thread = threading.Thread(target=shut_down)
    thread.start()
    try:
        ros.executor.spin()
    except ExternalShutdownException:
        assert what == 'context'
    thread.join()


SPIN_UNTIL_SIGNAL = """
import os, rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.signals import SignalHandlerOptions
from dpc_ros.nodes.discovery import prompt_dds
from dpc_ros.nodes.executor import make_executor

with prompt_dds():
    rclpy.init(signal_handler_options=SignalHandlerOptions.{handlers})
node = rclpy.create_node('waiting')
executor = make_executor('{executor}')
executor.add_node(node)
timer = node.create_timer(0.01, lambda: (timer.cancel(), print(os.getpid(), flush=True)))
try:
    executor.spin()
    print('shut down', flush=True)
except (KeyboardInterrupt, ExternalShutdownException):
    print('interrupted', flush=True)
executor.shutdown()
node.destroy_node()
rclpy.try_shutdown()
"""


@pytest.mark.parametrize('ros', [('kept_wait_set', 0.0)], indirect=True)
def test_a_shutdown_ends_each_spin_that_follows(ros):
    ros.node('idle')
    ros.executor.spin_once(timeout_sec=0.0)
    ros.context.shutdown()
    for spin in (ros.executor.spin_once, lambda: ros.executor.spin_until(lambda: False)):
        with pytest.raises(ExternalShutdownException):
            spin()


@pytest.mark.parametrize(
    ('executor', 'handlers', 'number'),
    # Without rclpy's handlers its own executor hears of the signal only at the next message.
    [
        ('kept_wait_set', 'ALL', signal.SIGINT),
        ('kept_wait_set', 'ALL', signal.SIGTERM),
        ('kept_wait_set', 'NO', signal.SIGINT),
        ('single_threaded', 'ALL', signal.SIGINT),
    ],
)
def test_a_signal_ends_an_idle_process(executor, handlers, number):
    with domain_id() as domain:
        process = subprocess.Popen(
            [
                sys.executable,
                '-c',
                SPIN_UNTIL_SIGNAL.format(executor=executor, handlers=handlers),
            ],
            env=os.environ | {'ROS_DOMAIN_ID': str(domain)},
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            os.kill(int(process.stdout.readline()), number)
            output, _ = process.communicate(timeout=GIVE_UP_S)
        finally:
            process.kill()
            process.wait()
    # A spin returns where the context is shut down between two callbacks, as rclpy may at SIGTERM.
    assert output == 'interrupted\n' or (number, output) == (signal.SIGTERM, 'shut down\n')
    assert process.returncode == 0


@pytest.mark.parametrize('ros', [('kept_wait_set', 0.0)], indirect=True)
def test_wait_set_is_kept_until_entities_change(ros):
    node = ros.node('both')
    publisher = node.create_publisher(Int64, 'numbers', DEPTH)
    values = []
    node.create_subscription(Int64, 'numbers', lambda m: values.append(m.data), DEPTH)
    ros.spin_until_matched(publisher)
    kept = []
    for number in range(5):
        publisher.publish(Int64(data=number))
        ros.spin_until(lambda: len(values) > len(kept))
        ros.executor.wake()
        kept.append(ros.executor._kept)
    assert all(wait_set is kept[0] for wait_set in kept)
    ros.let_pass(node)
    assert ros.executor._kept is not kept[0]


def test_make_executor_knows_two_names(ros):
    executors = [make_executor(name, context=ros.context) for name in EXECUTORS]
    for executor in executors:
        executor.shutdown()
    assert [type(executor) for executor in executors] == [
        KeptWaitSetExecutor,
        SingleThreadedExecutor,
    ]
    with pytest.raises(ValueError, match=r"'events'.*kept_wait_set, single_threaded"):
        make_executor('events')
