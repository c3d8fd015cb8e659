"""Regulation to random targets by every law, beside what a constant force can do (section IV)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from dpc_ros.control import LAWS, Imperfections, LawSettings, ObserverSettings
from dpc_ros.figure import new_figure, save_figure, tidy
from dpc_ros.network import Gravity, load_network
from dpc_ros.paper.control_rows import Rows, columns, each_run, quartiles, summary
from dpc_ros.paper.control_tuning import (
    DURATION,
    REGULATOR,
    best_gains,
    best_regulator,
    tune,
    tune_regulator,
)
from dpc_ros.paper.models import Workshop
from dpc_ros.paper.regulation import (
    LIMIT,
    SEED,
    STEP,
    SYSTEM,
    Each,
    Task,
    bound,
    check_made,
    each_task,
    load_tasks,
    regulate,
)
from dpc_ros.parameters import read_options
from dpc_ros.results import read_results

__all__ = ['SEED', 'draw', 'measure']

_FAST = 0.001  # s, the shortest control step
_LONG = 10.0  # s, of a run to a reachable target
_GRAVITY = Gravity(9.81)
_MANY_STARTS = 20  # of the regulator's search, as of the static bound's
_INTEGRAL = 0.5  # 1/s

# Law, checkpoint. The paper's own recipe is the flat autoencoder at m = 2.
_LAWS: tuple[tuple[str, str], ...] = (
    ('paper', 'paper_2_flat_m2'),
    *((law, f'paper_2_extended_m{m}') for law in ('paper', 'transpose') for m in (2, 3, 5)),
    *(
        (law, f'paper_2_extended_m{m}')
        for law in ('reduced_equilibrium', REGULATOR)
        for m in (2, 3, 5)
    ),
)
_BEST = (REGULATOR, 'paper_2_extended_m5')


def tune_gains(workshop: Workshop) -> Rows:
    """Return the errors of every set of gains of every law, on other targets than the reported."""
    with each_task(workshop.progress) as each:
        return tune(each, _LAWS) + tune_regulator(each, _BEST[1])


def measure(workshop: Workshop) -> dict[str, Rows]:
    """Return the rows of three files: the experiments, each run, the error over time.

    `control` has one row for every experiment, law, autoencoder and condition; `control_runs` one
    for every run of the paper's experiment; `control_time` the median and quartiles of nMSE over
    the 50 runs, for every law. Gains are those that `tune_gains` has found. Where the workshop
    names one law, its rows of the paper's experiment join what the files hold.

    Raises:
        FileNotFoundError: it has not run yet.
        ValueError: there is no such law, or it can't be made.
    """
    if workshop.law:
        return measure_law(workshop, load_tasks('paper_targets'))
    tuning = read_results(workshop.results / 'control_tuning.json')
    best, gains = best_regulator(tuning), best_gains(tuning)
    variants = [(*law, gains.get(law, best)) for law in _LAWS]
    variants.append((*_BEST, replace(best, equilibrium_starts=_MANY_STARTS)))
    with each_task(workshop.progress) as each:
        tasks = load_tasks('paper_targets')
        bounds = each('static bounds', bound, tasks)
        control: Rows = []
        runs: Rows = []
        time: Rows = []
        for variant in variants:
            for rows, more in zip(
                (control, runs, time), _paper_targets(each, *variant, tasks, bounds), strict=True
            ):
                rows += more
        control += _with_gravity(each, best, tasks)
        control += _reachable(each, best)
        control += _imperfect(each, best, tasks, bounds)
        control += _other_bodies(each, best, tasks, bounds)
    return {
        'control': control,
        'control_runs': runs,
        'control_time': time,
    }


def measure_law(workshop: Workshop, tasks: Sequence[Task]) -> dict[str, Rows]:
    """Return the rows of three files with those of the workshop's law, on our best autoencoder.

    Static bounds are those that the files hold, where they do.

    Raises:
        ValueError: there is no such law, it is one of this package, or it can't be made.
    """
    if workshop.law in LAWS:
        raise ValueError(
            f'law {workshop.law!r}: expected one of another package; those of this one are all run '
            'where none is named'
        )
    checkpoint = _BEST[1]
    settings = replace(LIMIT, options=read_options(workshop.law_options, '--law-options'))
    check_made(workshop.law, checkpoint, tasks[0], settings)
    files: dict[str, Rows] = {}
    for name in ('control', 'control_runs', 'control_time'):
        path = workshop.results / f'{name}.json'
        rows = read_results(path) if path.is_file() else []
        files[name] = [row for row in rows if row['law'] != workshop.law]
    known = {row['run']: row['static_bound'] for row in files['control_runs']}
    with each_task(workshop.progress) as each:
        missing = [task for task in tasks if task.run not in known]
        found = each('static bounds', bound, missing)
        known |= {task.run: value for task, value in zip(missing, found, strict=True)}
        bounds = [known[task.run] for task in tasks]
        added = _paper_targets(each, workshop.law, checkpoint, settings, tasks, bounds)
    for name, more in zip(files, added, strict=True):
        files[name] += more
    return files


def _paper_targets(
    each: Each,
    law: str,
    checkpoint: str,
    settings: LawSettings,
    tasks: Sequence[Task],
    bounds: Sequence[float],
) -> tuple[Rows, Rows, Rows]:
    """Return the rows of one law: of all runs, of each run, of the error over time."""
    found = each(
        f'{law}, {checkpoint}', partial(regulate, law, checkpoint, settings, DURATION), tasks
    )
    what = {'experiment': 'paper_targets', **columns(law, checkpoint, settings)}
    return (
        [{**what, **summary(found, bounds)}],
        [{**what, **row} for row in each_run(tasks, found, bounds)],
        [{**what, **row} for row in quartiles(found, bounds)],
    )


def draw(workshop: Workshop, rows: dict[str, Rows], docs: Path) -> list[Path]:
    """Draw nMSE over time by law: medians and quartiles, and the median static bound."""
    path = docs / 'control.png'
    draw_time(rows['control_time'], path)
    return [path]


def draw_time(rows: Rows, path: Path) -> None:
    """Draw nMSE over time, a panel each autoencoder and a curve each law."""
    checkpoints = list(dict.fromkeys(row['checkpoint'].partition('@')[0] for row in rows))
    figure = new_figure(3.4 * len(checkpoints), 4.2)
    panels = figure.subplots(1, len(checkpoints), sharey=True, squeeze=False)[0]
    colours = {
        'paper': '#0072b2',
        'transpose': '#009e73',
        'reduced_equilibrium': '#e69f00',
        'lqr': '#d55e00',
    }
    rows = [row for row in rows if row.get('equilibrium_starts', 2) == 2]
    for panel, checkpoint in zip(panels, checkpoints, strict=True):
        mine = [row for row in rows if row['checkpoint'].startswith(f'{checkpoint}@')]
        for law in dict.fromkeys(row['law'] for row in mine):
            colour = colours.get(law, '#56b4e9')
            curve = [row for row in mine if row['law'] == law]
            time = [row['time_s'] for row in curve]
            low, median, high = ([row[f'nmse_{q}'] for row in curve] for q in (25, 50, 75))
            panel.fill_between(time, low, high, color=colour, alpha=0.18, lw=0)
            panel.semilogy(time, median, color=colour, lw=1.5, label=law)
        bound = mine[0]['static_bound_median']
        panel.axhline(bound, color='#222222', ls='--', lw=1, label='static bound, median')
        panel.set(title=checkpoint.removeprefix('paper_2_'), xlabel='time [s]', ylim=(1e-3, 30))
        tidy(panel)
    panels[0].set_ylabel('nMSE')
    handles, labels = panels[-1].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=5, frameon=False)
    save_figure(figure, path)


def _with_gravity(each: Each, settings: LawSettings, tasks: Sequence[Task]) -> Rows:
    """Return the row of the best law where gravity pulls, known to the law."""
    bounds = each('static bounds under gravity', partial(bound, gravity=_GRAVITY), tasks)
    function = partial(regulate, *_BEST, settings, DURATION, gravity=_GRAVITY)
    found = each('under gravity', function, tasks)
    what = {'experiment': 'gravity', **columns(*_BEST, settings)}
    return [{**what, 'gravity_m_s2': _GRAVITY.magnitude, **summary(found, bounds)}]


def _reachable(each: Each, best: LawSettings) -> Rows:
    """Return rows of targets that a constant force holds, without and with integral action."""
    tasks, rows = load_tasks('reachable_targets'), []
    for gain in (0.0, _INTEGRAL):
        settings = replace(best, integral_gain=gain)
        function = partial(regulate, *_BEST, settings, _LONG)
        found = each(f'reachable targets, integral {gain}', function, tasks)
        row = summary(found, [1.0] * len(tasks))
        row = {key: value for key, value in row.items() if 'bound' not in key}
        ten = float(np.median([outcome.final for outcome in found]))
        what = {'experiment': 'reachable', **columns(*_BEST, settings)}
        rows.append({**what, **row, 'nmse_10s_median': ten})
    return rows


def _imperfect(
    each: Each, settings: LawSettings, tasks: Sequence[Task], bounds: Sequence[float]
) -> Rows:
    """Return rows of the best law under hold, latency and noise, and with a filter."""
    rows = []
    what = {'experiment': 'robustness', **columns(*_BEST, settings)}
    run = partial(regulate, *_BEST, settings, DURATION)
    conditions = [Imperfections(hold=hold) for hold in (2, 4, 8)]
    conditions += [Imperfections(latency=latency) for latency in (1, 2, 4)]
    conditions += [Imperfections(noise=noise) for noise in (0.01, 0.03, 0.1)]
    hard = [
        Imperfections(hold=4, latency=4, noise=noise, velocity_noise=velocity_noise)
        for noise, velocity_noise in ((0.1, 0.0), (0.5, 0.0), (0.5, 5.0))
    ]
    cases: list[tuple[Imperfections, ObserverSettings | None]]
    cases = [(loop, None) for loop in conditions + hard]
    cases += [(loop, _filter(loop)) for loop in hard]
    fast = each('1 ms', partial(run, step=_FAST), tasks)
    rows.append({**what, 'hold_s': _FAST, 'observer': 'none', **summary(fast, bounds)})
    for loop, observer in cases:
        found = each(f'{loop}', partial(run, imperfections=loop, observer=observer), tasks)
        row = {
            'hold_s': loop.hold * STEP,
            'latency_s': loop.latency * STEP,
            'sigma_m': loop.noise,
            'sigma_velocity_m_s': loop.velocity_noise,
            'observer': 'kalman' if observer else 'none',
        }
        rows.append({**what, **row, **summary(found, bounds)})
    return rows


def _filter(loop: Imperfections) -> ObserverSettings:
    """Return the settings of a filter that is told the noise and the latency."""
    noises = {'position_noise': loop.noise}
    if loop.velocity_noise:
        noises['velocity_noise'] = loop.velocity_noise
    return ObserverSettings(**noises, delay=loop.latency * STEP)


def _other_bodies(
    each: Each, best: LawSettings, tasks: Sequence[Task], bounds: Sequence[float]
) -> Rows:
    """Return rows of the best law on bodies that are not as its model says."""
    rows = []
    network = load_network(SYSTEM)
    for name in ('stiffness', 'damping', 'mass'):
        for factor in (0.8, 1.2):
            truth = replace(network, **{name: factor * getattr(network, name)})
            there, gains = bounds, [0.0]
            if name == 'stiffness':  # the others move no equilibrium
                label = f'static bounds, {name} × {factor}'
                there, gains = each(label, partial(bound, truth=truth), tasks), [0.0, _INTEGRAL]
            for gain in gains:
                settings = replace(best, integral_gain=gain)
                function = partial(regulate, *_BEST, settings, DURATION, truth=truth)
                found = each(f'{name} × {factor}, integral {gain}', function, tasks)
                what = {'experiment': 'robustness', **columns(*_BEST, settings)}
                rows.append({**what, f'{name}_factor': factor, **summary(found, there)})
    return rows
