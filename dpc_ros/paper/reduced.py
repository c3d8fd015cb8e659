"""Simulation of the compressed system beside the full one (paper, section IV)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from dpc_ros.autoencoder import Autoencoder
from dpc_ros.data import Condition, simulate_condition, simulate_conditions
from dpc_ros.data.conditions import test_conditions
from dpc_ros.network import Mechanics, Trajectory, load_network
from dpc_ros.paper import over_time
from dpc_ros.paper.models import Trained, Workshop
from dpc_ros.paper.recipes import EXTENDED, FLAT, GRAPH, POD, SYSTEMS, Model
from dpc_ros.reduction import CompressedSystem, DivergenceError, simulate_compressed
from dpc_ros.reduction.comparison import Comparison, compare
from dpc_ros.reduction.figure import animate, draw_energies, draw_frames

LATENT_SIZE = 5
STEP = 0.02  # s, of the compressed simulations
STEPS = (0.1, 0.05, 0.02, 0.01)  # s, of which the longest stable one is sought
_STABILITY_STRIDE = 6  # of the test simulations in that search
_SLACK = 0.01  # of the energy's range, that a stable simulation's energy may rise above its start
_MODELS: tuple[tuple[Model, str], ...] = (
    (FLAT, 'network'),
    (GRAPH, 'network'),
    (POD, 'network'),
    (EXTENDED, 'projection'),
)
_SHOWN_SYSTEM, _SHOWN_SIMULATION = 'paper_2', 14  # from rest under the strongest gravity
_SHOWN_TIMES = (0.0, 0.4, 0.8, 1.2, 2.0, 4.0)  # s
_ANIMATED = ('flat', 'ours')

Rows = list[dict[str, Any]]


def measure(workshop: Workshop, systems: tuple[str, ...] = SYSTEMS) -> dict[str, Rows]:
    """Return the rows of two files: each model's errors as a whole, and over time.

    `reduced` has one row for every system and model, over the 28 test simulations: the median of
    the relative error of q, of the one about rest, and of the root mean square error of the energy
    over its range; the largest relative error and the largest rise of the energy between two
    frames, over its range; how many simulations diverged (their errors count as infinite, and
    what is infinite is null); the longest of `STEPS` at which every sixth simulation is stable.
    `reduced_time` has one row for every system, model and time, as `pointwise`.
    """
    whole, course = [], []
    for system in systems:
        network = load_network(system)
        simulations = [
            (condition, trajectory)
            for condition, trajectory in simulate_conditions(network, test_conditions())
            if condition.split == 'test'
        ]
        for model, encoder in _MODELS:
            trained = workshop.trained(model, system, LATENT_SIZE)
            columns = {**trained.columns(encoder), 'step_s': STEP}
            bar = tqdm(simulations, desc=f'{model.name} on {system}', disable=not workshop.progress)
            autoencoder = trained.autoencoder(encoder)
            found = [_compared(trained, autoencoder, *simulation) for simulation in bar]
            stable = stable_step(trained, autoencoder, simulations[::_STABILITY_STRIDE])
            numbers = [condition.simulation for condition, _ in simulations]
            whole.append({**columns, **summary(numbers, found), 'stable_step_s': stable})
            course += [{**columns, **row} for row in _course(found)]
    return {'reduced': whole, 'reduced_time': course}


def summary(numbers: Sequence[int], found: Sequence[Comparison | None]) -> dict[str, Any]:
    """Return the columns of one model's comparisons; none stands for one that diverged."""
    errors = [np.inf if each is None else each.relative_error for each in found]
    about_rest = [np.inf if each is None else each.relative_error_about_rest for each in found]
    energy = [np.inf if each is None else each.relative_energy_error for each in found]
    increase = [np.inf if each is None else each.energy_increase for each in found]
    return {
        'simulations': len(found),
        'diverged': sum(each is None for each in found),
        'relative_error_median': _finite(np.median(errors)),
        'relative_error_about_rest_median': _finite(np.median(about_rest)),
        'relative_error_max': _finite(np.max(errors)),
        'relative_error_max_simulation': numbers[int(np.argmax(errors))],
        'energy_error_median': _finite(np.median(energy)),
        'energy_increase_max': _finite(np.max(increase)),
    }


