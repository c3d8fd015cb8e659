"""How regularly a run went by the clock, how old its forces were, and what was lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from dpc_ros.bag.reader import Run
from dpc_ros.bag.topic import NANOSECONDS


@dataclass(frozen=True, eq=False)
class Timing:
    """What the times of the messages show. Of a stamp that was published again the first counts.

    Attributes:
        period_time: of each configuration but the first, since the first [s].
        period: between its arrival at the recorder and that of the one before [s]; NaN where the
            one before came later, as when a simulator began anew.
        age_time: of each configuration that was answered [s].
        age: from its publication to that of the force with its stamp [s]; NaN where the force was
            published before.
        loss_time: by topic of the loop, of each message [s].
        lost: by topic of the loop, messages known to be missing by then.
    """

    period_time: Float[np.ndarray, ' periods']
    period: Float[np.ndarray, ' periods']
    age_time: Float[np.ndarray, ' answers']
    age: Float[np.ndarray, ' answers']
    loss_time: dict[str, Float[np.ndarray, ' messages']]
    lost: dict[str, Int[np.ndarray, ' messages']]


def measure_timing(run: Run) -> Timing:
    """Measure the timing of a run; what its log does not say is empty."""
    stamps = {
        'configuration': run.configuration_stamp,
        'latent_state': run.latent_stamp,
        'control_force': run.force_stamp,
    }
    start = run.configuration_stamp[0]
    seconds = {
        name: (stamps[name] - start) / NANOSECONDS for name in stamps if name in run.arrivals
    }
    period = age = age_time = np.zeros(0)
    body, force = run.arrivals.get('configuration'), run.arrivals.get('control_force')
    if body is not None:
        period = _forward(np.diff(body.received_ns))
    if body is not None and force is not None:
        _, asked, answered = np.intersect1d(
            run.configuration_stamp, run.force_stamp, assume_unique=True, return_indices=True
        )
        age = _forward(force.published_ns[answered] - body.published_ns[asked])
        age_time = seconds['configuration'][asked]
    return Timing(
        period_time=seconds.get('configuration', np.zeros(0))[1:],
        period=period,
        age_time=age_time,
        age=age,
        loss_time=seconds,
        lost={name: run.arrivals[name].lost for name in seconds},
    )


def _forward(nanoseconds: Int[np.ndarray, ' k']) -> Float[np.ndarray, ' k']:
    """Return seconds, NaN where time went back."""
    return np.where(nanoseconds < 0, np.nan, nanoseconds / NANOSECONDS)
