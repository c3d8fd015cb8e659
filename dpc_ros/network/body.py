"""A body that moves: its state, advanced step by step under the force on one mass."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from dpc_ros.network.integration import Integrator


class Body:
    """The state (q, q̇) of a network with one actuated mass.

    Args:
        integrator: the network, its gravity and its time step.
        actuated_mass: number of the mass that carries the control force.
        configuration: q at the start [m], rest where left out.
        velocity: q̇ at the start [m/s], zero where left out.

    Raises:
        NetworkError: the actuated mass does not exist or is fixed.
        ValueError: the start is one of another body.
    """

    def __init__(
        self,
        integrator: Integrator,
        actuated_mass: int,
        configuration: Float[np.ndarray, ' n'] | None = None,
        velocity: Float[np.ndarray, ' n'] | None = None,
    ) -> None:
        self.integrator = integrator
        self.network = integrator.mechanics.network
        self.actuated_mass = actuated_mass
        self._place = 2 * self.network.mobile_index(actuated_mass)
        rest = self.network.rest_configuration
        self._start = (
            rest if configuration is None else configuration,
            np.zeros_like(rest) if velocity is None else velocity,
        )
        for name, value in zip(('configuration', 'velocity'), self._start, strict=True):
            if value.shape != rest.shape:
                raise ValueError(f'{name}: expected {rest.size} values, got {value.size}')
        self.reset()

    def reset(self) -> None:
        """Go back to the start."""
        self.configuration, self.velocity = self._start

    def advance(
        self,
        control_force: Float[np.ndarray, ' 2'],
        external_forces: dict[int, Float[np.ndarray, ' 2']] | None = None,
    ) -> None:
        """Move on by one time step, all forces held over it.

        Args:
            control_force: u on the actuated mass [N].
            external_forces: forces on other masses by their number [N].
        """
        force = np.zeros(self.network.configuration_size)
        for mass, push in (external_forces or {}).items():
            place = 2 * self.network.mobile_index(mass)
            force[place : place + 2] += push
        force[self._place : self._place + 2] += control_force
        self.configuration, self.velocity = self.integrator.advance(
            self.configuration, self.velocity, force
        )
