"""Looks into logs of runs, mends, compares and exports them; no ROS needed."""

# Beside the room of bags, which loads numpy: the parser must not.
from __future__ import annotations

import argparse
from pathlib import Path


def add_to(parser: argparse.ArgumentParser) -> None:
    """Give the parser of `dpc bag` its commands."""
    commands = parser.add_subparsers(required=True, metavar='COMMAND')

    command = commands.add_parser('converge', help=converge.__doc__, description=converge.__doc__)
    command.set_defaults(command=converge)
    command.add_argument('bag', help='folder or MCAP file of the log')
    command.add_argument('--network', help='of the body, where it is not a shipped one')
    command.add_argument('--checkpoint', help='of the encoder, where it is not a shipped one')
    command.add_argument('--namespace', help='of the topics, where the log has several')
    command.add_argument('--results', help='JSON to write the table to, as in docs/results')
    command.add_argument('--figure', help='PNG to write; default convergence.png in the bag')


def converge(options: argparse.Namespace) -> None:
    """Read a log back and show how the run converged; no ROS needed."""
    from dpc_ros.bag import course, draw, summary, table
    from dpc_ros.bag.report import converge as measure
    from dpc_ros.results import write_results

    convergence, notes = measure(
        options.bag, options.network, options.checkpoint, options.namespace
    )
    folder = Path(options.bag)
    folder = folder if folder.is_dir() else folder.parent
    figure = Path(options.figure or folder / 'convergence.png')
    print(table(convergence))
    for note in notes:
        print(note)
    draw(convergence, figure)
    print(f'\nfigure      {figure}')
    if options.results:
        write_results(options.results, [*course(convergence), summary(convergence)])
        print(f'results     {options.results}')
