"""Recording of the demonstration in real time: share of a core that the recorder takes, and losses.

The nodes are processes, as the launcher starts them; the recorder's time is that between the first
and the last message in its log. There is no peer: the time stands beside a quarter of a core.
"""

import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
from processes import nodes_of, plan_of
from side_by_side import row

from dpc_ros.bag import read_run
from dpc_ros.bag.mcap_file import read_messages

RATES = (200.0, 1000.0)  # Hz
DURATION = 5.0  # s, of simulated time
REPETITIONS = 3
QUARTER_OF_A_CORE = 0.25
TOPICS = ('/configuration', '/latent_state', '/control_force')
SAMPLING = 0.02  # s between two looks at the recorder's time


def measure():
    """Return one row for each rate: seconds of the recorder's processor time per second."""
    return [_row(rate, [_record(rate) for _ in range(REPETITIONS)]) for rate in RATES]


def _row(rate, runs):
    share = statistics.median(run['share'] for run in runs)
    name, peer = f'recorder_{rate:g}_hz', 'a quarter of a core'
    return row(name, peer, share, QUARTER_OF_A_CORE, 'cores') | {
        'rate_sustained_Hz': statistics.median(run['rate'] for run in runs),
        'messages': sum(run['messages'] for run in runs),
        'lost': sum(run['lost'] for run in runs),
    }


def _record(rate):
    with tempfile.TemporaryDirectory() as folder:
        simulator = {'rate': rate, 'time_mode': 'realtime', 'duration': DURATION}
        plan = plan_of(Path(folder) / 'run', simulator=simulator)
        with nodes_of(plan) as nodes:
            samples = _sample(nodes['recorder'], nodes['simulator'])
        return _evaluate(plan.bag, rate, samples)


def _sample(recorder, simulator):
    """Return times [ns] and the recorder's processor time [s], until the simulator has ended."""
    process = psutil.Process(recorder.pid)
    samples = []
    while simulator.poll() is None:
        spent = process.cpu_times()
        samples.append((time.time_ns(), spent.user + spent.system))
        time.sleep(SAMPLING)
    return np.array(samples)


def _evaluate(bag, rate, samples):
    times = [message.log_time_ns for message in read_messages(bag, TOPICS)]
    begin, end = min(times), max(times)
    spent = np.interp([begin, end], samples[:, 0], samples[:, 1])
    seconds = (end - begin) / 1e9
    run = read_run(bag)
    expected = round(rate * DURATION) + 1
    missing = expected - len(run.configuration)
    return {
        'share': (spent[1] - spent[0]) / seconds,
        'rate': len(run.configuration) / seconds,
        'messages': len(times),
        'lost': missing + sum(run.losses.values()),
    }
