"""A run of the demonstration in lockstep, 5 s at 5 ms, in three processes with the recorder.

What counts is the wall time from the first step to the last state, as the log has it. There is no
peer: it stands beside the time that is simulated.
"""

import statistics
import tempfile
from pathlib import Path

from processes import nodes_of, plan_of
from side_by_side import row

from dpc_ros.bag.mcap_file import read_messages
from dpc_ros.nodes.messages import from_stamp

DURATION = 5.0  # s, of simulated time
REPETITIONS = 5
GIVE_UP = 120.0  # s
GOAL = 4.0  # times as fast


def measure():
    """Return one row: seconds for the run, beside the seconds that it simulates."""
    seconds = statistics.median(_run() for _ in range(REPETITIONS))
    return [row('lockstep_run', 'real time', seconds, DURATION, goal=GOAL)]


def _run():
    with tempfile.TemporaryDirectory() as folder:
        plan = plan_of(Path(folder) / 'run', simulator={'duration': DURATION})
        with nodes_of(plan) as nodes:
            nodes['simulator'].wait(GIVE_UP)
        published = {}  # the first publication of each stamp [s]
        for message in read_messages(plan.bag, ['/configuration']):
            stamp = from_stamp(message.content.header.stamp)
            published.setdefault(stamp, message.publish_time_ns / 1e9)
    # The first state waits for the other nodes: the time begins with the one that follows.
    first, *others = sorted(published)
    begin, end = others[0], others[-1]
    return (published[end] - published[begin]) * (end - first) / (end - begin)
