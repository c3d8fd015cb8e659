"""Two ways of doing the same, timed in turns in one process: their ratio is what counts."""

import statistics
import time


def side_by_side(ours, peer, repetitions, calls=1):
    """Return the median seconds of a call of each, after one to warm up.

    They take turns of some calls at a stretch, as in a loop that finds its data in the cache.
    """
    seconds = {ours: [], peer: []}
    for function in (ours, peer):
        function()
    for _ in range(repetitions):
        for function, times in seconds.items():
            begin = time.perf_counter()
            for _ in range(calls):
                function()
            times.append((time.perf_counter() - begin) / calls)
    return statistics.median(seconds[ours]), statistics.median(seconds[peer])


def shortest(function, repetitions=3):
    """Return the least seconds of some calls, after one to warm up."""
    function()
    times = []
    for _ in range(repetitions):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return min(times)


def row(benchmark, peer, ours_median, peer_median, unit='s', goal=None):
    """Return the row of docs/results/benchmarks.json.

    Args:
        benchmark: its name.
        peer: what stands beside ours.
        ours_median: of our measurements.
        peer_median: of those of the peer.
        unit: of both.
        goal: what the ratio, peer to ours, should reach.
    """
    return {
        'benchmark': benchmark,
        'unit': unit,
        'ours_median': ours_median,
        'peer': peer,
        'peer_median': peer_median,
        'ratio': peer_median / ours_median,
        'goal': goal,
    }
