"""`dpc`: the offline commands. Each imports what it needs when it is called."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

from dpc_ros import __version__, bag_commands

DATA_FOLDER = Path('runs/data')
TRAINING_FOLDER = Path('runs/training')
PAPER_EXPERIMENTS = (
    'systems',
    'mse-table',
    'compression',
    'noise',
    'interpretability',
    'pointwise',
    'reduced',
    'control-tuning',
    'control',
    'tables',
)
NETWORK_FOLDER = Path('runs/networks')
REDUCED_FOLDER = Path('runs/reduced')
LARGEST_DOMAIN = 232  # of DDS, by the ports that its domains have


def number(text: str) -> float:
    """Return a finite number that may be written as a fraction, 1/205.

    Raises:
        ArgumentTypeError: the text is no such number.
    """
    above, _, below = text.partition('/')
    try:
        value = float(above) / float(below or 1)
    except (ValueError, ZeroDivisionError, OverflowError):
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f'expected a number or a fraction, got {text!r}')
    return value


# Fields of GeneratorSettings that `dpc generate` sets: type, default, what they are.
GENERATOR_OPTIONS: dict[str, tuple[Callable[[str], float], str, str]] = {
    'squares': (int, '7', 'square pieces'),
    'triangles': (int, '6', 'triangular pieces'),
    'width': (int, '5', 'masses along a side of a piece'),
    'lateral_probability': (number, '0.3', 'that a lateral begins at a free side'),
    'lateral_decay': (number, '0.6', 'factor on it with each piece of the lateral'),
    'spacing': (number, '0.3', 'distance of neighbouring masses [m]'),
    'mass': (number, '1/205', 'of each point [kg]'),
    'stiffness': (number, '50', 'of edges [N/m]'),
    'diagonal_stiffness': (number, '100', 'of diagonals of squares [N/m]'),
    'damping_coefficient': (number, '0.1', 'of every spring [N·s/m]'),
    'background_stiffness': (number, '0.2', 'k_s [N/m]'),
    'background_rest_fraction': (number, '1/205', 'c'),
}


def main(arguments: list[str] | None = None) -> None:
    """Run one command; a bad input ends with one line and exit code 2, Ctrl-C with 130.

    A command that finds something to complain of returns an exit code of its own. A reader of the
    output that has seen enough, as `head`, is no error.
    """
    options = _parser().parse_args(arguments)
    try:
        status = options.command(options)
        sys.stdout.flush()
    except BrokenPipeError:
        # What is still in the buffer is flushed once more at the exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return
    except (ValueError, OSError) as error:
        print(f'error: {error}', file=sys.stderr)
        sys.exit(2)
    except (KeyboardInterrupt, SystemError) as error:
        # Ctrl-C within a compiled function arrives as the cause of a SystemError.
        if KeyboardInterrupt not in (type(error), type(error.__cause__)):
            raise
        print('stopped', file=sys.stderr)
        sys.exit(130)
    if status:
        sys.exit(status)


def generate(options: argparse.Namespace) -> None:
    """Make a random network like the paper's and write it as JSON."""
    from dpc_ros.network import GeneratorSettings, generate_network, save_network

    chosen = {key: getattr(options, key) for key in GENERATOR_OPTIONS if hasattr(options, key)}
    settings = GeneratorSettings(damping_kind=options.damping, **chosen)
    network = generate_network(options.name, options.seed, settings, progress=True)
    path = Path(options.output or NETWORK_FOLDER / f'{network.name}.json')
    save_network(network, path)
    print(f'network     {network.identifier}')
    print(f'masses      {len(network.mobile)} mobile, {len(network.fixed)} fixed')
    print(f'springs     {len(network.springs)}')
    print(f'file        {path}')


def draw(options: argparse.Namespace) -> None:
    """Draw a network at rest: springs, masses and some of their numbers, to scale."""
    from dpc_ros.network import draw_figure, load_network

    network = load_network(options.network)
    path = Path(options.output or NETWORK_FOLDER / f'{network.name}.png')
    draw_figure(network, path)
    print(f'figure      {path}')


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
            # Before what stands in standard error, whatever the buffers.
            print(f'state       {state}: the same command takes the training up again', flush=True)
        raise
    print(f'checkpoint  {path}')


