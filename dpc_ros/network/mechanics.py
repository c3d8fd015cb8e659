"""Mechanics of a network: energies, forces, damping, input field of M q̈ = −∇V − C(q) q̇ + G u."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dpc_ros.network import kernels
from dpc_ros.network.mass_spring_network import MassSpringNetwork


@dataclass(frozen=True)
class Gravity:
    """A constant gravitational field; the force on a mass is m·magnitude·(cos angle, sin angle).

    Attributes:
        magnitude: |g| [m/s²], ≥ 0.
        angle: θ [rad], measured from the x axis; −π/2 is down.

    Raises:
        ValueError: a value is not finite, or the magnitude is negative.
    """

    magnitude: float = 0.0
    angle: float = -math.pi / 2

    def __post_init__(self) -> None:
        finite = math.isfinite(self.magnitude) and math.isfinite(self.angle)
        if not (finite and self.magnitude >= 0):
            raise ValueError(
                f'gravity: expected a finite magnitude ≥ 0 and a finite angle, got {self}'
            )

    @property
    def vector(self) -> Float[np.ndarray, ' 2']:
        """The field as a vector [m/s²]."""
        return self.magnitude * np.array([math.cos(self.angle), math.sin(self.angle)])


NO_GRAVITY = Gravity()


class Mechanics:
    """Forces and energies of a network in a field of gravity, compiled.

    The full-order system is M q̈ = −∇V(q) − C(q) q̇ + G u + f_ext with
    V(q) = Σ ½k(|d| − l)² + ½k_s Σ |d − c d⁰|² − Σ m g·x (paper, section A.1, with the background
    term of its data). C is Bᵀ diag(d) B where damping is isotropic (the paper's data) and
    Σ d n nᵀ along the springs where it is axial (the paper's text).

    Args:
        network: the body.
        gravity: the field it stands in.
    """

    def __init__(self, network: MassSpringNetwork, gravity: Gravity = NO_GRAVITY) -> None:
        self.network = network
        self.gravity = gravity
        self.gravity_vector = gravity.vector
        order = np.concatenate([network.mobile, network.fixed])
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        first, second = network.springs.T
        rest_vector = network.rest_position[first] - network.rest_position[second]
        background = network.background_rest_fraction * rest_vector.T
        self.arrays = kernels.NetworkArrays(
            first=place[first],
            second=place[second],
            stiffness=network.stiffness,
            rest_length=network.rest_length,
            damping=network.damping,
            background_vector=np.ascontiguousarray(background),
            background_stiffness=float(network.background_stiffness),
            mobile_mass=network.mass[network.mobile],
            fixed_position=network.rest_position[network.fixed],
            axial=network.damping_kind == 'axial',
        )
        self.mass_diagonal: Float[np.ndarray, ' n'] = np.repeat(self.arrays.mobile_mass, 2)

    @property
    def configuration_size(self) -> int:
        """Return n, the number of mobile coordinates."""
        return self.network.configuration_size

    def elastic_energy(self, configuration: Float[np.ndarray, ' n']) -> float:
        """Return the energy of springs and background term [J]."""
        return kernels.elastic_energy(self.arrays, configuration)

    def gravitational_energy(self, configuration: Float[np.ndarray, ' n']) -> float:
        """Return −Σ m g·x [J]."""
        return kernels.gravitational_energy(self.arrays, self.gravity_vector, configuration)

    def potential(self, configuration: Float[np.ndarray, ' n']) -> float:
        """Return V(q) [J]."""
        return self.elastic_energy(configuration) + self.gravitational_energy(configuration)

    def kinetic_energy(self, velocity: Float[np.ndarray, ' n']) -> float:
        """Return ½ q̇ᵀMq̇ [J]."""
        return kernels.kinetic_energy(self.arrays, velocity)

    def total_energy(
        self, configuration: Float[np.ndarray, ' n'], velocity: Float[np.ndarray, ' n']
    ) -> float:
        """Return the Hamiltonian ½ q̇ᵀMq̇ + V(q) [J] (paper, equation 3)."""
        return self.potential(configuration) + self.kinetic_energy(velocity)

    def potential_gradient(self, configuration: Float[np.ndarray, ' n']) -> Float[np.ndarray, ' n']:
        """Return ∇V(q) [N]."""
        return kernels.potential_gradient(self.arrays, self.gravity_vector, configuration)

    def potential_hessian(self, configuration: Float[np.ndarray, ' n']) -> Float[np.ndarray, 'n n']:
        """Return ∇²V(q) [N/m], dense."""
        return kernels.potential_hessian(self.arrays, configuration)

    def damping_force(
        self, configuration: Float[np.ndarray, ' n'], velocity: Float[np.ndarray, ' n']
    ) -> Float[np.ndarray, ' n']:
        """Return C(q) q̇ [N]."""
        return kernels.damping_force(self.arrays, configuration, velocity)

    def damping_matrix(self, configuration: Float[np.ndarray, ' n']) -> Float[np.ndarray, 'n n']:
        """Return C(q) [N·s/m], dense; the same for every q where damping is isotropic."""
        return kernels.damping_matrix(self.arrays, configuration)

    def input_field(self, mass: int) -> Float[np.ndarray, 'n 2']:
        """Return G, the matrix that puts a planar force on one mobile mass.

        Raises:
            NetworkError: the mass does not exist or is fixed.
        """
        place = 2 * self.network.mobile_index(mass)
        field = np.zeros((self.configuration_size, 2))
        field[place, 0] = field[place + 1, 1] = 1.0
        return field

    def acceleration(
        self,
        configuration: Float[np.ndarray, ' n'],
        velocity: Float[np.ndarray, ' n'],
        force: Float[np.ndarray, ' n'],
    ) -> Float[np.ndarray, ' n']:
        """Return q̈ = M⁻¹(−∇V − C(q) q̇ + f) [m/s²] under an external force f [N]."""
        return kernels.acceleration(
            self.arrays, self.gravity_vector, configuration, velocity, force
        )
