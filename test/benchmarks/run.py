"""Run the benchmarks, each beside a peer; those without ROS in one process on one thread.

    python test/benchmarks/run.py [NAME …] [--results docs/results/benchmarks.json]

The ratio of the medians is what counts: the times are this machine's. What both compute is compared
first. With names, as `closed_loop`, only those are run, and written.
"""

import argparse

import closed_loop
import graph_training
import latent_dynamics
import lockstep_run
import realtime_run
import recording
import start_up

from dpc_ros.results import write_results
from dpc_ros.threads import single_threaded_algebra

BENCHMARKS = (
    latent_dynamics,
    graph_training,
    closed_loop,
    lockstep_run,
    realtime_run,
    start_up,
    recording,
)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    known = {benchmark.__name__: benchmark for benchmark in BENCHMARKS}
    parser.add_argument('names', nargs='*', metavar='NAME', help=', '.join(known))
    parser.add_argument('--results', help='JSON to write')
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in known]
    if unknown:
        parser.error(f'no benchmark {unknown[0]!r}: choose of {", ".join(known)}')
    rows = []
    with single_threaded_algebra():
        for name in options.names or known:
            rows += known[name].measure()
    for row in rows:
        print(
            f'{row["benchmark"]:<36}{1e3 * row["ours_median_s"]:>10.3f} ms   '
            f'{row["peer"]:<40}{1e3 * row["peer_median_s"]:>10.3f} ms   ratio {row["ratio"]:.1f}'
        )
    if options.results:
        write_results(options.results, rows, seed=0)


if __name__ == '__main__':
    main()
