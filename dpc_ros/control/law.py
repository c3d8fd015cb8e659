"""What every control law is: a map from the latent state to a bounded force on one mass."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from dpc_ros.control.saturation import shorten
from dpc_ros.control.stamps import LONGEST_GAP, NANOSECOND
from dpc_ros.control.targets import Target
from dpc_ros.reduction import CompressedSystem


@dataclass(frozen=True)
class LawSettings:
    """What can be set about a control law; each takes of it what it needs.

    Attributes:
        largest_force: bound on |u| [N]; longer forces are shortened, their direction kept.
        proportional_gain: α of the proportional-derivative laws, on the latent error.
        derivative_gain: β of these, on the latent velocity [s] or momentum.
        inverse_damping: λ of the damped left inverse of Γ, relative to its largest singular value.
        force_weight: R of the linear-quadratic regulator, mean square of q per square of u [m²/N²].
        velocity_weight: of its mean square of q̇ beside that of q [s²].
        collocated_damping: of the actuated mass against its velocity [N·s/m].
        equilibrium_starts: searches for the best static equilibrium, at least 2; more find it
            more often and take longer.
        integral_gain: rate at which the constant part of the force follows the error [1/s].
        integral_delay: time after a new target before it begins to [s].
        options: whatever a law of another package takes beside these.

    Raises:
        ValueError: a number is out of its range or none, or one but the bound is infinite.
    """

    largest_force: float = math.inf
    proportional_gain: float = 2.0
    derivative_gain: float = 1.0
    inverse_damping: float = 0.05
    force_weight: float = 0.001
    velocity_weight: float = 0.03
    collocated_damping: float = 0.3
    equilibrium_starts: int = 2
    integral_gain: float = 0.0
    integral_delay: float = 3.0
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            name = each.name.replace('_', ' ')
            if each.name == 'options':
                continue
            if not value >= 0:
                raise ValueError(f'{name}: expected a number ≥ 0, got {value}')
            if each.name != 'largest_force' and not math.isfinite(value):
                raise ValueError(f'{name}: expected a finite number, got {value}')
        if self.equilibrium_starts < 2:
            raise ValueError(
                f'equilibrium starts: expected at least 2, got {self.equilibrium_starts}'
            )
        if not self.force_weight > 0:
            raise ValueError(f'force weight: expected a number > 0, got {self.force_weight}')


class ControlLaw(ABC):
    """A map from (ξ, ξ̇) to the force u that regulates the body to a target.

    Args:
        system: the compressed system.
        settings: gains and bound.
    """

    def __init__(self, system: CompressedSystem, settings: LawSettings) -> None:
        self.system = system
        self.settings = settings
        self.excess = np.zeros(2)  # what the last force was shortened by [N]
        self._last_stamp: int | None = None

    def regulate(self, target: Target) -> None:
        """Take a new target: solve for it, and adopt the solution.

        Raises:
            TargetError: its length does not fit.
            EquilibriumError: the law rests on an equilibrium, and there is none for it.
        """
        self.adopt(self.solve(target))

    @abstractmethod
    def solve(self, target: Target) -> Any:
        """Return what the law has to know to regulate to a target; whatever is slow happens here.

        It changes nothing of the law, and depends on nothing but its system, its settings and the
        target: another process may have solved.

        Returns:
            something that can be pickled, of this package a frozen dataclass of arrays.

        Raises:
            TargetError: the target's length does not fit.
            EquilibriumError: the law rests on an equilibrium, and there is none for it.
        """

    @abstractmethod
    def adopt(self, solution: Any) -> None:
        """Regulate from now on to the target of a solution that `solve` has returned; quick."""

    @abstractmethod
    def unbounded_force(
        self, latent: Float[np.ndarray, ' m'], latent_velocity: Float[np.ndarray, ' m']
    ) -> Float[np.ndarray, ' 2']:
        """Return u [N] before saturation."""

    def advance(self, latent: Float[np.ndarray, ' m'], elapsed: float) -> None:  # noqa: B027
        """Move on what the law keeps from one step to the next, after its force is known.

        Args:
            latent: ξ of this step.
            elapsed: time since the step before [s]; zero at the first.
        """

    def force(
        self,
        latent: Float[np.ndarray, ' m'],
        latent_velocity: Float[np.ndarray, ' m'],
        stamp: int = 0,
    ) -> Float[np.ndarray, ' 2']:
        """Return u [N], its norm bounded by the largest force.

        After a gap of more than `LONGEST_GAP` since the stamp before the law begins anew: the body
        was set back, or nobody knows what happened meanwhile.

        Args:
            latent: ξ.
            latent_velocity: ξ̇.
            stamp: time of the state [ns]; the same for all where time does not matter.
        """
        last = stamp if self._last_stamp is None else self._last_stamp
        elapsed = max(stamp - last, 0) * NANOSECOND
        if elapsed > LONGEST_GAP:
            self.restart()
            elapsed = 0.0
        wanted = self.unbounded_force(latent, latent_velocity)
        force = shorten(wanted, self.settings.largest_force)
        self.excess = wanted - force
        self._last_stamp = stamp
        self.advance(latent, elapsed)
        return force

    @property
    def saturated(self) -> bool:
        """Whether the bound has shortened the last force."""
        return bool(np.count_nonzero(self.excess))  # faster than `any`

    def restart(self) -> None:
        """Begin anew: forget what the law keeps between steps, but not its target."""
        self._last_stamp = None

    def carry_on(self, before: ControlLaw) -> None:
        """Take over from a law with other settings, of the same target, in the middle of a motion.

        A law that keeps something between steps takes of it what still counts, so that the force
        does not jump more than the settings ask for.
        """
        self._last_stamp = before._last_stamp

    def _target_latent(self, target: Target) -> Float[np.ndarray, ' m']:
        autoencoder = self.system.autoencoder
        target.check_sizes(autoencoder.configuration_size, autoencoder.latent_size)
        return target.value if target.is_latent else autoencoder.encode(target.value)

    def _target_configuration(self, target: Target) -> Float[np.ndarray, ' n']:
        autoencoder = self.system.autoencoder
        target.check_sizes(autoencoder.configuration_size, autoencoder.latent_size)
        return autoencoder.decode(target.value) if target.is_latent else target.value
