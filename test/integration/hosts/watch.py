"""Waits until the body has come to a state: `python watch.py STAMP` [ns]."""

import sys

import rclpy
from sensor_msgs.msg import JointState

from dpc_ros.nodes.discovery import prompt_dds
from dpc_ros.nodes.messages import from_stamp
from dpc_ros.nodes.topics import LOOP_QOS


def main(stamp):
    with prompt_dds():
        rclpy.init()
    node = rclpy.create_node('watch')
    seen = []

    def see(message):
        if from_stamp(message.header.stamp) >= stamp:
            seen.append(message)

    node.create_subscription(JointState, 'configuration', see, LOOP_QOS)
    while not seen:
        rclpy.spin_once(node)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main(int(sys.argv[1]))
