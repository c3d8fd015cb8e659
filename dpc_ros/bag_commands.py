"""Looks into logs of runs, mends, compares and exports them; no ROS needed."""

# Beside the room of bags, which loads numpy: the parser must not.
from __future__ import annotations

import argparse
import datetime
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any


def add_to(parser: argparse.ArgumentParser) -> None:
    """Give the parser of `dpc bag` its commands."""
    commands = parser.add_subparsers(required=True, metavar='COMMAND')

    command = commands.add_parser('info', help=info.__doc__, description=info.__doc__)
    command.set_defaults(command=info)
    command.add_argument('bag', help='folder or MCAP file of the log')

    command = commands.add_parser('compare', help=compare.__doc__, description=compare.__doc__)
    command.set_defaults(command=compare)
    command.add_argument('first', help='folder or MCAP file of a log')
    command.add_argument('second', help='of the log to hold against it')
    command.add_argument(
        '--tolerance',
        type=float,
        default=0.0,
        metavar='REL',
        help='deviation of a number that counts as none, relative to the largest magnitude of its '
        'field in the first log; default 0',
    )

    command = commands.add_parser('export', help=export.__doc__, description=export.__doc__)
    command.set_defaults(command=export)
    command.add_argument('bag', help='folder or MCAP file of the log')
    command.add_argument(
        'output',
        help='<name>.csv or <name>.parquet, a folder with a file for each topic, '
        'or <name>.npz; must be new',
    )
    command.add_argument('--network', help='that names the coordinates; default the one logged')

    command = commands.add_parser('repair', help=repair.__doc__, description=repair.__doc__)
    command.set_defaults(command=repair)
    command.add_argument('bag', help='folder or MCAP file of the log, left as it is')
    command.add_argument('output', help='folder (or .mcap file for a file) to write; must be new')

    command = commands.add_parser('converge', help=converge.__doc__, description=converge.__doc__)
    command.set_defaults(command=converge)
    command.add_argument('bag', help='folder or MCAP file of the log')
    command.add_argument('--network', help='of the body, where it is not a shipped one')
    command.add_argument('--checkpoint', help='of the encoder, where it is not a shipped one')
    command.add_argument('--namespace', help='of the topics, where the log has several')
    command.add_argument('--results', help='JSON to write the table to, as in docs/results')
    command.add_argument('--figure', help='PNG to write; default convergence.png in the bag')

    command = commands.add_parser('report', help=report.__doc__, description=report.__doc__)
    command.set_defaults(command=report)
    command.add_argument('bag', help='folder or MCAP file of the log')
    command.add_argument('--network', help='of the body, where it is not a shipped one')
    command.add_argument('--checkpoint', help='of the encoder, where it is not a shipped one')
    command.add_argument('--namespace', help='of the topics, where the log has several')
    command.add_argument('--output', help='HTML to write; default report.html in the bag')
    add_rerun_command(commands)


def info(options: argparse.Namespace) -> None:
    """Show what a log holds: topics, rates, gaps, losses, models, records, files."""
    from dpc_ros.bag.information import inform, information_table

    print(information_table(inform(options.bag, progress=True)))


def compare(options: argparse.Namespace) -> int:
    """Show where two logs differ; exit code 1 where they do."""
    from dpc_ros.bag.comparison import compare as hold_against
    from dpc_ros.bag.comparison_table import comparison_table

    found = hold_against(options.first, options.second, options.tolerance, progress=True)
    print(comparison_table(found))
    print('\nequal' if found.is_equal else '\nDIFFERENT')
    return 0 if found.is_equal else 1


def export(options: argparse.Namespace) -> None:
    """Write the topics of a log as tables: CSV, NPZ or Parquet."""
    from dpc_ros.bag.export import export as write

    for line in write(options.bag, options.output, options.network, progress=True):
        print(line)


def repair(options: argparse.Namespace) -> int | None:
    """Write all that can be read of a log that was cut off or damaged into a new one."""
    from dpc_ros.bag.repair import NothingReadableError
    from dpc_ros.bag.repair import repair as mend

    try:
        files = mend(options.bag, options.output, progress=True)
    except NothingReadableError as error:
        print(f'error: {error}', file=sys.stderr)
        return 1
    for file in files:
        kept = f'{file.messages} messages in {file.chunks} chunks' if file.is_kept else 'left out'
        whole = '' if file.losses else ', whole'
        print(f'{file.name}' + (f': {kept} of {file.size} bytes{whole}' if file.size else ''))
        for loss in file.losses:
            print(f'  lost      {loss}')
    if not any(file.losses for file in files):
        print(f'nothing was wrong with {options.bag}: the new one is a copy')
    print(f'bag         {options.output}, read back and found whole')
    return None


