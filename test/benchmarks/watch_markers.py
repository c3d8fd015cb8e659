"""Take markers until told to stop, as a viewer would, and do nothing with them."""

from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from dpc_ros.nodes.executor import make_executor
from dpc_ros.nodes.loop_node import spin_until
from dpc_ros.nodes.markers_node import MARKERS
from dpc_ros.nodes.stop import StopRequest


def main():
    with StopRequest([]) as stop:
        node = Node('watcher', context=stop.context)
        node.create_subscription(MarkerArray, 'markers', lambda data: None, MARKERS.qos, raw=True)
        executor = make_executor('kept_wait_set', context=stop.context)
        executor.add_node(node)
        spin_until(executor, lambda: bool(stop))
        executor.shutdown()
        node.destroy_node()


if __name__ == '__main__':
    main()
