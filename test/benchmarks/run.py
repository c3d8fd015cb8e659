"""Run the benchmarks, each beside a peer.

    python test/benchmarks/run.py [NAME …] [--results docs/results/benchmarks.json]

Those without ROS are in one process, on one thread unless their name says another number. The
ratio of the medians is what counts: the times are this machine's. What both compute is compared
first. With names, as `body_step`, only those are run, and written.
"""

import argparse
from importlib import import_module

from dpc_ros.results import write_results
from dpc_ros.threads import single_threaded_algebra

BENCHMARKS = (
    'body_step',
    'body_accuracy',
    'body_scaling',
    'body_many',
    'latent_dynamics',
    'graph_training',
    'closed_loop',
    'lockstep_run',
    'realtime_run',
    'start_up',
    'recording',
)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    known = ', '.join(BENCHMARKS)
    parser.add_argument('names', nargs='*', metavar='NAME', help=f'of {known}; all where left out')
    parser.add_argument('--results', help='JSON to write')
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in BENCHMARKS]
    if unknown:
        parser.error(f'no benchmark {unknown[0]!r}: choose of {known}')
    rows = []
    with single_threaded_algebra():
        for name in options.names or BENCHMARKS:
            rows += import_module(name).measure()
    for row in rows:
        print(
            f'{row["benchmark"]:<36}{1e3 * row["ours_median_s"]:>10.4g} ms   '
            f'{row["peer"]:<40}{1e3 * row["peer_median_s"]:>10.4g} ms   ratio {row["ratio"]:.3g}'
        )
    if options.results:
        write_results(options.results, rows, seed=0)


if __name__ == '__main__':
    main()