def select(options: argparse.Namespace) -> None:
    """Train a recipe under every combination of a grid and show which validates best."""
    from dpc_ros.autoencoder.recipe import load_recipe

    try:
        from dpc_ros.autoencoder.selection import PAPER_GRIDS, grid_recipes, load_grid
        from dpc_ros.autoencoder.selection import select as run
    except ModuleNotFoundError as error:
        raise ValueError(
            f'model selection needs {error.name}, which is not installed: '
            "pip install 'dpc_ros[selection]'"
        ) from error
    from dpc_ros.results import write_results

    recipe = load_recipe(options.config)
    grid = load_grid(options.grid) if options.grid else PAPER_GRIDS.get(recipe.kind)
    if grid is None:
        raise ValueError(f'the paper has no grid for kind {recipe.kind!r}: name one by --grid')
    folder = Path(options.output) / f'{recipe.name}_grid'
    try:
        rows = run(
            grid_recipes(recipe, grid),
            folder,
            DATA_FOLDER,
            address=options.address,
            parallel=options.parallel,
            early_stopping=options.early_stopping,
            progress=True,
        )
    except KeyboardInterrupt:
        print(f'state       {folder}: the same command takes the search up again', flush=True)
        raise
    keys = [*grid, 'epochs', 'train_mse', 'validation_mse']
    print('  '.join(f'{key:>14}' for key in keys))
    for row in rows:
        print('  '.join(_cell(row[key]) for key in keys))
    print(f'best        {folder / rows[0]["name"]}.json')
    if options.results:
        columns = ('name', 'latent_size', *keys)
        chosen = [{key: row[key] for key in columns} for row in rows]
        write_results(options.results, chosen, seed=recipe.seed)
        print(f'results     {options.results}')


def reduce(options: argparse.Namespace) -> None:
    """Simulate a motion in latent coordinates beside the body's own and show the errors."""
    from dpc_ros.autoencoder import load_checkpoint, with_encoder
    from dpc_ros.data import simulate_condition
    from dpc_ros.network import Mechanics, load_network
    from dpc_ros.reduction import CompressedSystem
    from dpc_ros.reduction.comparison import compare
    from dpc_ros.reduction.figure import animate, draw_energies, draw_errors, draw_frames
    from dpc_ros.reduction.report import course, summary, table
    from dpc_ros.results import write_results

    network = load_network(options.network)
    checkpoint = load_checkpoint(options.checkpoint)
    checkpoint.check_network(network)
    autoencoder = with_encoder(checkpoint.autoencoder(), options.encoder)
    condition, trajectory = simulate_condition(network, options.simulation)
    gravity = condition.gravity
    system = CompressedSystem(Mechanics(network, gravity), autoencoder, int(network.mobile[0]))
    comparison = compare(system, trajectory, options.step, options.method, progress=True)
    folder = Path(options.output or REDUCED_FOLDER / f'{checkpoint.name}_{condition.simulation}')
    print(f'network     {network.identifier}')
    print(f'checkpoint  {checkpoint.identifier}, m = {system.latent_size}, {options.encoder}')
    print(
        f'simulation  {condition.simulation} ({condition.split}), gravity '
        f'{gravity.magnitude:.3g} m/s² at {math.degrees(gravity.angle):.0f}°\n'
    )
    print(f'{table(comparison)}\n')
    named = {checkpoint.name: comparison}
    times = [fraction * comparison.time[-1] for fraction in (0.0, 0.1, 0.2, 0.4, 0.6, 1.0)]
    draw_errors(comparison, folder / 'errors.png')
    draw_energies(named, folder / 'energies.png')
    draw_frames(named, times, folder / 'frames.png')
    for name in ('errors', 'energies', 'frames'):
        print(f'figure      {folder / name}.png')
    if options.animation:
        animate(named, folder / 'motion.gif', progress=True)
        print(f'animation   {folder / "motion.gif"}')
    if options.results:
        write_results(options.results, [*course(comparison), summary(comparison)])
        print(f'results     {options.results}')


