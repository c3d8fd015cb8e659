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
from dpc_ros.network import MassSpringNetwork, Mechanics, Trajectory, load_network
from dpc_ros.paper import over_time
from dpc_ros.paper.models import Workshop
from dpc_ros.paper.recipes import EXTENDED, FLAT, GRAPH, OURS, POD, SYSTEMS, Model
from dpc_ros.reduction import CompressedSystem, DivergenceError
from dpc_ros.reduction.comparison import Comparison, compare
from dpc_ros.reduction.figure import animate, draw_energies, draw_frames

LATENT_SIZE = 5
STEP = 0.005  # s, of the compressed simulations: that of the full ones
STEPS = (0.1, 0.05, 0.02, 0.01)  # s, of which the longest stable one is sought
_STABILITY_STRIDE = 6  # of the test simulations in that search
_SLACK = 0.01  # of the energy's range, that a stable simulation's energy may rise by
_COURSE_STRIDE = 10  # of the frames in `reduced_time`
_MODELS: tuple[tuple[Model, str], ...] = (
    (FLAT, 'network'),
    (GRAPH, 'network'),
    (POD, 'network'),
    (OURS, 'projection'),
    (EXTENDED, 'projection'),
)
_SHOWN_SYSTEM, _SHOWN_SIMULATION = 'paper_2', 14  # from rest under the strongest gravity
_SHOWN_TIMES = (0.0, 0.4, 0.8, 1.2, 2.0, 4.0)  # s
_SHOWN = {'flat': FLAT, 'graph': GRAPH, 'POD': POD, 'ours': EXTENDED}
_ANIMATED = ('flat', 'ours')

Rows = list[dict[str, Any]]


def measure(workshop: Workshop, systems: tuple[str, ...] = SYSTEMS) -> dict[str, Rows]:
    """Return the rows of two files: each model's errors as a whole, and over time.

    `reduced` has one row for every system and model, over the 28 test simulations: the median of
    the relative error of q, of the one about rest, and of the root mean square error of the energy
    over its range; the largest relative error and the largest rise of the energy over its range;
    how many simulations diverged (their errors count as infinite, and what is infinite is null);
    the longest of `STEPS` at which every sixth simulation is stable, its energy not rising by
    more than a hundredth of its range. `reduced_time` has one row for every system, model and
    time, as `pointwise`, over as many simulations as did not diverge.
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
            name = f'{model.name} on {system}'
            bar = tqdm(simulations, desc=name, disable=not workshop.progress)
            autoencoder = trained.autoencoder(encoder)
            found = [compared(network, autoencoder, STEP, *simulation) for simulation in bar]
            stable = stable_step(network, autoencoder, simulations[::_STABILITY_STRIDE])
            numbers = [condition.simulation for condition, _ in simulations]
            whole.append({**columns, **summary(numbers, found), 'stable_step_s': stable})
            course += [{**columns, **row} for row in errors_over_time(found)]
    return {'reduced': whole, 'reduced_time': course}


def compared(
    network: MassSpringNetwork,
    autoencoder: Autoencoder,
    step: float,
    condition: Condition,
    trajectory: Trajectory,
) -> Comparison | None:
    """Return a simulation's comparison, or none where the compressed one diverged."""
    mechanics = Mechanics(network, condition.gravity)
    system = CompressedSystem(mechanics, autoencoder, int(network.mobile[0]))
    try:
        return compare(system, trajectory, step)
    except DivergenceError:
        return None


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
    network: MassSpringNetwork,
    autoencoder: Autoencoder,
    simulations: Sequence[tuple[Condition, Trajectory]],
) -> float:
    """Return the longest of `STEPS` [s] at which all simulations are stable; NaN if none is."""
    for step in STEPS:
        # One after the other, so that the first that is not stable ends the search.
        each = (compared(network, autoencoder, step, *simulation) for simulation in simulations)
        if all(one is not None and one.energy_increase <= _SLACK for one in each):
            return step
    return np.nan


def errors_over_time(found: Sequence[Comparison | None]) -> list[dict[str, float]]:
    """Return medians and percentiles at each time, over those that did not diverge."""
    whole = [each for each in found if each is not None]
    if not whole:
        return []
    errors = {
        'configuration': np.stack([each.configuration_error for each in whole]),
        'velocity': np.stack([each.velocity_error for each in whole]),
        'energy': np.stack([each.energy_error for each in whole]),
    }
    thinned = {name: values[:, ::_COURSE_STRIDE] for name, values in errors.items()}
    rows = over_time.percentile_rows(whole[0].time[::_COURSE_STRIDE], thinned)
    return [{'simulations': len(whole), **row} for row in rows]


def draw(workshop: Workshop, rows: Mapping[str, Rows], docs: Path) -> list[Path]:
    """Draw errors over time, and energies, frames and animation of one simulation.

    Raises:
        DivergenceError: a model diverges in the simulation that is shown.
    """
    names = ('reduced_mse.png', 'reduced_energy.png', 'reduced_frames.png', 'reduced.gif')
    errors, energies, frames, animation = (docs / name for name in names)
    over_time.draw(rows['reduced_time'], errors)
    network, encoders = load_network(_SHOWN_SYSTEM), dict(_MODELS)
    condition, trajectory = simulate_condition(network, _SHOWN_SIMULATION)
    mechanics = Mechanics(network, condition.gravity)
    comparisons = {}
    for name, model in _SHOWN.items():
        autoencoder = workshop.trained(model, _SHOWN_SYSTEM, LATENT_SIZE).autoencoder(
            encoders[model]
        )
        system = CompressedSystem(mechanics, autoencoder, int(network.mobile[0]))
        comparisons[name] = compare(system, trajectory, STEP)
    draw_energies(comparisons, energies)
    draw_frames(comparisons, _SHOWN_TIMES, frames)
    animated = {name: comparisons[name] for name in _ANIMATED}
    animate(animated, animation, progress=workshop.progress)
    return [errors, energies, frames, animation]


def _finite(value: float) -> float:
    return float(value) if np.isfinite(value) else np.nan
