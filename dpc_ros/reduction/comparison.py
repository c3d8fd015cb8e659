"""The compressed simulation of a motion beside the body's own, and the errors between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from dpc_ros.autoencoder import Autoencoder
from dpc_ros.network import MassSpringNetwork, Mechanics, Trajectory
from dpc_ros.reduction.compressed_system import CompressedSystem
from dpc_ros.reduction.simulation import simulate_compressed

Series = Float[np.ndarray, ' frames']


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion of the body, frame by frame.

    Attributes:
        configuration: q [m].
        velocity: q̇ [m/s].
        kinetic: energy of the motion [J].
        potential: energy of the configuration, gravity included [J].
    """

    configuration: Float[np.ndarray, 'frames n']
    velocity: Float[np.ndarray, 'frames n']
    kinetic: Series
    potential: Series

    @property
    def total(self) -> Series:
        """The Hamiltonian [J]."""
        return self.kinetic + self.potential


@dataclass(frozen=True, eq=False)
class Comparison:
    """One motion three times: as the body makes it, reconstructed, and simulated compressed.

    Attributes:
        network: the body.
        step: time between two frames [s].
        full: the body's own motion.
        pointwise: each frame of it encoded and decoded, D(E(q)) and JJ_E q̇ (paper, section IV).
        compressed: what the compressed system makes of the first frame, D(ξ(t)) and Jξ̇(t).
    """

    network: MassSpringNetwork
    step: float
    full: Motion
    pointwise: Motion
    compressed: Motion

    @property
    def time(self) -> Series:
        """Time of each frame [s]."""
        return self.step * np.arange(len(self.full.configuration))

    @property
    def configuration_error(self) -> Series:
        """Mean square of q̂ − q over the coordinates [m²], frame by frame."""
        return _mean_square(self.compressed.configuration - self.full.configuration)

    @property
    def velocity_error(self) -> Series:
        """Mean square of q̂̇ − q̇ over the coordinates [m²/s²], frame by frame."""
        return _mean_square(self.compressed.velocity - self.full.velocity)

    @property
    def energy_error(self) -> Series:
        """Square of the error of the total energy [J²], frame by frame."""
        return (self.compressed.total - self.full.total) ** 2

    @property
    def relative_error(self) -> float:
        """‖q̂ − q‖/‖q‖ over the whole motion, positions measured from the origin."""
        return self._distance / float(np.linalg.norm(self.full.configuration))

    @property
    def relative_error_about_rest(self) -> float:
        """‖q̂ − q‖/‖q − q_rest‖ over the whole motion."""
        moved = self.full.configuration - self.network.rest_configuration
        return self._distance / float(np.linalg.norm(moved))

    @property
    def relative_energy_error(self) -> float:
        """Root mean square of the error of the total energy over the energy's range."""
        return float(np.sqrt(self.energy_error.mean()) / np.ptp(self.full.total))

    @property
    def energy_increase(self) -> float:
        """Largest rise of the compressed energy between two frames, over the energy's range."""
        rise = np.diff(self.compressed.total).max()
        return float(max(rise, 0.0) / np.ptp(self.full.total))

    @property
    def _distance(self) -> float:
        return float(np.linalg.norm(self.compressed.configuration - self.full.configuration))


def compare(
    system: CompressedSystem,
    trajectory: Trajectory,
    step: float = 0.02,
    method: str = 'rk4',
    progress: bool = False,
) -> Comparison:
    """Simulate the compressed system from the first frame of a motion without input force.

    Args:
        system: the compressed system, in the motion's field of gravity.
        trajectory: the motion of the body.
        step: of the compressed simulation [s], a multiple of the motion's.
        method: of the compressed simulation, a key of `METHODS`.
        progress: show progress bars.

    Raises:
        ValueError: the step is no multiple of the motion's, or the motion is shorter than it.
        DivergenceError: the compressed simulation diverges.
    """
    stride = round(step / trajectory.step)
    if stride < 1 or not np.isclose(stride * trajectory.step, step, rtol=1e-9):
        raise ValueError(f'step {step:g} s: expected a multiple of {trajectory.step:g} s')
    if stride >= len(trajectory.configuration):
        raise ValueError(f'step {step:g} s: expected one shorter than the motion')
    q, velocity = trajectory.configuration[::stride], trajectory.velocity[::stride]
    pointwise = _reconstructed(system.autoencoder, q, velocity, progress)
    latent, latent_velocity = system.autoencoder.encoder_jacobian_vector_product(q[0], velocity[0])
    simulated = simulate_compressed(
        system, latent, latent_velocity, step, len(q) - 1, method=method, progress=progress
    )
    decoded = [
        _decoded(system.autoencoder, *state)
        for state in zip(simulated.latent, simulated.velocity, strict=True)
    ]
    return Comparison(
        network=system.mechanics.network,
        step=step,
        full=_motion(system.mechanics, q, velocity),
        pointwise=_motion(system.mechanics, *pointwise),
        compressed=_motion(system.mechanics, *map(np.array, zip(*decoded, strict=True))),
    )


def _reconstructed(
    autoencoder: Autoencoder,
    configuration: Float[np.ndarray, 'frames n'],
    velocity: Float[np.ndarray, 'frames n'],
    progress: bool,
) -> tuple[np.ndarray, np.ndarray]:
    decoded = []
    guess: np.ndarray | None = None
    states = list(zip(configuration, velocity, strict=True))
    for q, q_dot in tqdm(states, desc='reconstructing', unit='frame', disable=not progress):
        guess, latent_velocity = autoencoder.encoder_jacobian_vector_product(q, q_dot, guess)
        decoded.append(_decoded(autoencoder, guess, latent_velocity))
    positions, velocities = zip(*decoded, strict=True)
    return np.array(positions), np.array(velocities)


def _decoded(
    autoencoder: Autoencoder,
    latent: Float[np.ndarray, ' m'],
    latent_velocity: Float[np.ndarray, ' m'],
) -> tuple[np.ndarray, np.ndarray]:
    configuration, jacobian = autoencoder.decode_with_jacobian(latent)
    return configuration, jacobian @ latent_velocity


def _motion(mechanics: Mechanics, configuration: np.ndarray, velocity: np.ndarray) -> Motion:
    return Motion(
        configuration,
        velocity,
        kinetic=np.array([mechanics.kinetic_energy(each) for each in velocity]),
        potential=np.array([mechanics.potential(each) for each in configuration]),
    )


def _mean_square(error: Float[np.ndarray, 'frames n']) -> Series:
    return np.mean(error**2, axis=1)
