"""Trajectories of a network under a list of conditions."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np

from dpc_ros.data.conditions import Condition, test_conditions, training_conditions
from dpc_ros.network import (
    Integrator,
    MassSpringNetwork,
    Mechanics,
    Trajectory,
    simulate_many,
)

DURATION = 5.0  # s, of every simulation of the paper
STEP = 0.005  # s
_MOST_BESIDE = 16  # series simulated at once
_MOST_MEMORY = 5e8  # bytes of their trajectories, which are kept meanwhile


def simulate_conditions(
    network: MassSpringNetwork,
    conditions: Sequence[Condition],
    duration: float = DURATION,
    step: float = STEP,
    method: str = 'rk4',
) -> Iterator[tuple[Condition, Trajectory]]:
    """Simulate the conditions, without any input force; they come in their order.

    Those that start from rest begin series that don't depend on each other: several of them run
    side by side, on all cores.

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
    series: list[list[Condition]] = []
    for condition in conditions:
        if condition.start == 'rest' or not series:
            series.append([])
        series[-1].append(condition)
    longest = max(map(len, series), default=1)
    memory = longest * 16 * (steps + 1) * network.configuration_size  # of the states of a series
    count = max(1, min(_MOST_BESIDE, int(_MOST_MEMORY / memory)))
    for begin in range(0, len(series), count):
        beside = series[begin : begin + count]
        found = _simulate_series(network, beside, steps, step, method)
        yield from zip(chain(*beside), chain(*found), strict=True)


def _simulate_series(
    network: MassSpringNetwork,
    series: Sequence[Sequence[Condition]],
    steps: int,
    step: float,
    method: str,
) -> list[list[Trajectory]]:
    """Simulate the first conditions of all series at once, then their second ones, and so on."""
    found: list[list[Trajectory]] = [[] for _ in series]
    cores = len(os.sched_getaffinity(0))
    for place in range(max(map(len, series))):
        running = [k for k, conditions in enumerate(series) if place < len(conditions)]
        integrators, starts = [], []
        for k in running:
            condition = series[k][place]
            integrators.append(Integrator(Mechanics(network, condition.gravity), step, method))
            starts.append(_start(network, condition, found[k]))
        configurations, velocities = (np.array(part) for part in zip(*starts, strict=True))
        trajectories = simulate_many(integrators, configurations, velocities, steps, threads=cores)
        for k, trajectory in zip(running, trajectories, strict=True):
            if not np.isfinite([trajectory.configuration[-1], trajectory.velocity[-1]]).all():
                raise ValueError(
                    f'simulation {series[k][place].simulation} of {network.name} diverged at a '
                    f'step of {step} s: is the body too stiff, or too strongly damped, for it?'
                )
            found[k].append(trajectory)
    return found


def _start(
    network: MassSpringNetwork, condition: Condition, before: list[Trajectory]
) -> tuple[np.ndarray, np.ndarray]:
    at_rest = np.zeros(network.configuration_size)
    if not before:
        return network.rest_configuration, at_rest
    velocity = before[-1].velocity[-1] if condition.start == 'continue' else at_rest
    return before[-1].configuration[-1], velocity


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
