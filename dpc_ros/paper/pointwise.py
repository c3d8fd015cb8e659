"""Reconstruction of configuration, velocity and energy over time, point by point (section IV)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from dpc_ros.autoencoder import Autoencoder
from dpc_ros.data import Dataset
from dpc_ros.data.conditions import test_conditions
from dpc_ros.data.dataset import TEST_STRIDE
from dpc_ros.data.simulations import STEP
from dpc_ros.network import Mechanics, load_network
from dpc_ros.paper.figure import COLOURS, new_figure, save_figure, tidy
from dpc_ros.paper.models import Workshop
from dpc_ros.paper.recipes import EXTENDED, FLAT, GRAPH, SYSTEMS

LATENT_SIZE = 5
_STRIDE = 5  # of the test frames
_MODELS = ((FLAT, 'network'), (GRAPH, 'network'), (EXTENDED, 'network'), (EXTENDED, 'projection'))
_QUANTITIES = {
    'configuration': ('MSE of q', 'm²'),
    'velocity': ('MSE of q̇', 'm²/s²'),
    'energy': ('squared error of the energy', 'J²'),
}


def measure(workshop: Workshop, systems: tuple[str, ...] = SYSTEMS) -> list[dict[str, Any]]:
    """Return one row for every system, model, encoder and time.

    Of each quantity the median and the 20th and 80th percentiles over the 28 test simulations:
    the mean square error of D(ξ) [m²] and of J ξ̇ [m²/s²], the squared error of kinetic plus
    potential energy [J²].
    """
    rows = []
    for system in systems:
        for model, encoder in tqdm(
            _MODELS, desc=f'reconstructing {system}', disable=not workshop.progress
        ):
            trained = workshop.trained(model, system, LATENT_SIZE)
            errors = _errors(system, workshop.dataset(system), trained.autoencoder(encoder))
            for k in range(errors['configuration'].shape[1]):
                row: dict[str, Any] = {
                    **trained.columns(encoder),
                    'time_s': k * _STRIDE * TEST_STRIDE * STEP,
                }
                for quantity, values in errors.items():
                    low, median, high = np.percentile(values[:, k], (20, 50, 80))
                    row[f'{quantity}_median'] = float(median)
                    row[f'{quantity}_20'], row[f'{quantity}_80'] = float(low), float(high)
                rows.append(row)
    return rows


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the medians over time with the 20th to 80th percentiles, a column each system."""
    systems = list(dict.fromkeys(row['system'] for row in rows))
    figure = new_figure(3.0 * len(systems), 8)
    panels = figure.subplots(
        len(_QUANTITIES), len(systems), sharex=True, sharey='row', squeeze=False
    )
    for column, system in zip(panels.T, systems, strict=True):
        column[0].set_title(f'system {system[-1]}')
        for model, encoder in _MODELS:
            wanted = {'system': system, 'model': model.name, 'encoder': encoder}
            chosen = [row for row in rows if wanted.items() <= row.items()]
            colour = COLOURS['projection' if encoder == 'projection' else model.name]
            label = f'{model.name}, projection' if encoder == 'projection' else model.name
            time = [row['time_s'] for row in chosen]
            for panel, quantity in zip(column, _QUANTITIES, strict=True):
                low, median, high = (
                    [row[f'{quantity}_{which}'] for row in chosen]
                    for which in ('20', 'median', '80')
                )
                panel.fill_between(time, low, high, color=colour, alpha=0.2, lw=0)
                panel.semilogy(time, median, color=colour, lw=1.3, label=label)
        column[-1].set_xlabel('time [s]')
    for panel, (name, unit) in zip(panels[:, 0], _QUANTITIES.values(), strict=True):
        panel.set_ylabel(f'{name} [{unit}]')
    for panel in panels.ravel():
        tidy(panel)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=4, frameon=False)
    save_figure(figure, path)


def _errors(
    system: str, dataset: Dataset, autoencoder: Autoencoder
) -> dict[str, Float[np.ndarray, 'simulations times']]:
    network = load_network(system)
    errors: dict[str, list[np.ndarray]] = {quantity: [] for quantity in _QUANTITIES}
    for condition in test_conditions():
        if condition.split != 'test':
            continue
        mechanics = Mechanics(network, condition.gravity)
        mine = dataset.test_simulation == condition.simulation
        states = zip(
            dataset.test[mine][::_STRIDE], dataset.test_velocity[mine][::_STRIDE], strict=True
        )
        found = [state_errors(mechanics, autoencoder, *state) for state in states]
        for quantity, values in zip(_QUANTITIES, np.transpose(found), strict=True):
            errors[quantity].append(values)
    return {quantity: np.stack(values) for quantity, values in errors.items()}


def state_errors(
    mechanics: Mechanics,
    autoencoder: Autoencoder,
    configuration: Float[np.ndarray, ' n'],
    velocity: Float[np.ndarray, ' n'],
) -> tuple[float, float, float]:
    """Return the errors of one state: of q [m²], of q̇ [m²/s²], of the energy [J²]."""
    latent, latent_velocity = autoencoder.encoder_jacobian_vector_product(configuration, velocity)
    decoded, jacobian = autoencoder.decode_with_jacobian(latent)
    decoded_velocity = jacobian @ latent_velocity
    energy = mechanics.total_energy(configuration, velocity)
    decoded_energy = mechanics.total_energy(decoded, decoded_velocity)
    return (
        float(np.mean((decoded - configuration) ** 2)),
        float(np.mean((decoded_velocity - velocity) ** 2)),
        (decoded_energy - energy) ** 2,
    )
