"""The demonstration by the wall clock, 60 s at 200 Hz, in three processes with the recorder.

There are two rows: the steps that the simulator has missed and reported, and the processor time of
all nodes together. They stand beside what is allowed: one step in a hundred, and one core.
"""

import contextlib
import tempfile
import time
from pathlib import Path

import psutil
from processes import nodes_of, plan_of
from side_by_side import row

from dpc_ros.bag.mcap_file import read_messages
from dpc_ros.nodes.messages import from_stamp

DURATION = 60.0  # s, of simulated time
RATE = 200.0  # Hz
ALLOWED_SHARE = 0.01  # of the steps
GOAL = 10.0  # times fewer
LOOP_TOPICS = ['/configuration', '/latent_state', '/control_force']


def measure(duration=DURATION):
    """Return the rows of missed steps and of processor time."""
    with tempfile.TemporaryDirectory() as folder:
        plan = plan_of(
            Path(folder) / 'run',
            simulator={'duration': duration, 'time_mode': 'realtime', 'rate': RATE},
            controller={'solve_in_background': True},
            recorder={'topics': [*LOOP_TOPICS, '/diagnostics']},
        )
        with nodes_of(plan) as nodes:
            samples = _sample(list(nodes.values()), nodes['simulator'])
        begin, end = _period(plan.bag)
        missed = _missed_steps(plan.bag)
    inside = [sample for sample in samples if begin <= sample[0] <= end]
    (first, spent_first), (last, spent_last) = inside[0], inside[-1]
    cores = (spent_last - spent_first) / (last - first)
    steps = round(duration * RATE)
    share = max(missed, 1) / (steps + missed)  # of none missed the ratio would be infinite
    peer = 'one step in a hundred'
    return [
        row('realtime_cores', 'one core', cores, 1.0, 'cores', goal=1.0)
        | {'wall_s_per_simulated_s': (end - begin) / duration},
        row('realtime_missed_share', peer, share, ALLOWED_SHARE, 'of steps', goal=GOAL)
        | {'missed_steps': missed, 'steps': steps},
    ]


def _sample(processes, simulator):
    """Return times [s] and processor times of all [s], until the simulator has ended."""
    known = [psutil.Process(process.pid) for process in processes]
    samples, spent = [], {}
    while simulator.poll() is None:
        for each in known:
            with contextlib.suppress(psutil.NoSuchProcess):  # what has ended keeps its last time
                for process in _family(each):
                    times = process.cpu_times()
                    spent[process.pid] = times.user + times.system
        samples.append((time.time(), sum(spent.values())))
        time.sleep(0.1)
    return samples


def _family(process):
    """Return a process with those that it has started, as a controller does to solve."""
    return [process, *process.children(recursive=True)]


def _period(bag):
    """Return when the first step and the last state were published [s]."""
    times = {}
    for message in read_messages(bag, ['/configuration']):
        times.setdefault(from_stamp(message.content.header.stamp), message.publish_time_ns / 1e9)
    _, *stamps = sorted(times)
    return times[stamps[0]], times[stamps[-1]]


def _missed_steps(bag):
    """Return what the simulator has reported last."""
    missed = 0
    for message in read_messages(bag, ['/diagnostics']):
        for status in message.content.status:
            if status.name == 'simulator':
                values = {pair.key: pair.value for pair in status.values}
                missed = int(values.get('missed steps', missed))
    return missed