def reach(options: argparse.Namespace) -> None:
    """Find what a constant force on one mass can hold: the equilibrium nearest to a target."""
    from dpc_ros.control import load_target, static_bound
    from dpc_ros.network import Gravity, Mechanics, draw_springs, load_network

    network = load_network(options.network)
    target = load_target(options.target, network)
    if target.configuration is None:
        raise ValueError(f'target {options.target}: expected a configuration, not a latent state')
    gravity = Gravity(options.gravity, math.radians(options.gravity_angle))
    bound = static_bound(
        Mechanics(network, gravity),
        options.mass,
        target.configuration,
        options.largest_force,
        options.starts,
        options.seed,
        progress=True,
    )
    print(f'network     {network.identifier}')
    print(f'target      {options.target}, force on mass {options.mass}')
    print(f'best force  ({bound.force[0]:.4g}, {bound.force[1]:.4g}) N')
    print(f'static nMSE {bound.nmse:.4g}  (no constant force was found to hold the body nearer)')
    print(f'distance    {bound.rms:.4g} m, root mean square over the coordinates')
    if options.figure:
        from dpc_ros.figure import new_figure, save_figure, tidy

        figure = new_figure(7, 7)
        panel = figure.subplots()
        draw_springs(network, panel, target.configuration, color='#e69f00', lw=1.6, label='target')
        style = {'color': '#0072b2', 'lw': 0.7, 'label': 'nearest equilibrium'}
        draw_springs(network, panel, bound.configuration, **style)
        panel.autoscale_view()
        panel.set(aspect='equal', xlabel='x [m]', ylabel='y [m]')
        panel.legend(frameon=False)
        tidy(panel)
        save_figure(figure, options.figure)
        print(f'figure      {options.figure}')


def paper(options: argparse.Namespace) -> None:
    """Run one of the paper's experiments: results as JSON, figures, or the tables of the docs."""
    from dpc_ros.paper.commands import run
    from dpc_ros.paper.models import Workshop

    docs = Path(options.docs)
    workshop = Workshop(
        Path(options.data),
        Path(options.training),
        docs / 'results',
        law=options.law or '',
        law_options=options.law_options,
    )
    run(options.experiment, workshop, docs)


def top(options: argparse.Namespace) -> int:
    """Show all running nodes, once a second: rates, delays, losses, and who has gone silent."""
    if find_spec('rclpy') is None:
        raise ValueError("dpc top needs ROS 2: pip install 'dpc_ros[ros]', or source yours")
    if options.domain is not None and not 0 <= options.domain <= LARGEST_DOMAIN:
        raise ValueError(f'--domain: expected 0 to {LARGEST_DOMAIN}, got {options.domain}')
    from dpc_ros.nodes.top import show

    return show(options.namespace, options.domain, options.once, options.timeout)


def view(options: argparse.Namespace) -> None:
    """Show a log in a browser: the body, its plots, and its time in hand; no ROS needed."""
    from dpc_ros.bag.report import converge
    from dpc_ros.view import LogPage, RecordedFrames, address, open_server

    convergence, notes = converge(
        options.bag, options.network, options.checkpoint, options.namespace
    )
    frames = RecordedFrames(convergence)
    server = open_server(options.host, options.port, str(options.bag), frames.mechanics.network)
    page = LogPage(server, frames)
    for note in notes:
        print(note)
    print(f'page        {address(server)}')
    try:
        page.run(lambda: False)
    finally:
        page.close()


