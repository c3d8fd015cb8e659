"""Regulation to random targets by every law, beside what a constant force can do (section IV)."""

from __future__ import annotations

import csv
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from dpc_ros.autoencoder import Autoencoder, load_checkpoint
from dpc_ros.control import (
    ClosedLoopRun,
    ConstantForce,
    EquilibriumError,
    Imperfections,
    LawSettings,
    ObservedLaw,
    ObserverSettings,
    Target,
    load_target,
    make_law,
    run_closed_loop,
    static_bound,
)
from dpc_ros.figure import new_figure, save_figure, tidy
from dpc_ros.network import Body, Gravity, Integrator, MassSpringNetwork, Mechanics, load_network
from dpc_ros.network.mechanics import NO_GRAVITY
from dpc_ros.paper.models import Workshop
from dpc_ros.reduction import CompressedSystem
from dpc_ros.resources import config_path
from dpc_ros.threads import single_threaded_algebra

SEED = 0
STEP = 0.005  # s
_FAST = 0.001  # s, the shortest control step
DURATION = 5.0  # s, of a run
_LONG = 10.0  # s, of a run to a reachable target
_FINAL = 0.25  # s at the end, whose mean error is the final one
_LARGEST_FORCE = 20.0  # N
_SYSTEM = 'paper_2'
_STARTS = 20  # of the search for a static bound
_GRAVITY = Gravity(9.81)
_CONTINUATION = 16  # forces on the way to a reachable target
_OFTEN = 0.1  # part of the forces, from which shortening them is named as a reason
_ILL_CONDITIONED = 10.0
_AT_REST = 0.05  # m/s, root mean square over coordinates
_SETTLED = 1.2  # times its final value, within which an error has settled

# Law, checkpoint. The paper's own recipe is the flat autoencoder at m = 2.
_LAWS: tuple[tuple[str, str], ...] = (
    ('paper', 'paper_2_flat_m2'),
    *((law, f'paper_2_extended_m{m}') for law in ('paper', 'transpose') for m in (2, 3, 5)),
    *((law, f'paper_2_extended_m{m}') for law in ('reduced_equilibrium', 'lqr') for m in (2, 3, 5)),
)
_BEST = ('lqr', 'paper_2_extended_m5')
# Gains that are tried on other targets; the best by the median final error is taken.
_PROPORTIONAL, _DERIVATIVE = (0.5, 2.0, 8.0), (0.2, 1.0, 5.0)
_TUNED = ('paper', 'transpose', 'reduced_equilibrium')
_TUNING_RUNS = 10

Rows = list[dict[str, Any]]


@dataclass(frozen=True, eq=False)
class Task:
    """One regulation run: from rest to a target by the force on one mass.

    Attributes:
        run: its number.
        mass: number of the actuated mass.
        target: q̄ [m].
    """

    run: int
    mass: int
    target: Float[np.ndarray, ' n']


