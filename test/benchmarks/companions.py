"""The latency of the loop while a companion draws it for someone, beside that without.

Three processes without a recorder, in lockstep, where the loop takes all that the machine gives it,
and by the wall clock. Both take turns. A companion may cost a tenth.
"""

import json
import tempfile
from pathlib import Path

from closed_loop import RATE, WARM_UP, latency_row, separate
from processes import end, start

REPETITIONS = 3
TRIPS = 2000
GOAL = 1 / 1.1
HERE = Path(__file__).parent
# Programs that look at what a companion shows until they are ended; it does nothing before.
WATCHERS = {'markers': 'watch_markers.py', 'viewer': 'watch_viewer.py'}


def measure(repetitions=REPETITIONS, trips=TRIPS):
    """Return the rows: of each companion, in lockstep and by the wall clock."""
    return [
        row
        for companion in WATCHERS
        for mode in ('lockstep', 'realtime')
        for row in _measure(companion, mode, repetitions, trips)
    ]


def _measure(companion, mode, repetitions, trips):
    found = {companion: [], '': []}
    for _ in range(repetitions):
        for looks_on, durations in found.items():
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder) / 'trips.json'
                if looks_on:
                    with_companion(looks_on, Path(folder) / 'run', file, trips, mode)
                else:
                    separate(Path(folder) / 'run', file, trips, **_parameters(mode))
                durations += json.loads(file.read_text())[WARM_UP:trips]
    name = f'closed_loop_{mode}_with_{companion}'
    return [latency_row(name, 'the same without', found[companion], found[''], goal=GOAL)]


def with_companion(companion, folder, file, trips, mode):
    """Run the loop while a companion draws, and write its round trips [s].

    The run begins when the companion hears it, which it does when someone watches.

    Args:
        companion: one of `WATCHERS`.
        folder: of the run, new.
        file: to write.
        trips: how many.
        mode: `lockstep` or `realtime`.
    """
    watcher = start(str(HERE / WATCHERS[companion]))
    try:
        parameters = _parameters(mode, [companion])
        separate(folder, file, trips, companions=[companion], **parameters)
    finally:
        end([watcher])


def _parameters(mode, readers=()):
    simulator = {'time_mode': mode, 'rate': RATE, 'expected_subscribers': ['encoder', *readers]}
    return {'simulator': simulator, 'controller': {'solve_in_background': mode == 'realtime'}}
