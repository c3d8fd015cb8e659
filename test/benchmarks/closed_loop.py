"""The closed loop over DDS: from the configuration's publication to the force in hand.

Ours, in lockstep, beside the floor (bare_loop.py) and beside the same nodes in rclpy's own
executor. All variants take turns. `over_peer` beside the floor is what counts.
"""

import json
import statistics
import tempfile
from pathlib import Path

from processes import end, nodes_of, plan_of, start
from side_by_side import row

from dpc_ros.resources import config_path

REPETITIONS = 3
TRIPS = 3000
GOAL = 1 / 1.5  # at most that many times the floor
WARM_UP = 200  # round trips
RATE = 200.0  # Hz
GIVE_UP = 120.0  # s
HERE = Path(__file__).parent
FLOOR = 'bare rclpy nodes, one kept wait set'
SINGLE_THREADED = 'the same in SingleThreadedExecutor'
NODES = ('simulator', 'encoder', 'controller')


def measure(repetitions=REPETITIONS, trips=TRIPS):
    """Return the rows: one process and three, without and with the recorder."""
    variants = {
        'one_process': _composed,
        'one_process_recorded': lambda *rest: _composed(*rest, record=True),
        'one_process_floor': lambda *rest: _floor([NODES], *rest),
        'three_processes': separate,
        'three_processes_recorded': lambda *rest: separate(*rest, record=True),
        'three_processes_floor': lambda *rest: _floor([(kind,) for kind in NODES], *rest),
        'three_processes_single_threaded': lambda *rest: separate(
            *rest, all={'executor': 'single_threaded'}
        ),
    }
    found = {name: [] for name in variants}
    for _ in range(repetitions):
        for name, run in variants.items():
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder) / 'trips.json'
                run(Path(folder) / 'run', file, trips)
                found[name] += json.loads(file.read_text())[WARM_UP:trips]
    return [
        latency_row(
            f'closed_loop_{name}{recorded}',
            peer,
            found[name + recorded],
            found[name + of_peer],
            goal=GOAL if peer == FLOOR else None,
        )
        for name in ('one_process', 'three_processes')
        for recorded in ('', '_recorded')
        for peer, of_peer in ((FLOOR, '_floor'), (SINGLE_THREADED, '_single_threaded'))
        if name + of_peer in found
    ]


def latency_row(benchmark, peer, ours, others, goal=None):
    """Return a row of two series of latencies [s]."""
    median, peer_median = statistics.median(ours), statistics.median(others)
    p99, peer_p99 = (statistics.quantiles(each, n=100)[-1] for each in (ours, others))
    return row(benchmark, peer, median, peer_median, goal=goal) | {
        'over_peer': median / peer_median,
        'ours_p99_s': p99,
        'peer_p99_s': peer_p99,
        'p99_over_median': p99 / median,
    }


def _duration(trips):
    return (trips + 1) / RATE


def _composed(folder, file, trips, record=False):
    start(
        *(str(HERE / 'measured.py'), str(file), 'launcher', '--composed'),
        *('--config', str(config_path('demo.yaml')), '--output', str(folder)),
        *('--duration', str(_duration(trips)), *([] if record else ['--no-record'])),
    ).wait(GIVE_UP)


def separate(folder, file, trips, record=False, companions=(), simulator=None, **parameters):
    """Run the loop in three processes, and write its round trips [s]; see `plan_of`."""
    simulator = {'duration': _duration(trips), **(simulator or {})}
    plan = plan_of(folder, record, companions, simulator=simulator, **parameters)
    with nodes_of(
        plan, simulator=[str(HERE / 'measured.py'), str(file), 'simulator_node']
    ) as nodes:
        nodes['simulator'].wait(GIVE_UP)


def _floor(processes, folder, file, trips):
    leader, *others = [
        start(str(HERE / 'bare_loop.py'), str(trips), str(file), *kinds) for kinds in processes
    ]
    leader.wait(GIVE_UP)
    end(others)
