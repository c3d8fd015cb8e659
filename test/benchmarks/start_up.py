"""How long each node takes from the start of its process until it is configured, and its memory.

The nodes start one at a time, each for itself; the launcher with all of them at once, until the
first state is in the log. Beside each stands a process that makes a bare rclpy node.
"""

import statistics
import subprocess
import tempfile
import time
from pathlib import Path

from processes import end, plan_of, start
from side_by_side import row

from dpc_ros.bag.mcap_file import read_raw
from dpc_ros.nodes.launch_plan import NODES
from dpc_ros.resources import config_path

REPETITIONS = 3
BARE = """
import rclpy
rclpy.init()
node = rclpy.create_node('bare')
node.get_logger().info('configured')
rclpy.spin(node)
"""
PEER = 'a bare rclpy node'


def measure(repetitions=REPETITIONS):
    """Return a row for each node, and one for the launcher."""
    found = {name: [] for name in (*NODES, 'launcher', 'bare')}
    for _ in range(repetitions):
        with tempfile.TemporaryDirectory() as folder:
            plan = plan_of(Path(folder) / 'run')
            for kind in NODES:
                program = ('-m', f'dpc_ros.nodes.{kind}_node', *plan.ros_arguments())
                found[kind].append(_until_configured(*program))
            found['bare'].append(_until_configured('-c', BARE))
            found['launcher'].append((_until_first_state(Path(folder) / 'launched'), None))
    peer, peer_memory = _medians(found.pop('bare'))
    rows = []
    for name, values in found.items():
        seconds, memory = _medians(values)
        rows.append(row(f'start_up_{name}', PEER, seconds, peer))
        if memory is not None:
            rows[-1] |= {'peak_memory_MiB': memory, 'peer_peak_memory_MiB': peer_memory}
    return rows


def _medians(values):
    seconds, memory = zip(*values, strict=True)
    return statistics.median(seconds), None if None in memory else statistics.median(memory)


def _until_configured(*program):
    """Return the seconds until a node says so, and its peak memory then [MiB]."""
    began = time.perf_counter()
    process = start(*program, stderr=subprocess.PIPE, text=True)
    said = []
    for line in process.stderr:
        said.append(line)
        if line.rstrip().endswith('configured'):
            seconds = time.perf_counter() - began
            break
    else:
        raise RuntimeError(f'{" ".join(program)} ended early:\n{"".join(said)}')
    status = Path(f'/proc/{process.pid}/status').read_text().splitlines()
    (peak,) = (line.split()[1] for line in status if line.startswith('VmHWM:'))
    process.stderr.close()
    end([process])
    return seconds, int(peak) / 1024


def _until_first_state(folder):
    began = time.time()
    start(
        *('-m', 'dpc_ros.nodes.launcher', '--config', str(config_path('demo.yaml'))),
        *('--output', str(folder), '--duration', '0.1'),
    ).wait()
    states = read_raw(folder / 'bag', ['/configuration'])
    return min(message.publish_time_ns for message in states) / 1e9 - began
