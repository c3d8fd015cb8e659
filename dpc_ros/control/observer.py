"""An extended Kalman filter on the compressed dynamics: less noise, gaps bridged, delay met."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder import Autoencoder
from dpc_ros.control.stamps import LONGEST_GAP, NANOSECOND
from dpc_ros.finite import all_finite
from dpc_ros.network import Gravity, MassSpringNetwork, Mechanics
from dpc_ros.parameters import ParameterError
from dpc_ros.reduction import CompressedSystem, DivergenceError, rk4_step

_LONGEST_STEP = 0.01  # s, of a prediction
_DIFFERENCE = 1e-5  # of a state, for the derivative of the dynamics

State = tuple[Float[np.ndarray, ' m'], Float[np.ndarray, ' m']]


@dataclass(frozen=True)
class ObserverSettings:
    """What the filter takes for granted.

    Attributes:
        position_noise: deviation of the noise on each measured coordinate [m].
        velocity_noise: of the noise on each measured velocity [m/s].
        acceleration_noise: of what the compressed dynamics leaves out, as white noise on the
            acceleration of each coordinate [m/s^1.5].
        delay: from a measurement to the moment when its force acts [s].
        longest_gap: without a measurement, after which the filter begins anew [s]; at most
            `LONGEST_GAP`.

    Raises:
        ValueError: a number is out of its range or not finite.
    """

    position_noise: float = 0.01
    velocity_noise: float = 0.05
    acceleration_noise: float = 0.5
    delay: float = 0.0
    longest_gap: float = LONGEST_GAP

    def __post_init__(self) -> None:
        for each in fields(self):
            value, name = getattr(self, each.name), each.name.replace('_', ' ')
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f'{name}: expected a finite number ≥ 0, got {value}')
        if not (self.position_noise > 0 and self.velocity_noise > 0):
            raise ValueError(f'noise of measurements: expected numbers > 0, got {self}')
        if self.longest_gap > LONGEST_GAP:
            raise ValueError(
                f'longest gap: expected at most {LONGEST_GAP:g} s, after which another motion '
                f'begins, got {self.longest_gap:g}'
            )


class LatentObserver:
    """Estimates (ξ, ξ̇) from measured ones, their times and the forces that acted between.

    The prediction integrates the compressed system, its covariance is carried by the linearised
    flow; the measurement is the state itself, with the noise of the coordinates as it comes
    through the decoder's left inverse, σ²(JᵀJ)⁻¹. (Anderson and Moore, Optimal Filtering, section
    8.2.)

    Args:
        system: the compressed system.
        settings: noise and delay.

    Attributes:
        delay: from a measurement to the moment when its force acts [s]; may be set at any time
            where it is measured.
    """

    def __init__(self, system: CompressedSystem, settings: ObserverSettings) -> None:
        self.system = system
        self.settings = settings
        self.delay = settings.delay
        self.restart()

    def restart(self) -> None:
        """Forget everything."""
        self._stamp: int | None = None
        self._begun: int | None = None  # stamp of the first measurement of the motion [ns]
        self._state: State | None = None
        self._covariance = np.zeros((0, 0))
        self._forces: list[tuple[int, np.ndarray]] = []
        self.innovation = np.zeros(0)  # what the last measurement had that was not foretold
        self.innovation_covariance = np.zeros((0, 0))

    def acted(self, stamp: int, force: Float[np.ndarray, ' 2']) -> None:
        """Note the force [N] that answers the measurement of a stamp [ns].

        One that is known already, or answers a motion before this one, is passed over.
        """
        if self._begun is None or stamp < self._begun:
            return
        if self._forces and stamp <= self._forces[-1][0]:
            return
        kept = stamp - round((self.settings.longest_gap + self.delay) / NANOSECOND)
        self._forces = [each for each in self._forces if each[0] >= kept]
        self._forces.append((stamp, force))

    def estimate(
        self,
        latent: Float[np.ndarray, ' m'],
        velocity: Float[np.ndarray, ' m'],
        stamp: int,
    ) -> State:
        """Take a measurement of a time [ns]; return (ξ, ξ̇) when the answer to it will act."""
        state = self.update(latent, velocity, stamp)
        return self.ahead() if self.delay and stamp == self._stamp else state

    def update(
        self,
        latent: Float[np.ndarray, ' m'],
        velocity: Float[np.ndarray, ' m'],
        stamp: int,
    ) -> State:
        """Take a measurement of a time [ns] and return the estimate of (ξ, ξ̇) then.

        The first measurement, one after too long a gap, and one from before the last begin anew.
        """
        if not (all_finite(latent) and all_finite(velocity)):
            return latent, velocity  # there is nothing to learn from it
        try:
            noise = self._measurement_covariance(latent)
        except np.linalg.LinAlgError:
            return latent, velocity
        gap = math.inf if self._stamp is None else (stamp - self._stamp) * NANOSECOND
        if self._state is None or not 0 <= gap <= self.settings.longest_gap:
            if not 0 <= gap <= LONGEST_GAP:
                self._begun, self._forces = stamp, []  # another motion
            return self._begin(latent, velocity, stamp, noise)
        assert self._stamp is not None
        try:
            state, covariance = self._predict(self._state, self._covariance, self._stamp, stamp)
            total = covariance + noise
            gain = np.linalg.solve(total, covariance).T
        except (DivergenceError, np.linalg.LinAlgError):
            return self._begin(latent, velocity, stamp, noise)
        predicted = np.concatenate(state)
        innovation = np.concatenate([latent, velocity]) - predicted
        estimate = predicted + gain @ innovation
        if not all_finite(estimate):
            return self._begin(latent, velocity, stamp, noise)
        self.innovation = innovation
        self.innovation_covariance = total
        left = np.eye(predicted.size) - gain
        self._covariance = left @ covariance @ left.T + gain @ noise @ gain.T
        m = self.system.latent_size
        self._state, self._stamp = (estimate[:m], estimate[m:]), stamp
        return self._state

    def ahead(self) -> State:
        """Return the estimate for the moment when an answer to the last measurement will act.

        Raises:
            ValueError: there was no measurement yet.
        """
        if self._state is None or self._stamp is None:
            raise ValueError('expected a measurement before a prediction')
        then = self._stamp + round(self.delay / NANOSECOND)
        try:
            return self._flow(self._state, self._stamp, then)
        except (DivergenceError, np.linalg.LinAlgError):
            return self._state

    def _begin(
        self, latent: np.ndarray, velocity: np.ndarray, stamp: int, noise: np.ndarray
    ) -> State:
        self.innovation, self.innovation_covariance = np.zeros(0), np.zeros((0, 0))
        self._state, self._stamp, self._covariance = (latent, velocity), stamp, noise
        return self._state

    def _predict(
        self, state: State, covariance: np.ndarray, begin: int, end: int
    ) -> tuple[State, np.ndarray]:
        m = self.system.latent_size
        start, transition = state, np.eye(2 * m)
        steps = [*self._steps(begin, end)]
        if steps:  # of equal length: the derivative where they begin is to do for all
            transition = np.linalg.matrix_power(self._transition(state, *steps[0]), len(steps))
        for duration, force in steps:
            state = self._advance(state, duration, force)
        covariance = transition @ covariance @ transition.T
        return state, covariance + self._process_covariance(start[0], (end - begin) * NANOSECOND)

    def _flow(self, state: State, begin: int, end: int) -> State:
        """Return a state moved on from one time to another [ns]."""
        for duration, force in self._steps(begin, end):
            state = self._advance(state, duration, force)
        return state

    def _steps(self, begin: int, end: int) -> Iterator[tuple[float, Float[np.ndarray, ' 2']]]:
        """Yield equal durations [s] between two times [ns], and the mean force [N] in each."""
        count = math.ceil((end - begin) * NANOSECOND / _LONGEST_STEP - 1e-9)
        edges = [begin + (end - begin) * k // count for k in range(count + 1)] if count else []
        for first, last in pairwise(edges):
            yield (last - first) * NANOSECOND, self._mean_force(first, last)

    def _mean_force(self, begin: int, end: int) -> Float[np.ndarray, ' 2']:
        delay = round(self.delay / NANOSECOND)
        acting = [(begin, np.zeros(2))]
        for stamp, force in self._forces:
            if stamp + delay <= begin:
                acting = [(begin, force)]
            elif stamp + delay < end:
                acting.append((stamp + delay, force))
        if len(acting) == 1:
            return acting[0][1]
        times = [time for time, _ in acting] + [end]
        share = np.diff(times) / (end - begin)
        return share @ np.array([force for _, force in acting])

    def _advance(self, state: State, duration: float, force: np.ndarray) -> State:
        with np.errstate(all='ignore'):  # what is not finite is told below
            latent, velocity = rk4_step(self.system, *state, force, duration)
        if not (all_finite(latent) and all_finite(velocity)):
            raise DivergenceError(f'a prediction of {duration:g} s left every bound')
        return latent, velocity

    def _transition(
        self, state: State, duration: float, force: np.ndarray
    ) -> Float[np.ndarray, '2*m 2*m']:
        """Return the derivative of the flow over a step, exp(Ah) to second order."""
        m = self.system.latent_size
        point = np.concatenate(state)
        moved = np.vstack([point, point + _DIFFERENCE * np.eye(2 * m)])
        with np.errstate(all='ignore'):  # what is not finite begins anew
            acceleration = self.system.acceleration(moved[:, :m], moved[:, m:], force)
            below = (acceleration[1:] - acceleration[0]).T / _DIFFERENCE
        step = duration * np.vstack([np.eye(2 * m)[m:], below])
        return np.eye(2 * m) + step + step @ step / 2

    def _measurement_covariance(self, latent: np.ndarray) -> np.ndarray:
        inverse = self._inverse_spread(latent)
        settings, nothing = self.settings, np.zeros_like(inverse)
        position, velocity = settings.position_noise**2, settings.velocity_noise**2
        return np.block([[position * inverse, nothing], [nothing, velocity * inverse]])

    def _process_covariance(self, latent: np.ndarray, duration: float) -> np.ndarray:
        """Return that of white noise on the acceleration over a time [s]."""
        inverse = self.settings.acceleration_noise**2 * self._inverse_spread(latent)
        both = duration**2 / 2 * inverse
        return np.block([[duration**3 / 3 * inverse, both], [both, duration * inverse]])

    def _inverse_spread(self, latent: np.ndarray) -> np.ndarray:
        """Return (JᵀJ)⁻¹, the covariance of a latent state under unit noise on the coordinates."""
        jacobian = self.system.autoencoder.decoder_jacobian(latent)
        return np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)


def make_observer(
    network: MassSpringNetwork, autoencoder: Autoencoder, parameters: Mapping[str, Any]
) -> LatentObserver:
    """Return the observer that an encoder's parameters describe: they have its settings' names.

    Raises:
        ParameterError: the delay is given, and to be measured as well.
    """
    if parameters['measure_delay'] and parameters['delay']:
        raise ParameterError('measure_delay: expected delay 0, or measure_delay false: not both')
    gravity = Gravity(parameters['gravity_magnitude'], parameters['gravity_angle'])
    system = CompressedSystem(Mechanics(network, gravity), autoencoder, parameters['actuated_mass'])
    names = (each.name for each in fields(ObserverSettings))
    return LatentObserver(system, ObserverSettings(**{name: parameters[name] for name in names}))
