"""`dpc`: the offline commands. Each imports what it needs when it is called."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from dpc_ros import __version__

DATA_FOLDER = Path('runs/data')
TRAINING_FOLDER = Path('runs/training')


def main(arguments: list[str] | None = None) -> None:
    """Run one command; a bad input ends with one line and exit code 2, Ctrl-C with 130."""
    options = _parser().parse_args(arguments)
    try:
        options.command(options)
    except (ValueError, OSError) as error:
        print(f'error: {error}', file=sys.stderr)
        sys.exit(2)
    except (KeyboardInterrupt, SystemError) as error:
        # Ctrl-C within a compiled function arrives as the cause of a SystemError.
        if KeyboardInterrupt not in (type(error), type(error.__cause__)):
            raise
        print('stopped', file=sys.stderr)
        sys.exit(130)


def simulate(options: argparse.Namespace) -> None:
    """Simulate the paper's conditions for a network and keep the thinned data."""
    from dpc_ros.data import make_dataset, save_dataset
    from dpc_ros.network import load_network

    network = load_network(options.network)
    path = Path(options.output or DATA_FOLDER / f'{network.name}.npz')
    dataset = make_dataset(
        network,
        thinning_distance=options.thinning_distance,
        method=options.integrator,
        progress=True,
    )
    save_dataset(dataset, path)
    print(f'network     {network.identifier}')
    for split in ('train', 'validation', 'test'):
        simulations = set(getattr(dataset, f'{split}_simulation').tolist())
        count = len(getattr(dataset, split))
        print(f'{split:<12}{count} configurations of {len(simulations)} simulations')
    print(f'data        {path}')


def train(options: argparse.Namespace) -> None:
    """Train an autoencoder by a recipe and write its checkpoint."""
    from dpc_ros.autoencoder.experiment import state_path, train_checkpoint
    from dpc_ros.autoencoder.recipe import load_recipe

    recipe = load_recipe(options.config)
    folder = Path(options.output)
    try:
        path = train_checkpoint(
            recipe,
            data=options.data and Path(options.data),
            folder=folder,
            data_folder=DATA_FOLDER,
            progress=True,
        )
    except KeyboardInterrupt:
        state = state_path(recipe, folder)
        if state.exists():
            print(f'state       {state}: the same command takes the training up again')
        raise
    print(f'checkpoint  {path}')


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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='dpc', description='Offline commands of dpc_ros.')
    parser.add_argument('--version', action='version', version=__version__)
    commands = parser.add_subparsers(required=True, metavar='COMMAND')

    command = commands.add_parser('simulate', help=simulate.__doc__, description=simulate.__doc__)
    command.set_defaults(command=simulate)
    command.add_argument('network', help='shipped network by name, or path of its JSON file')
    command.add_argument('--output', help=f'file to write; default {DATA_FOLDER}/<network>.npz')
    command.add_argument('--integrator', default='rk4', help='rk4 (default) or symplectic_euler')
    command.add_argument(
        '--thinning-distance', type=float, default=0.1, metavar='M', help='ε [m], default 0.1'
    )

    command = commands.add_parser('train', help=train.__doc__, description=train.__doc__)
    command.set_defaults(command=train)
    command.add_argument('--config', required=True, help='shipped recipe by name, or a YAML file')
    command.add_argument('--data', help='file of `dpc simulate`; made where it is missing')
    command.add_argument(
        '--output', default=str(TRAINING_FOLDER), help=f'folder, default {TRAINING_FOLDER}'
    )

    command = commands.add_parser('converge', help=converge.__doc__, description=converge.__doc__)
    command.set_defaults(command=converge)
    command.add_argument('bag', help='folder or MCAP file of the log')
    command.add_argument('--network', help='of the body, where it is not a shipped one')
    command.add_argument('--checkpoint', help='of the encoder, where it is not a shipped one')
    command.add_argument('--namespace', help='of the topics, where the log has several')
    command.add_argument('--results', help='JSON to write the table to, as in docs/results')
    command.add_argument('--figure', help='PNG to write; default convergence.png in the bag')
    return parser


if __name__ == '__main__':
    main()
