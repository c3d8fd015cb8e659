"""Who comes last to a domain with many bodies: `python newcomer.py NODES REPORTS`.

Once the nodes of all bodies work it prints, as JSON, after how long somebody new has found them all
[s]; then the values that each has reported of its health since, so many times: by the name with the
namespace, of each key a list.
"""

import json
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context

PERIOD = 0.01  # s between two looks at the graph


def time_to_find(names):
    """Return how long a new participant takes until it knows nodes of these names [s]."""
    context = Context()
    rclpy.init(context=context)
    began = time.monotonic()
    node = rclpy.create_node('newcomer', context=context)

    def found():
        pairs = node.get_node_names_and_namespaces()
        return {f'{namespace.rstrip("/")}/{name}' for name, namespace in pairs}

    while not names <= found():
        time.sleep(PERIOD)
    seconds = time.monotonic() - began
    node.destroy_node()
    context.shutdown()
    return seconds


def main(nodes, count):
    rclpy.init()
    watcher = rclpy.create_node('watcher')
    reports = {}

    def hear(message):
        for status in message.status:
            values = reports.setdefault(status.hardware_id, {})
            for each in status.values:
                values.setdefault(each.key, []).append(each.value)

    def wait(condition):
        while len(reports) < nodes or not all(map(condition, reports.values())):
            rclpy.spin_once(watcher)

    watcher.create_subscription(DiagnosticArray, '/diagnostics', hear, 10 * nodes)
    wait(lambda values: values['published'][-1] != '0')
    print(json.dumps(time_to_find({*reports})), flush=True)
    reports.clear()
    wait(lambda values: len(values['published']) >= count)
    print(json.dumps(reports), flush=True)
    watcher.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
