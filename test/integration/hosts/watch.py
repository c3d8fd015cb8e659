"""Says when the body has come to a state: `python watch.py STAMP` [ns]; ends when it is told to."""

import contextlib
import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import JointState

from dpc_ros.nodes.discovery import prompt_dds
from dpc_ros.nodes.messages import from_stamp
from dpc_ros.nodes.topics import LOOP_QOS


def main(stamp):
    with prompt_dds():
        rclpy.init()
    node = rclpy.create_node('watch')
    said = []

    def see(message):
        if from_stamp(message.header.stamp) >= stamp and not said:
            said.append('there')
            print(*said, flush=True)

    node.create_subscription(JointState, 'configuration', see, LOOP_QOS)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == '__main__':
    main(int(sys.argv[1]))
