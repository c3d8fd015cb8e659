"""The gains of the control experiment, chosen on other targets than those that it reports."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from dpc_ros.control import Imperfections, LawSettings
from dpc_ros.paper.control_rows import Rows, columns, summary
from dpc_ros.paper.regulation import LIMIT, STEP, Each, bound, load_tasks, regulate

DURATION = 5.0  # s, of a run
_RUNS = 10  # of the proportional-derivative laws
_PROPORTIONAL, _DERIVATIVE = (0.5, 2.0, 8.0, 32.0), (0.2, 1.0, 5.0, 20.0)
_FORCE_WEIGHT = (0.001, 0.003, 0.01, 0.03)  # m²/N²
_VELOCITY_WEIGHT = (0.0, 0.03)  # s²
_COLLOCATED_DAMPING = (0.3, 1.0, 2.0)  # N·s/m
_HARDEST = Imperfections(hold=4, latency=4, noise=0.1)
_BEARABLE = 1.1  # times the static bound, median, that a regulator must end within under that
REGULATOR = 'lqr'


def tune(each: Each, laws: Sequence[tuple[str, str]]) -> Rows:
    """Return the errors of each set of gains, for the laws and autoencoders that are tuned.

    The proportional-derivative laws take a grid of α and β each; for the regulator see
    `tune_regulator`.
    """
    rows: Rows = []
    tasks = load_tasks('tuning_targets')
    for law, checkpoint in laws:
        if law == REGULATOR:
            continue
        for alpha, beta in itertools.product(_PROPORTIONAL, _DERIVATIVE):
            settings = replace(LIMIT, proportional_gain=alpha, derivative_gain=beta)
            function = partial(regulate, law, checkpoint, settings, DURATION)
            found = each(f'tuning {law}, {checkpoint}', function, tasks[:_RUNS])
            row = {**columns(law, checkpoint, settings), 'runs': len(found)}
            row['failed'] = sum(outcome.failed for outcome in found)
            row['final_nmse_median'] = float(np.median([outcome.final for outcome in found]))
            rows.append(row)
    return rows


def tune_regulator(each: Each, checkpoint: str) -> Rows:
    """Return how each set of the regulator's gains bears the hardest loop, and how fast it is.

    `final_over_bound_median` is over the tuning targets under hold and latency of 20 ms and noise
    of 0.1 m, the errors at 2 to 5 s over the reachable tuning targets without any of these.
    """
    tasks, reachable = load_tasks('tuning_targets'), load_tasks('tuning_reachable_targets')
    bounds = each('static bounds, tuning', bound, tasks)
    rows = []
    for weight, velocity, damping in itertools.product(
        _FORCE_WEIGHT, _VELOCITY_WEIGHT, _COLLOCATED_DAMPING
    ):
        settings = replace(
            LIMIT, force_weight=weight, velocity_weight=velocity, collocated_damping=damping
        )
        run = partial(regulate, REGULATOR, checkpoint, settings, DURATION)
        hard = each(f'tuning {REGULATOR}', partial(run, imperfections=_HARDEST), tasks)
        quick = summary(each(f'tuning {REGULATOR}', run, reachable), [1.0] * len(reachable))
        row = {**columns(REGULATOR, checkpoint, settings), 'runs': len(tasks) + len(reachable)}
        row |= {
            'hold_s': _HARDEST.hold * STEP,
            'latency_s': _HARDEST.latency * STEP,
            'sigma_m': _HARDEST.noise,
            'final_over_bound_median': summary(hard, bounds)['final_over_bound_median'],
            'failed': sum(outcome.failed for outcome in hard) + quick['failed'],
            **{key: quick[key] for key in ('nmse_2s_median', 'nmse_3s_median', 'nmse_5s_median')},
        }
        rows.append(row)
    return rows


def best_gains(tuning: Rows) -> dict[tuple[str, str], LawSettings]:
    """Return, for each law and checkpoint, the gains with the least median final error."""
    best: dict[tuple[str, str], dict[str, Any]] = {}
    for row in tuning:
        key = (row['law'], row['checkpoint'].partition('@')[0])
        if row['law'] == REGULATOR:
            continue
        error = _value(row, 'final_nmse_median')
        if key not in best or error < _value(best[key], 'final_nmse_median'):
            best[key] = row
    return {
        key: replace(
            LIMIT,
            proportional_gain=row['proportional_gain'],
            derivative_gain=row['derivative_gain'],
        )
        for key, row in best.items()
    }


def best_regulator(tuning: Rows) -> LawSettings:
    """Return the quickest of those gains that fail least and bear the hardest loop.

    The quickest has the least median nMSE at 3 s over the reachable targets.
    """
    rows = [row for row in tuning if row['law'] == REGULATOR]
    rows = [row for row in rows if _value(row, 'final_over_bound_median') <= _BEARABLE] or rows
    least = min(row['failed'] for row in rows)
    row = min((r for r in rows if r['failed'] == least), key=lambda r: _value(r, 'nmse_3s_median'))
    names = ('force_weight', 'velocity_weight', 'collocated_damping')
    return replace(LIMIT, **{name: row[name] for name in names})


def _value(row: dict[str, Any], column: str) -> float:
    """Return a number of a row; what is infinite stands as null in a file."""
    value = row[column]
    return np.inf if value is None else value
