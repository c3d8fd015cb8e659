import pytest
import rclpy
from domain_coordinator import domain_id
from geometry_msgs.msg import WrenchStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

from dpc_ros.nodes.launch_plan import make_plan
from dpc_ros.nodes.monitor import Monitor
from dpc_ros.nodes.topics import TOPICS
from dpc_ros.resources import config_path


@pytest.fixture
def monitor(tmp_path):
    with domain_id() as domain:
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        monitor = Monitor(make_plan(config_path('demo.yaml'), {}, tmp_path / 'run'), context)
        yield monitor
        monitor.destroy_node()
        context.try_shutdown()


def test_messages_that_no_node_can_use_do_not_end_it(monitor):
    node = rclpy.create_node('other', context=monitor.context)
    executor = SingleThreadedExecutor(context=monitor.context)
    executor.add_node(monitor)
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
        entry = TOPICS[topic]
        publisher = node.create_publisher(entry.message_type, topic, entry.qos)
        while not publisher.get_subscription_count():
            executor.spin_once(timeout_sec=0.01)
        publisher.publish(message)
        while not publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=0.0)):
            executor.spin_once(timeout_sec=0.01)
        executor.spin_once(timeout_sec=0.01)
        assert monitor.seconds == 0.0
        monitor._show()
    assert monitor.target_in_force() is None
    monitor.close()
    executor.shutdown()
    node.destroy_node()