def converge(options: argparse.Namespace) -> None:
    """Read a log back and show how the run converged; no ROS needed."""
    from dpc_ros.bag import course, draw, summary, table
    from dpc_ros.bag.report import converge as measure
    from dpc_ros.results import write_results

    convergence, notes = measure(
        options.bag, options.network, options.checkpoint, options.namespace
    )
    figure = Path(options.figure or _folder(options.bag) / 'convergence.png')
    print(table(convergence))
    for note in notes:
        print(note)
    draw(convergence, figure)
    print(f'\nfigure      {figure}')
    if options.results:
        write_results(options.results, [*course(convergence), summary(convergence)])
        print(f'results     {options.results}')


def report(options: argparse.Namespace) -> None:
    """Write a page about a log that any browser opens: the body in motion, plots, tables."""
    from dpc_ros.bag import inform
    from dpc_ros.bag.report import converge as measure
    from dpc_ros.view.report import FILE_NAME, write_report

    convergence, notes = measure(
        options.bag, options.network, options.checkpoint, options.namespace, progress=True
    )
    path = Path(options.output or _folder(options.bag) / FILE_NAME)
    write_report(convergence, inform(options.bag, progress=True), notes, path)
    for note in notes:
        print(note)
    print(f'report      {path}')


def _folder(bag: str) -> Path:
    """Return the folder of a bag that is named by it, or by one of its files."""
    path = Path(bag)
    return path if path.is_dir() else path.parent


def add_rerun_command(commands: Any) -> None:
    """Give `dpc bag` its command `rerun`."""
    command = commands.add_parser('rerun', help=rerun.__doc__, description=rerun.__doc__)
    command.set_defaults(command=rerun)
    command.add_argument('bag', help='folder or MCAP file of the log')
    command.add_argument('--checkpoint', help='of encoder and controller instead of the logged one')
    command.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NODE.PARAMETER=VALUE',
        help='override one parameter of encoder or controller; may be given several times',
    )
    command.add_argument('--namespace', help='of the topics, where the log has several')
    command.add_argument(
        '--over-dds', action='store_true', help='through the nodes, the player in lockstep'
    )
    command.add_argument(
        '--output', help='folder of the run over DDS, new; default runs/rerun_<date>_<time>'
    )


def rerun(options: argparse.Namespace) -> int:
    """Feed a log through encoder and controller again and show what has changed."""
    from dpc_ros.bag.rerun import RERUN_NODES, check_answers, logged_parameters
    from dpc_ros.bag.rerun import rerun as run_again
    from dpc_ros.bag.rerun_table import table
    from dpc_ros.parameters import parse_overrides

    if options.output and not options.over_dds:
        raise ValueError('--output: expected --over-dds with it, only then a new log is written')
    overrides = parse_overrides(options.set)
    if options.checkpoint:
        for node in RERUN_NODES:
            overrides.setdefault(node, {})['checkpoint'] = options.checkpoint
    if not options.over_dds:
        result = run_again(options.bag, overrides, options.namespace, progress=True)
        print(table(result))
        return 0 if result.passed else 1

    from dpc_ros.bag.rerun import judge, parameter_notes
    from dpc_ros.bag.signals import read_signals

    signals = read_signals(options.bag, options.namespace)
    check_answers(signals)
    parameters = logged_parameters(signals, overrides)
    folder = Path(options.output or f'runs/rerun_{datetime.datetime.now():%Y%m%d_%H%M%S}')
    sets = [
        f'--set={node}.{name}={value}'
        for node, values in overrides.items()
        for name, value in values.items()
    ]
    code = _run_over_dds(
        [str(options.bag), '--output', str(folder), '--namespace', signals.namespace, *sets]
    )
    if code:
        return code
    repeated = read_signals(folder / 'bag', signals.namespace)
    result = judge(signals, repeated.columns(), parameters, parameter_notes(signals))
    print(table(result))
    print(f'log        {folder / "bag"}')
    return 0 if result.passed else 1


def _run_over_dds(arguments: list[str]) -> int:
    if find_spec('rclpy') is None:
        raise ValueError("--over-dds needs ROS 2: pip install 'dpc_ros[ros]', or source yours")
    command = [sys.executable, '-m', 'dpc_ros.nodes.rerun_over_dds', *arguments]
    with subprocess.Popen(command) as process:
        try:
            return process.wait()
        except KeyboardInterrupt:
            process.wait()  # it is told by the same Ctrl-C, and ends its nodes first
            raise
