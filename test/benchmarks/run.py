"""Run the benchmarks, each beside a peer.

    python test/benchmarks/run.py [NAME …] [--results docs/results/benchmarks.json]

Each is in a process of its own, so that nothing of one goes on beside another. What is without ROS
is measured in that, on one thread unless its name says another number. The
ratio of the medians is what counts: the times are this machine's. What both compute is compared
first. With names, as `body_step`, only those are run.

Beside each ratio stands the one that docs/results/benchmarks.json has; where a time has become
worse by more than measurements differ, nothing is written, and the exit code is 1. Whoever accepts
that removes the file.
"""

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path

from tqdm import tqdm

from dpc_ros.results import quantity, read_results, write_results
from dpc_ros.threads import single_threaded_algebra

BENCHMARKS = (
    'body_step',
    'body_accuracy',
    'body_scaling',
    'body_many',
    'compressed',
    'latent_dynamics',
    'graph_training',
    'training_epoch',
    'closed_loop',
    'companions',
    'pictures',
    'lockstep_run',
    'realtime_run',
    'start_up',
    'recording',
)


KNOWN = Path(__file__).parents[2] / 'docs' / 'results' / 'benchmarks.json'
WORSE = 1.5  # times: medians of one machine differ by less, but for those of a few seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    known = ', '.join(BENCHMARKS)
    parser.add_argument('names', nargs='*', metavar='NAME', help=f'of {known}; all where left out')
    parser.add_argument('--results', help='JSON to write')
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in BENCHMARKS]
    if unknown:
        parser.error(f'no benchmark {unknown[0]!r}: choose of {known}')
    if options.names and options.results:
        parser.error('expected --results without names: a file has all benchmarks')
    before = {_key(row): row['ratio'] for row in read_results(KNOWN)} if KNOWN.exists() else {}
    rows = []
    for name in tqdm(options.names or BENCHMARKS, unit='benchmark'):
        with ProcessPoolExecutor(1, get_context('spawn')) as process:
            rows += process.submit(_measure, name).result()
    print(f'{"":<36}{"":>13}   {"beside":<40}{"":>13}   ratio   before')
    for row in rows:
        ours, peer = (quantity(row[key], row['unit']) for key in ('ours_median', 'peer_median'))
        ratio, known_ratio = f'{row["ratio"]:.3g}', before.get(_key(row))
        known_ratio = '–' if known_ratio is None else f'{known_ratio:.3g}'
        what = f'{row["benchmark"]:<36}{ours:>13}   {row["peer"]:<40}{peer:>13}'
        print(f'{what}   {ratio:<7} {known_ratio}')
    slower = [
        row['benchmark']
        for row in rows
        if row['unit'] == 's' and row['ratio'] * WORSE < before.get(_key(row), 0.0)
    ]
    if slower:
        sys.exit(f'slower than {KNOWN.name} has it: {", ".join(slower)}')
    if options.results:
        write_results(options.results, rows, seed=0)


def _measure(name):
    with single_threaded_algebra():
        return import_module(name).measure()


def _key(row):
    return row['benchmark'], row['peer']


if __name__ == '__main__':
    main()
