"""Trajectories of a network under a list of conditions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from dpc_ros.data.conditions import Condition, test_conditions, training_conditions
from dpc_ros.network import Integrator, MassSpringNetwork, Mechanics, Trajectory, simulate

DURATION = 5.0  # s, of every simulation of the paper
STEP = 0.005  # s


def simulate_conditions(
    network: MassSpringNetwork,
    conditions: Sequence[Condition],
    duration: float = DURATION,
    step: float = STEP,
    method: str = 'rk4',
) -> Iterator[tuple[Condition, Trajectory]]:
    """Simulate the conditions in their order, without any input force.

    Args:
        network: the body.
        conditions: what to simulate; the first starts from rest.
        duration: of each simulation [s].
        step: of the integration [s].
        method: a key of `INTEGRATORS`.

    Yields:
        each condition with its trajectory of duration/step + 1 states.

    Raises:
        ValueError: a simulation diverges: the body is too stiff for the step.
    """
    steps = round(duration / step)
    at_rest = np.zeros(network.configuration_size)
    configuration, velocity = network.rest_configuration, at_rest
    for condition in conditions:
        if condition.start == 'rest':
            configuration, velocity = network.rest_configuration, at_rest
        elif condition.start == 'previous_end':
            velocity = at_rest
        integrator = Integrator(Mechanics(network, condition.gravity), step, method)
        trajectory = simulate(integrator, configuration, velocity, steps)
        configuration, velocity = trajectory.configuration[-1], trajectory.velocity[-1]
        if not (np.isfinite(configuration).all() and np.isfinite(velocity).all()):
            raise ValueError(
                f'simulation {condition.simulation} of {network.name} diverged at a step of '
                f'{step} s: is the body too stiff, or too strongly damped, for that step?'
            )
        yield condition, trajectory


def simulate_condition(network: MassSpringNetwork, number: int) -> tuple[Condition, Trajectory]:
    """Simulate one of the paper's conditions by its number, after those that it starts from.

    Raises:
        ValueError: no condition has that number, or a simulation diverges.
    """
    series = (training_conditions(), test_conditions())
    for conditions in series:
        numbers = [condition.simulation for condition in conditions]
        if number in numbers:
            at = numbers.index(number)
            starts = [i for i in range(at + 1) if conditions[i].start == 'rest']
            *_, last = simulate_conditions(network, conditions[starts[-1] : at + 1])
            return last
    known = sorted(condition.simulation for conditions in series for condition in conditions)
    raise ValueError(f'simulation {number}: expected one of {known[0]} to {known[-1]}')
