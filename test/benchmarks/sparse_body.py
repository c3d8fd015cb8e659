"""The body's right-hand side as a user writes it with numpy and scipy.sparse."""

import numpy as np
from scipy.sparse import csr_array


class SparseBody:
    """Accelerations of a network with axial damping and k_s = 0, by its incidence matrix."""

    def __init__(self, network, gravity):
        springs, masses = len(network.springs), len(network.mass)
        each = np.repeat(np.arange(springs), 2)
        signs = np.tile([1.0, -1.0], springs)
        incidence = csr_array((signs, (each, network.springs.ravel())), shape=(springs, masses))
        self.incidence = incidence[:, network.mobile]
        self.transposed = self.incidence.T.tocsr()
        self.held = incidence[:, network.fixed] @ network.rest_position[network.fixed]
        self.stiffness, self.rest_length = network.stiffness, network.rest_length
        self.damping = network.damping
        self.mass = network.mass[network.mobile][:, None]
        self.gravity = gravity.vector

    def acceleration(self, configuration, velocity):
        d = self.incidence @ configuration.reshape(-1, 2) + self.held
        rate = self.incidence @ velocity.reshape(-1, 2)
        square = np.einsum('ij,ij->i', d, d)
        along = self.damping * np.einsum('ij,ij->i', d, rate) / square
        along += self.stiffness * (1.0 - self.rest_length / np.sqrt(square))
        force = self.transposed @ (along[:, None] * d)
        return (self.gravity - force / self.mass).ravel()

    def slope(self, _, state):
        """Return the right-hand side of first order for `solve_ivp`."""
        configuration, velocity = np.split(state, 2)
        return np.concatenate([velocity, self.acceleration(configuration, velocity)])

    def rk4_step(self, state, step):
        one = self.slope(0.0, state)
        two = self.slope(0.0, state + 0.5 * step * one)
        three = self.slope(0.0, state + 0.5 * step * two)
        four = self.slope(0.0, state + step * three)
        return state + step / 6.0 * (one + 2.0 * two + 2.0 * three + four)