def stable_step(
    trained: Trained,
    autoencoder: Autoencoder,
    simulations: Sequence[tuple[Condition, Trajectory]],
) -> float:
    """Return the longest of `STEPS` [s] at which all simulations are stable; NaN if none is.

    A simulation is stable when its energy, which can only fall, stays below its start.
    """
    for step in STEPS:
        if all(_is_stable(trained, autoencoder, step, *each) for each in simulations):
            return step
    return np.nan


def draw(workshop: Workshop, rows: Mapping[str, Rows], docs: Path) -> list[Path]:
    """Draw errors over time, and energies, frames and animation of one simulation."""
    names = ('reduced_mse.png', 'reduced_energy.png', 'reduced_frames.png', 'reduced.gif')
    errors, energies, frames, animation = (docs / name for name in names)
    over_time.draw(rows['reduced_time'], errors)
    simulation = simulate_condition(load_network(_SHOWN_SYSTEM), _SHOWN_SIMULATION)
    comparisons = {}
    for model, encoder in _MODELS:
        trained = workshop.trained(model, _SHOWN_SYSTEM, LATENT_SIZE)
        comparison = _compared(trained, trained.autoencoder(encoder), *simulation)
        if comparison is not None:
            comparisons[model.name] = comparison
    draw_energies(comparisons, energies)
    draw_frames(comparisons, _SHOWN_TIMES, frames)
    animated = {name: each for name, each in comparisons.items() if name in _ANIMATED}
    animate(animated, animation, progress=workshop.progress)
    return [errors, energies, frames, animation]


def _compared(
    trained: Trained, autoencoder: Autoencoder, condition: Condition, trajectory: Trajectory
) -> Comparison | None:
    """Return the comparison, or none where the compressed simulation diverged.

    One that is still finite has diverged, too, where its energy rises by more than the full range.
    """
    try:
        comparison = compare(_system(trained, autoencoder, condition), trajectory, STEP)
    except DivergenceError:
        return None
    return comparison if comparison.energy_increase <= 1.0 else None


def _is_stable(
    trained: Trained,
    autoencoder: Autoencoder,
    step: float,
    condition: Condition,
    trajectory: Trajectory,
) -> bool:
    system = _system(trained, autoencoder, condition)
    start = autoencoder.encoder_jacobian_vector_product(
        trajectory.configuration[0], trajectory.velocity[0]
    )
    steps = round(trajectory.time[-1] / step)
    try:
        simulated = simulate_compressed(system, *start, step, steps)
    except DivergenceError:
        return False
    states = zip(simulated.latent, simulated.velocity, strict=True)
    energy = np.array([system.total_energy(*state) for state in states])
    return bool(energy.max() - energy[0] <= _SLACK * (energy[0] - energy.min()))


def _system(trained: Trained, autoencoder: Autoencoder, condition: Condition) -> CompressedSystem:
    network = load_network(trained.system)
    mechanics = Mechanics(network, condition.gravity)
    return CompressedSystem(mechanics, autoencoder, int(network.mobile[0]))


def _course(found: Sequence[Comparison | None]) -> list[dict[str, float]]:
    whole = [each for each in found if each is not None]
    if not whole:
        return []
    errors = {
        'configuration': np.stack([each.configuration_error for each in whole]),
        'velocity': np.stack([each.velocity_error for each in whole]),
        'energy': np.stack([each.energy_error for each in whole]),
    }
    return over_time.percentile_rows(whole[0].time, errors)


def _finite(value: float) -> float:
    return float(value) if np.isfinite(value) else np.nan
