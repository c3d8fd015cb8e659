"""Rows of the control experiment: the law that ran, and what came of its runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.control import LawSettings
from dpc_ros.paper.regulation import STEP, Outcome, Task

Rows = list[dict[str, Any]]

_GAINS = {
    'lqr': ('force_weight', 'velocity_weight', 'collocated_damping', 'equilibrium_starts'),
    **dict.fromkeys(
        ('paper', 'transpose', 'reduced_equilibrium'), ('proportional_gain', 'derivative_gain')
    ),
}


def columns(law: str, checkpoint: str, settings: LawSettings) -> dict[str, Any]:
    """Return the columns that say which law ran, in an ideal loop."""
    loaded = load_checkpoint(checkpoint)
    return {
        'law': law,
        'checkpoint': loaded.identifier,
        'latent_size': loaded.architecture.latent_size,
        'integral_gain': settings.integral_gain,
        'hold_s': STEP,
        'latency_s': 0.0,
        'sigma_m': 0.0,
        **{name: getattr(settings, name) for name in _GAINS.get(law, ())},
        **({'options': str(settings.options)} if settings.options else {}),
    }


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


def each_run(tasks: Sequence[Task], found: Sequence[Outcome], bounds: Sequence[float]) -> Rows:
    """Return a row for every run."""
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


def quartiles(found: Sequence[Outcome], bounds: Sequence[float]) -> Rows:
    """Return median and quartiles of nMSE over the runs, every tenth step."""
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
