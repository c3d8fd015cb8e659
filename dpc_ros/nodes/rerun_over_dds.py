"""Runs a log again over DDS: player in lockstep, encoder, controller and recorder as processes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dpc_ros.bag.rerun import logged_parameters
from dpc_ros.bag.signals import Signals, read_signals
from dpc_ros.control import LAW_PARAMETERS
from dpc_ros.nodes.launch_plan import RECORDER, LaunchPlan
from dpc_ros.nodes.launcher import namespace_arguments, run_processes
from dpc_ros.nodes.stop import StopRequest
from dpc_ros.parameters import node_parameters, parse_overrides

_STARTUP_TIMEOUT = 120.0  # s, for nodes that compile their kernels on the first start
_INTERRUPTED = 130  # exit code after Ctrl-C, as shells have it


def main(arguments: list[str] | None = None) -> None:
    """Run as a process: exit code 0, that of the node that failed, or 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(prog='rerun_over_dds', description=__doc__)
    parser.add_argument('bag', help='folder or MCAP file of the log')
    parser.add_argument('--output', required=True, help='folder of the run, new')
    parser.add_argument('--namespace', help='of the topics in the log')
    parser.add_argument('--set', action='append', default=[], metavar='NODE.PARAMETER=VALUE')
    options = parser.parse_args(arguments)
    try:
        signals = read_signals(options.bag, options.namespace)
        plan = rerun_plan(signals, Path(options.output), parse_overrides(options.set))
        plan.write()
    except (ValueError, OSError) as error:
        sys.exit(_complain(str(error), 2))
    except KeyboardInterrupt:
        sys.exit(_INTERRUPTED)
    with StopRequest(namespace_arguments(plan)) as stop:
        outcome = run_processes(plan, stop)
        interrupted = bool(stop)
    if outcome.failure:
        sys.exit(_complain(outcome.failure, outcome.exit_code))
    sys.exit(_INTERRUPTED if interrupted else 0)


def rerun_plan(
    signals: Signals, folder: Path, overrides: Mapping[str, Mapping[str, Any]]
) -> LaunchPlan:
    """Return what is started to run a log again.

    The player gives the controller, as targets and parameters, what the log's controller announced
    as in force, each before the state from which on it counted. Parameters that are overridden
    stay.

    Args:
        signals: of the log.
        folder: of the new run; must not exist yet.
        overrides: parameters by node that win over those of the log.

    Raises:
        ValueError: the log does not say its parameters, or a value can't be used.
    """
    folder = folder.resolve()
    logged = logged_parameters(signals, overrides)
    readers = {'configuration': ['encoder', RECORDER]}
    if signals.targets or signals.in_force:
        targets = 'target_in_force' if signals.in_force else 'target'
        readers[targets] = ['controller', RECORDER]
    if signals.parameters:
        readers['parameters_in_force'] = ['controller']
    fixed = overrides.get('controller', {})
    replayed = [name for name in LAW_PARAMETERS if name not in fixed] if signals.parameters else []
    observing = ['encoder'] if logged['encoder']['observer'] != 'none' else []
    given: dict[str, dict[str, Any]] = {
        RECORDER: {
            'bag': str(folder / 'bag'),
            'parameters_file': str(folder / 'parameters.yaml'),
        },
        'encoder': {**logged['encoder'], 'expected_subscribers': ['controller', RECORDER]},
        'controller': {
            **logged['controller'],
            'target': '',
            'solve_in_background': False,
            'replayed_parameters': replayed,
            'expected_subscribers': ['player', RECORDER, *observing],
        },
        'player': {
            'bag': str(signals.path.resolve()),
            'topics': [*readers],
            'time_mode': 'lockstep',
            'startup_timeout': _STARTUP_TIMEOUT,
            'expected_subscribers': [
                f'{reader}@{topic}' for topic, names in readers.items() for reader in names
            ],
        },
    }
    return LaunchPlan(
        {node: node_parameters(node, values) for node, values in given.items()},
        folder,
        signals.namespace or '/',
        leader='player',
        remappings={
            'player': ('target_in_force:=target', 'parameters_in_force:=parameters'),
        },
    )


def _complain(text: str, code: int) -> int:
    print(f'error: {text}', file=sys.stderr)
    return code


if __name__ == '__main__':
    main()