def _cell(value: object) -> str:
    return (
        f'{value:>14.6g}'
        if isinstance(value, float)
        else f'{value if value is not None else "–":>14}'
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='dpc', description='Offline commands of dpc_ros.')
    parser.add_argument('--version', action='version', version=__version__)
    commands = parser.add_subparsers(required=True, metavar='COMMAND')

    command = commands.add_parser('generate', help=generate.__doc__, description=generate.__doc__)
    command.set_defaults(command=generate)
    command.add_argument('name', help='of the network, one word')
    command.add_argument('--output', help=f'JSON to write; default {NETWORK_FOLDER}/<name>.json')
    command.add_argument('--seed', type=int, default=0, help='of the random numbers, default 0')
    command.add_argument('--damping', default='isotropic', help='isotropic (default) or axial')
    for key, (kind, default, meaning) in GENERATOR_OPTIONS.items():
        command.add_argument(
            f'--{key.replace("_", "-")}',
            type=kind,
            default=argparse.SUPPRESS,
            metavar='N' if kind is int else 'X',
            help=f'{meaning}, default {default}',
        )

    command = commands.add_parser('draw', help=draw.__doc__, description=draw.__doc__)
    command.set_defaults(command=draw)
    command.add_argument('network', help='shipped network by name, or path of its JSON file')
    command.add_argument('--output', help=f'PNG to write; default {NETWORK_FOLDER}/<name>.png')

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

    command = commands.add_parser('select', help=select.__doc__, description=select.__doc__)
    command.set_defaults(command=select)
    command.add_argument('--config', required=True, help='shipped recipe by name, or a YAML file')
    command.add_argument('--grid', help="YAML of fields and their values; default the paper's grid")
    command.add_argument('--address', help='of a Ray cluster; default this machine')
    command.add_argument('--parallel', type=int, help='trainings at a time; default one a core')
    command.add_argument(
        '--early-stopping', action='store_true', help='end trainings early that are behind'
    )
    command.add_argument(
        '--output', default=str(TRAINING_FOLDER), help=f'folder, default {TRAINING_FOLDER}'
    )
    command.add_argument('--results', help='JSON to write the table to, as in docs/results')

    command = commands.add_parser('reduce', help=reduce.__doc__, description=reduce.__doc__)
    command.set_defaults(command=reduce)
    command.add_argument('network', help='shipped network by name, or path of its JSON file')
    command.add_argument('--checkpoint', required=True, help='shipped one by name, or a JSON file')
    command.add_argument(
        '--encoder', default='projection', help='of the start: projection (default) or network'
    )
    command.add_argument(
        '--simulation', type=int, default=14, help="number of the paper's condition, default 14"
    )
    command.add_argument(
        '--step', type=number, default=0.02, metavar='S', help='of the simulation [s], default 0.02'
    )
    command.add_argument('--method', default='rk4', help='rk4 (default) or implicit_midpoint')
    command.add_argument('--animation', action='store_true', help='write a GIF of the motion, too')
    command.add_argument(
        '--output', help=f'folder, default {REDUCED_FOLDER}/<checkpoint>_<simulation>'
    )
    command.add_argument('--results', help='JSON to write the numbers to, as in docs/results')

    command = commands.add_parser('reach', help=reach.__doc__, description=reach.__doc__)
    command.set_defaults(command=reach)
    command.add_argument('network', help='shipped network by name, or path of its JSON file')
    command.add_argument(
        '--target', required=True, help='simulation:<number>@<step>, rest, or a JSON file'
    )
    command.add_argument('--mass', type=int, default=162, help='that is actuated, default 162')
    command.add_argument(
        '--largest-force', type=number, default=20.0, metavar='N', help='bound on |u|, default 20'
    )
    command.add_argument(
        '--gravity', type=number, default=0.0, metavar='G', help='[m/s²], default 0'
    )
    command.add_argument(
        '--gravity-angle', type=number, default=-90.0, metavar='A', help='[°], default -90, down'
    )
    command.add_argument('--starts', type=int, default=20, help='of the search, default 20')
    command.add_argument('--seed', type=int, default=0, help='of the starts, default 0')
    command.add_argument('--figure', help='PNG of target and equilibrium to write')

    command = commands.add_parser('paper', help=paper.__doc__, description=paper.__doc__)
    command.set_defaults(command=paper)
    command.add_argument('experiment', help=', '.join(PAPER_EXPERIMENTS))
    command.add_argument('--data', default=str(DATA_FOLDER), help=f'default {DATA_FOLDER}')
    command.add_argument(
        '--training', default=str(TRAINING_FOLDER), help=f'checkpoints; default {TRAINING_FOLDER}'
    )
    command.add_argument(
        '--docs', default='docs', help='where results and figures go, default docs'
    )
    command.add_argument('--law', help='of `control`: only this law, yours for example')
    command.add_argument('--law-options', default='', help='what a law of yours takes, as YAML')

    command = commands.add_parser('view', help=view.__doc__, description=view.__doc__)
    command.set_defaults(command=view)
    command.add_argument('bag', help='folder or MCAP file of the log')
    command.add_argument('--network', help='of the body, where it is not a shipped one')
    command.add_argument('--checkpoint', help='of the encoder, where it is not a shipped one')
    command.add_argument('--namespace', help='of the topics, where the log has several')
    command.add_argument(
        '--host', default='127.0.0.1', help='interface to listen on; default this machine alone'
    )
    command.add_argument(
        '--port', type=int, default=8080, help='to listen on, or the next that is free'
    )

    command = commands.add_parser('top', help=top.__doc__, description=top.__doc__)
    command.set_defaults(command=top)
    command.add_argument('--namespace', default='/', help='of the nodes to show, default all')
    command.add_argument('--domain', type=int, metavar='N', help='of DDS; default ROS_DOMAIN_ID')
    command.add_argument('--once', action='store_true', help='print one table and end')
    command.add_argument(
        '--timeout',
        type=number,
        default=10.0,
        metavar='S',
        help='with --once: give up if no node reports within it [s], default 10',
    )

    group = commands.add_parser('bag', help=bag_commands.__doc__, description=bag_commands.__doc__)
    bag_commands.add_to(group)
    return parser


if __name__ == '__main__':
    main()
