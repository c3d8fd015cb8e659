"""One regulation run of the control experiment: from rest to a target, and what came of it."""

from __future__ import annotations

import csv
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import islice
from multiprocessing import get_context
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from dpc_ros.autoencoder import Autoencoder, load_checkpoint
from dpc_ros.control import (
    ClosedLoopRun,
    ConstantForce,
    Imperfections,
    LatentObserver,
    LawSettings,
    ObserverSettings,
    Target,
    load_target,
    make_law,
    run_closed_loop,
    static_bound,
)
from dpc_ros.network import Body, Gravity, Integrator, MassSpringNetwork, Mechanics, load_network
from dpc_ros.network.mechanics import NO_GRAVITY
from dpc_ros.reduction import CompressedSystem
from dpc_ros.resources import config_path
from dpc_ros.threads import single_threaded_algebra

SEED = 0
STEP = 0.005  # s
SYSTEM = 'paper_2'
LIMIT = LawSettings(largest_force=20.0)  # N; everything else as the defaults are
_FINAL = 0.25  # s at the end, whose mean error is the final one
_STARTS = 20  # of the search for a static bound
_CONTINUATION = 16  # forces on the way to a reachable target
_OFTEN = 0.1  # part of the forces, from which shortening them is named as a reason
_ILL_CONDITIONED = 10.0
_AT_REST = 0.05  # m/s, root mean square over coordinates
_SETTLED = 1.2  # times its final value, within which an error has settled


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


def load_tasks(name: str, count: int | None = None) -> list[Task]:
    """Return the runs of a file in config/control, or its first ones, without gravity."""
    network = load_network(SYSTEM)
    with config_path('control', f'{name}.csv').open(newline='') as file:
        return [
            Task(
                int(row['run']),
                int(row['actuated_mass']),
                _target(network, int(row['actuated_mass']), row['target']),
            )
            for row in islice(csv.DictReader(file), count)
        ]


def regulate(
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
    """Return what comes of one run.

    Args:
        law_name: the law.
        checkpoint: name of the autoencoder.
        settings: of the law.
        duration: of the run [s].
        task: mass and target.
        gravity: of the body, known to the law.
        imperfections: of measurement and timing; the noise of each run is drawn anew.
        truth: the body, where it is not the one of the law's model.
        observer: a Kalman filter between encoder and law.
        step: control step [s].
    """
    network, autoencoder = _models(checkpoint)
    law = make_law(
        law_name,
        CompressedSystem(Mechanics(network, gravity), autoencoder, task.mass),
        settings,
    )
    steps = round(duration / step)
    try:
        law.regulate(Target(configuration=task.target))
    except Exception as error:  # EquilibriumError, or what a law that is not ours raises
        return Outcome(np.full(steps + 1, np.inf), reason=str(error), step=step)
    if imperfections is not None:
        imperfections = replace(imperfections, seed=SEED + task.run)
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
            LatentObserver(law.system, observer) if observer is not None else None,
        )
        errors = np.mean((run.configuration - task.target) ** 2, axis=1)
        nmse = np.nan_to_num(errors / errors[0], nan=np.inf)
    length = np.nan_to_num(np.linalg.norm(run.force, axis=1), nan=settings.largest_force)
    rms = float(np.sqrt(np.mean(length**2)))
    outcome = Outcome(nmse, float(length.max()), rms, float(np.mean(shortened)), step=step)
    if not outcome.failed:
        return outcome
    return replace(outcome, reason=_why(law.system, task, run, outcome))


def check_made(law_name: str, checkpoint: str, task: Task, settings: LawSettings) -> None:
    """Make sure that a law can be made.

    Raises:
        ValueError: there is no such law, or it can't be.
    """
    network, autoencoder = _models(checkpoint)
    make_law(law_name, CompressedSystem(Mechanics(network), autoencoder, task.mass), settings)


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
    return load_network(SYSTEM), load_checkpoint(checkpoint).autoencoder()


def bound(
    task: Task,
    gravity: Gravity = NO_GRAVITY,
    truth: MassSpringNetwork | None = None,
    starts: int = _STARTS,
) -> float:
    """Return the static bound of a task as nMSE, of the body `truth` where it is another."""
    single_threaded_algebra()
    mechanics = Mechanics(truth or load_network(SYSTEM), gravity)
    return static_bound(mechanics, task.mass, task.target, LIMIT.largest_force, starts, SEED).nmse


Each = Callable[[str, Callable[[Task], Any], Sequence[Task]], list[Any]]


@contextmanager
def each_task(progress: bool) -> Iterator[Each]:
    """Give a function that does something for each task, in as many processes as there are cores.

    On Ctrl-C what has not begun never will.
    """
    pool = ProcessPoolExecutor(mp_context=get_context('spawn'), initializer=_begin_worker)
    try:
        yield partial(_in_turn, pool, progress)
    finally:
        pool.shutdown(cancel_futures=True)


def _begin_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent's to answer
    single_threaded_algebra()


def _in_turn(
    pool: ProcessPoolExecutor,
    progress: bool,
    description: str,
    function: Callable[[Task], Any],
    tasks: Sequence[Task],
) -> list[Any]:
    results: Iterator[Any] = pool.map(function, tasks)
    return list(tqdm(results, desc=description, total=len(tasks), disable=not progress))


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
    return load_target(specification, load_network(SYSTEM)).value
