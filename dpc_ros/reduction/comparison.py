"""The compressed simulation of a motion beside the body's own, and the errors between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from dpc_ros.network import MassSpringNetwork, Mechanics, Trajectory
from dpc_ros.reduction.compressed_system import CompressedSystem
from dpc_ros.reduction.simulation import DivergenceError, check_method, simulate_compressed

_CHUNK = 100  # frames that are decoded at a time
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
        system: the compressed system.
        step: time between two frames [s].
        full: the body's own motion.
        compressed: what the compressed system makes of the first frame, D(ξ(t)) and Jξ̇(t).
    """

    system: CompressedSystem
    step: float
    full: Motion
    compressed: Motion

    @property
    def network(self) -> MassSpringNetwork:
        """The body."""
        return self.system.mechanics.network

    @cached_property
    def pointwise(self) -> Motion:
        """Each frame of the body's motion encoded and decoded, D(E(q)) and JJ_E q̇ (section IV)."""
        autoencoder = self.system.autoencoder
        latents, velocities = [], []
        guess: np.ndarray | None = None
        for state in zip(self.full.configuration, self.full.velocity, strict=True):
            guess, velocity = autoencoder.encoder_jacobian_vector_product(*state, guess)
            latents.append(guess)
            velocities.append(velocity)
        return _decoded(self.system, np.array(latents), np.array(velocities))

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
        """Largest rise of the compressed energy above an earlier frame's, over the energy's range.

        Without input force the energy can only fall: it is the integrator's.
        """
        energy = self.compressed.total
        return float((energy - np.minimum.accumulate(energy)).max() / np.ptp(self.full.total))

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
        progress: show a progress bar.

    Raises:
        ValueError: there is no such method, the step is no multiple of the motion's, or the motion
            is shorter than it.
        DivergenceError: the compressed simulation diverges: its energy rises by more than the range
            of the body's.
    """
    check_method(method)
    stride = step / trajectory.step if np.isfinite(step) else 0.0
    if not (stride > 0.5 and np.isclose(stride, round(stride), rtol=1e-9)):
        raise ValueError(f'step {step:g} s: expected a multiple of {trajectory.step:g} s')
    if stride >= len(trajectory.configuration):
        raise ValueError(f'step {step:g} s: expected one shorter than the motion')
    frames = slice(None, None, round(stride))
    full = _motion(system.mechanics, trajectory.configuration[frames], trajectory.velocity[frames])
    start = system.autoencoder.encoder_jacobian_vector_product(
        full.configuration[0], full.velocity[0]
    )
    steps = len(full.configuration) - 1
    simulated = simulate_compressed(system, *start, step, steps, method=method, progress=progress)
    with np.errstate(all='ignore'):  # what diverges is told below
        compressed = _decoded(system, simulated.latent, simulated.velocity)
        comparison = Comparison(system, step, full, compressed)
        if not comparison.energy_increase <= 1.0:
            raise DivergenceError(
                f'the compressed simulation diverged with steps of {step:g} s: its energy, which '
                'can only fall, rises by more than its range; take shorter steps'
            )
    return comparison


def _decoded(
    system: CompressedSystem,
    latent: Float[np.ndarray, 'frames m'],
    latent_velocity: Float[np.ndarray, 'frames m'],
) -> Motion:
    parts = []
    for start in range(0, len(latent), _CHUNK):
        part = slice(start, start + _CHUNK)
        configuration, jacobian = system.autoencoder.decode_with_jacobian(latent[part])
        velocity = np.einsum('kia,ka->ki', jacobian, latent_velocity[part])
        parts.append((configuration, velocity))
    return _motion(system.mechanics, *map(np.concatenate, zip(*parts, strict=True)))


def _motion(mechanics: Mechanics, configuration: np.ndarray, velocity: np.ndarray) -> Motion:
    return Motion(
        configuration,
        velocity,
        kinetic=np.array([mechanics.kinetic_energy(each) for each in velocity]),
        potential=np.array([mechanics.potential(each) for each in configuration]),
    )


def _mean_square(error: Float[np.ndarray, 'frames n']) -> Series:
    return np.mean(error**2, axis=1)
