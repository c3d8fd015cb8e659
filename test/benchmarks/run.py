"""Run the benchmarks, each beside a peer; all but the recorder's in one process on one thread.

    python test/benchmarks/run.py [--results docs/results/benchmarks.json]

The ratio of the medians is what counts: the times are this machine's. What both compute is compared
first.
"""

import argparse

import graph_training
import latent_dynamics
import recording

from dpc_ros.results import write_results
from dpc_ros.threads import single_threaded_algebra

BENCHMARKS = (latent_dynamics, graph_training, recording)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--results', help='JSON to write')
    options = parser.parse_args()
    rows = []
    with single_threaded_algebra():
        for benchmark in BENCHMARKS:
            rows += benchmark.measure()
    for row in rows:
        print(
            f'{row["benchmark"]:<28}{1e3 * row["ours_median_s"]:>10.3f} ms   '
            f'{row["peer"]:<34}{1e3 * row["peer_median_s"]:>10.3f} ms   ratio {row["ratio"]:.1f}'
        )
    if options.results:
        write_results(options.results, rows, seed=0)


if __name__ == '__main__':
    main()