def measure(workshop: Workshop) -> dict[str, Rows]:
    """Return the rows of three files: every law and experiment, each run, the error over time.

    `control` has one row for every experiment, law, autoencoder and condition; `control_runs` one
    for every run of the paper's experiment; `control_time` the median and quartiles of nMSE over
    the 50 runs, for every law. Gains of the proportional-derivative laws are chosen on other
    targets first (`control_tuning`); those of `lqr` are its defaults.
    """
    with _workers() as pool:
        each = partial(_in_turn, pool, workshop.progress)
        tuning = _tune(each)
        gains = _best_gains(tuning)
        tasks = load_tasks('paper_targets')
        bounds = _bounds(each, 'static bounds', tasks)
        control, runs, time = [], [], []
        for law, checkpoint in _LAWS:
            settings = gains.get((law, checkpoint), _settings())
            found = each(
                f'{law}, {checkpoint}', partial(_run, law, checkpoint, settings, DURATION), tasks
            )
            columns = {'experiment': 'paper_targets', **_columns(law, checkpoint, settings)}
            control.append({**columns, **summary(found, bounds)})
            runs += [{**columns, **row} for row in _each_run(tasks, found, bounds)]
            time += [{**columns, **row} for row in _quartiles(found, bounds)]
        control += _with_gravity(each, tasks)
        control += _reachable(each)
        control += _robustness(each, tasks, bounds)
    return {
        'control': control,
        'control_runs': runs,
        'control_time': time,
        'control_tuning': tuning,
    }


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of a run.

    Attributes:
        nmse: MSE(q(t), q̄)/MSE(q(0), q̄) at every step; infinite after the body has diverged.
        peak_force, rms_force: of the applied force [N].
        saturated: part of the steps whose force the bound shortened.
        reason: what was seen of a run that failed, or why there was none; else empty.
        step: control step [s].
    """

    nmse: Float[np.ndarray, ' steps']
    peak_force: float = 0.0
    rms_force: float = 0.0
    saturated: float = 0.0
    reason: str = ''
    step: float = STEP

    @property
    def final(self) -> float:
        """Mean over the last quarter of a second."""
        return float(self.nmse[-round(_FINAL / self.step) :].mean())

    @property
    def failed(self) -> bool:
        """Whether the body ended farther from the target than it began."""
        return not self.final <= 1.0

    def at(self, time: float) -> float:
        """Return nMSE at a time [s]."""
        return float(self.nmse[round(time / self.step)])

    @property
    def settling_time(self) -> float:
        """Time [s] after which nMSE stays within 1.2 times its final value; never of a failure."""
        if self.failed:
            return np.inf
        outside = np.flatnonzero(self.nmse > _SETTLED * self.final)
        return self.step * (int(outside[-1]) + 1 if len(outside) else 0)


def summary(found: Sequence[Outcome], bounds: Sequence[float]) -> dict[str, Any]:
    """Return the columns of one experiment, beside the static bound of each run."""
    final = np.array([outcome.final for outcome in found])
    over = final / np.array(bounds)
    two = np.array([outcome.at(2.0) for outcome in found]) / np.array(bounds)
    return {
        'runs': len(found),
        'failed': sum(outcome.failed for outcome in found),
        'final_nmse_median': float(np.median(final)),
        'final_nmse_max': float(final.max()),
        'static_bound_median': float(np.median(bounds)),
        'final_over_bound_median': float(np.median(over)),
        'final_over_bound_90': float(np.quantile(over, 0.9, method='lower')),
        'nmse_2s_over_bound_median': float(np.median(two)),
        'nmse_2s_median': float(np.median([outcome.at(2.0) for outcome in found])),
        'nmse_3s_median': float(np.median([outcome.at(3.0) for outcome in found])),
        'nmse_5s_median': float(np.median([outcome.at(5.0) for outcome in found])),
        'settling_time_median_s': float(np.median([each.settling_time for each in found])),
        'peak_force_median_N': float(np.median([outcome.peak_force for outcome in found])),
        'rms_force_median_N': float(np.median([outcome.rms_force for outcome in found])),
    }


def load_tasks(name: str) -> list[Task]:
    """Return the runs of a file in config/control, without gravity."""
    network = load_network(_SYSTEM)
    with config_path('control', f'{name}.csv').open(newline='') as file:
        return [
            Task(
                int(row['run']),
                int(row['actuated_mass']),
                _target(network, int(row['actuated_mass']), row['target']),
            )
            for row in csv.DictReader(file)
        ]


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
    for panel, checkpoint in zip(panels, checkpoints, strict=True):
        mine = [row for row in rows if row['checkpoint'].startswith(f'{checkpoint}@')]
        for law in dict.fromkeys(row['law'] for row in mine):
            curve = [row for row in mine if row['law'] == law]
            time = [row['time_s'] for row in curve]
            low, median, high = ([row[f'nmse_{q}'] for row in curve] for q in (25, 50, 75))
            panel.fill_between(time, low, high, color=colours[law], alpha=0.18, lw=0)
            panel.semilogy(time, median, color=colours[law], lw=1.5, label=law)
        bound = mine[0]['static_bound_median']
        panel.axhline(bound, color='#222222', ls='--', lw=1, label='static bound, median')
        panel.set(title=checkpoint.removeprefix('paper_2_'), xlabel='time [s]', ylim=(1e-3, 30))
        tidy(panel)
    panels[0].set_ylabel('nMSE')
    handles, labels = panels[-1].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=5, frameon=False)
    save_figure(figure, path)


@contextmanager
def _workers() -> Iterator[ProcessPoolExecutor]:
    """Give as many processes as there are cores; on Ctrl-C what has not begun never will."""
    pool = ProcessPoolExecutor(mp_context=get_context('spawn'), initializer=_begin_worker)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _begin_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent's to answer
    single_threaded_algebra()


_Each = Callable[[str, Callable[[Task], Any], Sequence[Task]], list[Any]]


def _in_turn(
    pool: ProcessPoolExecutor,
    progress: bool,
    description: str,
    function: Callable[[Task], Any],
    tasks: Sequence[Task],
) -> list[Any]:
    results: Iterator[Any] = pool.map(function, tasks)
    return list(tqdm(results, desc=description, total=len(tasks), disable=not progress))


def _run(
    law_name: str,
    checkpoint: str,
    settings: LawSettings,
    duration: float,
    task: Task,
    gravity: Gravity = NO_GRAVITY,
    imperfections: Imperfections | None = None,
    truth: MassSpringNetwork | None = None,
    observer: ObserverSettings | None = None,
    step: float = STEP,
) -> Outcome:
    """Return what comes of one run; `truth` is the body where it is not the one of the model."""
    network, autoencoder = _models(checkpoint)
    law = make_law(
        law_name,
        CompressedSystem(Mechanics(network, gravity), autoencoder, task.mass),
        settings,
    )
    if observer is not None:
        law = ObservedLaw(law, observer)
    steps = round(duration / step)
    try:
        law.regulate(Target(configuration=task.target))
    except EquilibriumError as error:
        return Outcome(np.full(steps + 1, np.inf), reason=str(error), step=step)
    body = Body(
        Integrator(Mechanics(truth or network, gravity), step),
        task.mass,
        configuration=network.rest_configuration,
    )
    shortened: list[bool] = []
    with np.errstate(all='ignore'):
        run = run_closed_loop(
            body,
            autoencoder,
            law,
            steps,
            lambda step: shortened.append(law.saturated),
            imperfections,
        )
        errors = np.mean((run.configuration - task.target) ** 2, axis=1)
        nmse = np.nan_to_num(errors / errors[0], nan=np.inf)
    length = np.nan_to_num(np.linalg.norm(run.force, axis=1), nan=settings.largest_force)
    rms = float(np.sqrt(np.mean(length**2)))
    outcome = Outcome(nmse, float(length.max()), rms, float(np.mean(shortened)), step=step)
    if not outcome.failed:
        return outcome
    return replace(outcome, reason=_why(law.system, task, run, outcome))


def _why(system: CompressedSystem, task: Task, run: ClosedLoopRun, outcome: Outcome) -> str:
    """Return what is seen of a run that failed: force, input field, motion at the end."""
    if not np.isfinite(outcome.final):
        return 'the body diverged'
    seen = []
    if outcome.saturated > _OFTEN:
        seen.append(f'{outcome.saturated:.0%} of the forces shortened to the bound')
    field = system.input_field(system.autoencoder.encode(task.target))
    condition = float(np.linalg.cond(field))
    if condition > _ILL_CONDITIONED:
        seen.append(f'condition {condition:.0f} of Γ at the target')
    speed = float(np.sqrt(np.mean(run.velocity[-round(_FINAL / outcome.step) :] ** 2)))
    seen.append('moving at the end' if speed > _AT_REST else 'at rest elsewhere')
    return ', '.join(seen)


@lru_cache(maxsize=4)
def _models(checkpoint: str) -> tuple[MassSpringNetwork, Autoencoder]:
    return load_network(_SYSTEM), load_checkpoint(checkpoint).autoencoder()


def _bound(starts: int, gravity: Gravity, truth: MassSpringNetwork | None, task: Task) -> float:
    single_threaded_algebra()
    mechanics = Mechanics(truth or load_network(_SYSTEM), gravity)
    return static_bound(mechanics, task.mass, task.target, _LARGEST_FORCE, starts, SEED).nmse


def _bounds(
    each: _Each,
    description: str,
    tasks: Sequence[Task],
    gravity: Gravity = NO_GRAVITY,
    truth: MassSpringNetwork | None = None,
) -> list[float]:
    return each(description, partial(_bound, _STARTS, gravity, truth), tasks)


def _tune(each: _Each) -> Rows:
    """Return the median final error of each pair of gains, law and autoencoder."""
    tasks = load_tasks('tuning_targets')[:_TUNING_RUNS]
    rows = []
    for law, checkpoint in _LAWS:
        if law not in _TUNED:
            continue
        for alpha in _PROPORTIONAL:
            for beta in _DERIVATIVE:
                settings = replace(_settings(), proportional_gain=alpha, derivative_gain=beta)
                function = partial(_run, law, checkpoint, settings, DURATION)
                found = each(f'tuning {law}, {checkpoint}', function, tasks)
                final = np.array([outcome.final for outcome in found])
                rows.append(
                    {
                        **_columns(law, checkpoint, settings),
                        'runs': len(tasks),
                        'failed': sum(outcome.failed for outcome in found),
                        'final_nmse_median': float(np.median(final)),
                    }
                )
    return rows


def _best_gains(tuning: Rows) -> dict[tuple[str, str], LawSettings]:
    best: dict[tuple[str, str], dict[str, Any]] = {}
    for row in tuning:
        key = (row['law'], row['checkpoint'].partition('@')[0])
        if key not in best or row['final_nmse_median'] < best[key]['final_nmse_median']:
            best[key] = row
    return {
        key: replace(
            _settings(),
            proportional_gain=row['proportional_gain'],
            derivative_gain=row['derivative_gain'],
        )
        for key, row in best.items()
    }


def _with_gravity(each: _Each, tasks: Sequence[Task]) -> Rows:
    """Return the row of the best law where gravity pulls, known to the law."""
    bounds = _bounds(each, 'static bounds under gravity', tasks, _GRAVITY)
    function = partial(_run, *_BEST, _settings(), DURATION, gravity=_GRAVITY)
    found = each('under gravity', function, tasks)
    columns = {'experiment': 'gravity', **_columns(*_BEST, _settings())}
    return [{**columns, 'gravity_m_s2': _GRAVITY.magnitude, **summary(found, bounds)}]


def _reachable(each: _Each) -> Rows:
    """Return rows of targets that a constant force holds, without and with integral action."""
    tasks, rows = load_tasks('reachable_targets'), []
    for gain in (0.0, 0.5):
        settings = replace(_settings(), integral_gain=gain)
        found = each(
            f'reachable targets, integral {gain}', partial(_run, *_BEST, settings, _LONG), tasks
        )
        row = summary(found, [1.0] * len(tasks))
        row = {key: value for key, value in row.items() if 'bound' not in key}
        ten = float(np.median([outcome.final for outcome in found]))
        columns = {'experiment': 'reachable', **_columns(*_BEST, settings)}
        rows.append({**columns, **row, 'nmse_10s_median': ten})
    return rows


def _robustness(each: _Each, tasks: Sequence[Task], bounds: Sequence[float]) -> Rows:
    """Return rows of the best law under hold, latency, noise, and errors of the model."""
    rows = []
    columns = {'experiment': 'robustness', **_columns(*_BEST, _settings())}
    conditions = [Imperfections(hold=hold) for hold in (2, 4, 8)]
    conditions += [Imperfections(latency=latency) for latency in (1, 2, 4)]
    conditions += [Imperfections(noise=noise) for noise in (0.01, 0.03, 0.1)]
    conditions += [Imperfections(hold=4, latency=4, noise=noise) for noise in (0.1, 0.5)]
    cases: list[tuple[Imperfections, ObserverSettings | None]] = [(c, None) for c in conditions]
    cases += [
        (loop, ObserverSettings(position_noise=loop.noise, delay=loop.latency * STEP))
        for loop in conditions[-2:]
    ]
    for loop, observer in cases:
        function = partial(
            _run, *_BEST, _settings(), DURATION, imperfections=loop, observer=observer
        )
        found = each(f'{loop}', function, tasks)
        row = {
            'hold_s': loop.hold * STEP,
            'latency_s': loop.latency * STEP,
            'sigma_m': loop.noise,
            'observer': 'kalman' if observer else 'none',
        }
        rows.append({**columns, **row, **summary(found, bounds)})
    fast = partial(_run, *_BEST, _settings(), DURATION, step=_FAST)
    row = {'hold_s': _FAST, 'observer': 'none', **summary(each('1 ms', fast, tasks), bounds)}
    rows.insert(0, {**columns, **row})
    network = load_network(_SYSTEM)
    for name in ('stiffness', 'damping', 'mass'):
        for factor in (0.8, 1.2):
            truth = replace(network, **{name: factor * getattr(network, name)})
            there = bounds
            if name == 'stiffness':  # the others move no equilibrium
                there = _bounds(each, f'static bounds, {name} × {factor}', tasks, truth=truth)
            function = partial(_run, *_BEST, _settings(), DURATION, truth=truth)
            found = each(f'{name} × {factor}', function, tasks)
            row = {f'{name}_factor': factor, **summary(found, there)}
            rows.append({**columns, **row})
    return rows


def _each_run(tasks: Sequence[Task], found: Sequence[Outcome], bounds: Sequence[float]) -> Rows:
    return [
        {
            'run': task.run,
            'actuated_mass': task.mass,
            'final_nmse': outcome.final,
            'static_bound': bound,
            'failed': outcome.failed,
            'settling_time_s': outcome.settling_time,
            'peak_force_N': outcome.peak_force,
            'rms_force_N': outcome.rms_force,
            'saturated': outcome.saturated,
            'reason': outcome.reason,
        }
        for task, outcome, bound in zip(tasks, found, bounds, strict=True)
    ]


def _quartiles(found: Sequence[Outcome], bounds: Sequence[float]) -> Rows:
    nmse = np.stack([outcome.nmse for outcome in found])
    steps = range(0, nmse.shape[1], 10)
    ranks = {25: 0.25, 50: 0.5, 75: 0.75}
    return [
        {
            'time_s': k * STEP,
            **{
                f'nmse_{name}': float(np.quantile(nmse[:, k], rank, method='nearest'))
                for name, rank in ranks.items()
            },
            'static_bound_median': float(np.median(bounds)),
        }
        for k in steps
    ]


def _columns(law: str, checkpoint: str, settings: LawSettings) -> dict[str, Any]:
    loaded = load_checkpoint(checkpoint)
    columns = {
        'law': law,
        'checkpoint': loaded.identifier,
        'latent_size': loaded.architecture.latent_size,
        'integral_gain': settings.integral_gain,
        'hold_s': STEP,
        'latency_s': 0.0,
        'sigma_m': 0.0,
    }
    if law in _TUNED:
        columns['proportional_gain'] = settings.proportional_gain
        columns['derivative_gain'] = settings.derivative_gain
    return columns


def _settings() -> LawSettings:
    return LawSettings(largest_force=_LARGEST_FORCE)


def _target(network: MassSpringNetwork, mass: int, specification: str) -> np.ndarray:
    """Return q̄ of `simulation:<number>@<step>`, or the equilibrium of `force:<x>:<y>` [N]."""
    kind, _, rest = specification.partition(':')
    if kind != 'force':
        return _configurations(specification)
    force = np.array([float(value) for value in rest.split(':')])
    body = ConstantForce(Mechanics(network), mass)
    configuration = network.rest_configuration
    for part in np.linspace(0.0, 1.0, _CONTINUATION + 1):
        configuration = body.equilibrium(part * force, configuration)
    return configuration


@lru_cache(maxsize=256)
def _configurations(specification: str) -> np.ndarray:
    return load_target(specification, load_network(_SYSTEM)).value
