"""The ROS 2 nodes: thin adapters around the core. Only here is rclpy imported."""

import sys

if sys.argv[:1] == ['-m']:  # Python is on its way to a program in here: `python -m dpc_ros.nodes.…`
    from dpc_ros.nodes.program import end_quietly

    end_quietly(sys.orig_argv[sys.orig_argv.index('-m') + 1])
