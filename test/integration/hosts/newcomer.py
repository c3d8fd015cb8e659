"""Who comes last to a domain with many bodies: `python newcomer.py NODES REPORTS`.

Once the nodes of all bodies work, and have announced themselves often enough, it prints after how
long somebody new has found them all [s]; then the values that each has reported of its health
since, so many times: by the name with the namespace, of each key a list. Both are JSON behind MARK.
"""

import json
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context

from dpc_ros.nodes.discovery import prompt_dds

MARK = 'answer '
PERIOD = 0.01  # s between two looks at the graph
ANNOUNCED = 15.0  # s, after which a node announces itself seldom
GIVE_UP = 400.0  # s


def time_to_find(names):
    """Return how long a new participant takes until it knows nodes of these names [s]."""
    context = Context()
    with prompt_dds():
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


def answer(content):
    print(f'{MARK}{json.dumps(content)}', flush=True)


def main(nodes, count):
    with prompt_dds():
        rclpy.init()
    watcher = rclpy.create_node('watcher')
    reports, deadline = {}, time.monotonic() + GIVE_UP

    def hear(message):
        for status in message.status:
            values = reports.setdefault(status.hardware_id, {})
            for each in status.values:
                values.setdefault(each.key, []).append(each.value)

    def wait(condition):
        while len(reports) < nodes or not all(map(condition, reports.values())):
            if time.monotonic() > deadline:
                raise TimeoutError(f'of {nodes} nodes work, and report: {[*reports]}')
            rclpy.spin_once(watcher, timeout_sec=1.0)

    def listen():
        return watcher.create_subscription(DiagnosticArray, '/diagnostics', hear, 10 * nodes)

    before = listen()
    wait(
        lambda values: (
            values['published'][-1] != '0' and float(values['uptime [s]'][-1]) > ANNOUNCED
        )
    )
    watcher.destroy_subscription(before)  # what comes meanwhile is of no interest
    answer(time_to_find({*reports}))
    reports.clear()
    listen()
    wait(lambda values: len(values['published']) >= count)
    answer(reports)
    watcher.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
