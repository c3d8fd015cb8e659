"""Run a program of this package, and write every round trip that its simulator measures [s].

    python test/benchmarks/measured.py FILE simulator_node|launcher ARGUMENTS…

On /diagnostics the simulator shows the percentiles of each second, and forgets them.
"""

import json
import sys
from importlib import import_module
from pathlib import Path

from dpc_ros.nodes import simulator_node
from dpc_ros.nodes.window import Window


class KeptWindow(Window):
    """Durations that stay when they are reported."""

    def __init__(self):
        super().__init__()
        self.all = []

    def add(self, seconds):
        super().add(seconds)
        self.all.append(seconds)


ROUND_TRIPS = KeptWindow()


class MeasuredSimulator(simulator_node.SimulatorNode):
    """The simulator as it is."""

    def __init__(self, context=None):
        super().__init__(context)
        self.health.round_trips.window = ROUND_TRIPS


def main(file, program, *arguments):
    simulator_node.SimulatorNode = MeasuredSimulator
    try:
        import_module(f'dpc_ros.nodes.{program}').main(list(arguments))
    finally:
        Path(file).write_text(json.dumps(ROUND_TRIPS.all))


if __name__ == '__main__':
    main(*sys.argv[1:])
