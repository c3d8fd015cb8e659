"""How far and how fast a logged run came to its target, and what it cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from dpc_ros.bag.reader import Run, Target
from dpc_ros.bag.topic import NANOSECONDS

if TYPE_CHECKING:  # types only: a log is measured without loading torch
    from dpc_ros.autoencoder import Autoencoder
    from dpc_ros.network import Mechanics

FINAL_WINDOW_NS = 250_000_000  # ns, at the end of a run, over which the final nMSE is the mean
SETTLING_FRACTION = 0.05  # of the way from 1 to the final nMSE that may be left when settled


@dataclass(frozen=True, eq=False)
class Energy:
    """Energies of the body at each logged configuration [J].

    Attributes:
        kinetic: ½ q̇ᵀMq̇.
        elastic: of springs and background term.
        gravitational: −Σ m g·x.
    """

    kinetic: Float[np.ndarray, ' frames']
    elastic: Float[np.ndarray, ' frames']
    gravitational: Float[np.ndarray, ' frames']

    @property
    def potential(self) -> Float[np.ndarray, ' frames']:
        """V(q) [J]."""
        return self.elastic + self.gravitational

    @property
    def total(self) -> Float[np.ndarray, ' frames']:
        """The Hamiltonian [J]."""
        return self.kinetic + self.potential


@dataclass(frozen=True, eq=False)
class Goal:
    """A target that a controller takes, in both coordinates.

    Attributes:
        target: as it was published.
        configuration: q̄ [m].
        latent: ξ̄, E(q̄) where the target is a configuration; None without an autoencoder.
    """

    target: Target
    configuration: Float[np.ndarray, ' n']
    latent: Float[np.ndarray, ' m'] | None


@dataclass(frozen=True, eq=False)
class Convergence:
    """What the log of a run shows. All times count from the first configuration.

    Attributes:
        run: the log.
        time: of each configuration [s].
        nmse: MSE(q, q̄) over the MSE at the first stamp at which the target q̄ is in force; NaN
            while there is no target, 0 where an error that began at zero is zero.
        final_nmse: mean over the last 0.25 s, as far as the last target was in force; NaN without.
        settling_time: earliest time [s] from which the nMSE stays at or below
            final + 5 % of (1 − final); NaN if there is none.
        target: the last target in force; None without.
        target_time: when it came into force [s]; NaN without.
        ignored_targets: targets of a wrong size or with values that are not finite, which no
            controller takes either.
        latent_time: of each latent state [s].
        latent_error: |ξ − E(q̄)|, or |ξ − ξ̄| for a latent target; None without an autoencoder.
        force_time: of each force [s].
        force_norm: |u| [N].
        peak_force: largest |u| [N]; NaN without a force.
        rms_force: root of the mean of |u|² over the logged forces [N]; NaN without a force.
        energy: None where the mechanics is not given.
        goals: all usable targets in the order of their stamps.
        mechanics: what the energies were measured with, None where it is not given.
        autoencoder: what latent error and goals were measured with, likewise.
    """

    run: Run
    time: Float[np.ndarray, ' frames']
    nmse: Float[np.ndarray, ' frames']
    final_nmse: float
    settling_time: float
    target: Target | None
    target_time: float
    ignored_targets: int
    latent_time: Float[np.ndarray, ' latents']
    latent_error: Float[np.ndarray, ' latents'] | None
    force_time: Float[np.ndarray, ' forces']
    force_norm: Float[np.ndarray, ' forces']
    peak_force: float
    rms_force: float
    energy: Energy | None
    goals: tuple[Goal, ...] = ()
    mechanics: Mechanics | None = None
    autoencoder: Autoencoder | None = None

    @property
    def failed(self) -> bool:
        """Whether the run ended farther from its target than it began, or with no finite state."""
        return self.target is not None and not self.final_nmse <= 1

    @property
    def force(self) -> Float[np.ndarray, 'forces 2']:
        """Components of u [N]."""
        return self.run.force


def analyse(
    run: Run,
    mechanics: Mechanics | None = None,
    autoencoder: Autoencoder | None = None,
) -> Convergence:
    """Measure the convergence of a run.

    Args:
        run: the log.
        mechanics: of the logged body, for the energies.
        autoencoder: of the logged latent states, for the latent error and for latent targets.

    Raises:
        ValueError: mechanics or autoencoder belong to another body than the logged one, or a
            target is latent and there is no autoencoder to decode it.
    """
    _check_models(run, mechanics, autoencoder)
    candidates = [_goal(target, run, autoencoder) for target in run.targets]
    goals = [goal for goal in candidates if goal is not None]
    start = run.configuration_stamp[0]
    time = _seconds(run.configuration_stamp, start)
    nmse, last, segment = _normalised_mse(run, goals)
    final = _final_nmse(run, nmse, segment)
    force_norm = np.hypot(run.force[:, 0], run.force[:, 1])
    has_force = len(force_norm) > 0
    return Convergence(
        run=run,
        time=time,
        nmse=nmse,
        final_nmse=final,
        settling_time=_settling_time(time, nmse, final),
        target=last.target if last else None,
        target_time=float(time[segment][0]) if last else np.nan,
        ignored_targets=len(candidates) - len(goals),
        latent_time=_seconds(run.latent_stamp, start),
        latent_error=None if autoencoder is None else _latent_error(run, goals),
        force_time=_seconds(run.force_stamp, start),
        force_norm=force_norm,
        peak_force=float(force_norm.max()) if has_force else np.nan,
        rms_force=_root_mean_square(force_norm) if has_force else np.nan,
        energy=None if mechanics is None else _energy(run, mechanics),
        goals=tuple(goals),
        mechanics=mechanics,
        autoencoder=autoencoder,
    )


def goals_in_force(stamps: Int[np.ndarray, ' k'], goals: Sequence[Goal]) -> Int[np.ndarray, ' k']:
    """Return which goal is in force at each stamp [ns], −1 for none; the newest wins."""
    return np.searchsorted([goal.target.stamp_ns for goal in goals], stamps, side='right') - 1


def _goal(target: Target, run: Run, autoencoder: Autoencoder | None) -> Goal | None:
    if target.configuration is not None:
        if not _usable(target.configuration, run.configuration.shape[1]):
            return None
        latent = None if autoencoder is None else autoencoder.encode(target.configuration)
        return Goal(target, target.configuration, latent)
    if autoencoder is None:
        raise ValueError(
            f'target {target.frame_id!r}: expected an autoencoder to decode the latent target '
            'into a configuration, got none: give the checkpoint '
            f'{run.autoencoder_identifier or "of the run"}'
        )
    if target.latent is None or not _usable(target.latent, autoencoder.latent_size):
        return None
    return Goal(target, autoencoder.decode(target.latent), target.latent)


def _usable(values: np.ndarray, size: int) -> bool:
    return values.shape == (size,) and bool(np.isfinite(values).all())


def _normalised_mse(
    run: Run, goals: list[Goal]
) -> tuple[Float[np.ndarray, ' frames'], Goal | None, Bool[np.ndarray, ' frames']]:
    """Return nMSE(t), the last goal in force and the frames in which it was."""
    nmse = np.full(len(run.configuration), np.nan)
    in_force = goals_in_force(run.configuration_stamp, goals)
    first, goal = len(nmse), None
    for i in np.unique(in_force[in_force >= 0]):
        # A target that is published again is the same one: its error has begun long ago.
        if goal is None or not np.array_equal(goals[i].configuration, goal.configuration):
            first, goal = int(np.searchsorted(in_force, i)), goals[i]
        frames = in_force == i
        with np.errstate(all='ignore'):  # a body that exploded leaves inf and NaN in its log
            error = np.mean((run.configuration[frames] - goal.configuration) ** 2, axis=1)
            initial = np.mean((run.configuration[first] - goal.configuration) ** 2)
            nmse[frames] = np.where(error == 0, 0.0, error / initial)
    return nmse, goal, np.arange(len(nmse)) >= first


def _final_nmse(
    run: Run, nmse: Float[np.ndarray, ' frames'], segment: Bool[np.ndarray, ' frames']
) -> float:
    window = run.configuration_stamp > run.configuration_stamp[-1] - FINAL_WINDOW_NS
    return float(np.mean(nmse[window & segment])) if segment.any() else np.nan


def _settling_time(
    time: Float[np.ndarray, ' frames'], nmse: Float[np.ndarray, ' frames'], final: float
) -> float:
    outside = np.flatnonzero(~(nmse <= final + SETTLING_FRACTION * (1 - final)))
    settled = outside[-1] + 1 if len(outside) else 0
    return float(time[settled]) if settled < len(time) else np.nan


def _latent_error(run: Run, goals: list[Goal]) -> Float[np.ndarray, ' latents']:
    error = np.full(len(run.latent), np.nan)
    in_force = goals_in_force(run.latent_stamp, goals)
    for i in np.unique(in_force[in_force >= 0]):
        frames = in_force == i
        with np.errstate(all='ignore'):
            error[frames] = np.linalg.norm(run.latent[frames] - np.asarray(goals[i].latent), axis=1)
    return error


def _root_mean_square(values: Float[np.ndarray, ' k']) -> float:
    with np.errstate(over='ignore'):
        return float(np.sqrt(np.mean(values**2)))


def _energy(run: Run, mechanics: Mechanics) -> Energy:
    return Energy(
        kinetic=np.array([mechanics.kinetic_energy(v) for v in run.velocity]),
        elastic=np.array([mechanics.elastic_energy(q) for q in run.configuration]),
        gravitational=np.array([mechanics.gravitational_energy(q) for q in run.configuration]),
    )


def _seconds(stamps: Int[np.ndarray, ' k'], start: int) -> Float[np.ndarray, ' k']:
    return (stamps - start) / NANOSECONDS


def _check_models(run: Run, mechanics: Mechanics | None, autoencoder: Autoencoder | None) -> None:
    size = run.configuration.shape[1]
    if mechanics is not None:
        network = mechanics.network
        _, at, digest = run.network_identifier.rpartition('@')
        if mechanics.configuration_size != size or (at and digest != network.digest):
            raise ValueError(
                f'mechanics: expected those of {run.network_identifier or "the logged body"} with '
                f'{size} coordinates, got {network.identifier} with '
                f'{mechanics.configuration_size}: load the network of the run'
            )
    if autoencoder is not None:
        expected = size, run.latent.shape[1] if len(run.latent) else autoencoder.latent_size
        sizes = autoencoder.configuration_size, autoencoder.latent_size
        if sizes != expected:
            raise ValueError(
                f'autoencoder: expected one from {expected[0]} to {expected[1]} coordinates, as '
                f'{run.autoencoder_identifier or "the run"} has, got {sizes[0]} to {sizes[1]}: '
                'load the checkpoint of the run'
            )
