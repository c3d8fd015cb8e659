import pytest
import rclpy
from domain_coordinator import domain_id
from geometry_msgs.msg import WrenchStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

from dpc_ros.nodes.discovery import prompt_dds
from dpc_ros.nodes.launch_plan import make_plan
from dpc_ros.nodes.monitor import Monitor
from dpc_ros.nodes.topics import TOPICS
from dpc_ros.resources import config_path


@pytest.fixture
def monitor(tmp_path):
    with domain_id() as domain:
        context = Context()
        with prompt_dds():
            rclpy.init(context=context, domain_id=domain)
        monitor = Monitor(make_plan(config_path('demo.yaml'), {}, tmp_path / 'run'), context)
        yield monitor
        monitor.destroy_node()
        context.try_shutdown()


@pytest.fixture
def publish(monitor):
    """Return a function: it publishes a message on a topic and lets the monitor take it."""
    node = rclpy.create_node('other', context=monitor.context)
    executor = SingleThreadedExecutor(context=monitor.context)
    executor.add_node(monitor)

    def send(topic, message):
        entry = TOPICS[topic]
        publisher = node.create_publisher(entry.message_type, topic, entry.qos)
        while not publisher.get_subscription_count():
            executor.spin_once(timeout_sec=0.01)
        publisher.publish(message)
        while not publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=0.0)):
            executor.spin_once(timeout_sec=0.01)
        executor.spin_once(timeout_sec=0.01)

    yield send
    executor.shutdown()
    node.destroy_node()


def test_messages_that_no_node_can_use_do_not_end_it(monitor, publish):
    noise = b'\x00\x01' + 30 * b'\xff'
    sent = [
        ('target_in_force', noise),
        ('target', JointState(position=[0.0] * 400)),
        ('configuration', JointState(position=[0.0] * 4)),
        ('configuration', noise),
        ('control_force', WrenchStamped()),
        ('configuration', JointState(position=[1.0] * 400)),
    ]
    for topic, message in sent:
        publish(topic, message)
        assert monitor.seconds == 0.0
        monitor._show()
    assert monitor.target_in_force() is None
    monitor.close()


@pytest.mark.parametrize('size', [0, 3])
def test_it_knows_the_time_of_the_newest_state(monitor, publish, size):
    """That of one like the first, and of one that is not."""
    for second, names in ((0, []), (4, []), (5, [f'q_{i}' for i in range(size + 1)])):
        numbers = [0.5] * (len(names) or size)
        message = JointState(name=names, position=numbers, velocity=numbers)
        message.header.stamp.sec = second
        publish('configuration', message)
        while monitor.seconds != second:
            publish('configuration', message)
        monitor._show()
    monitor.close()
