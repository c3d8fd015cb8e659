"""What each latent variable does: configurations with one of them altered (paper, section A.4)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from dpc_ros.data import Dataset
from dpc_ros.figure import new_figure, save_figure
from dpc_ros.network import MassSpringNetwork, draw_springs, load_network
from dpc_ros.paper.models import Workshop
from dpc_ros.paper.recipes import FLAT, SYSTEMS

LATENT_SIZE = 2
CHANGES = (-0.21, -0.14, -0.07, 0.07, 0.14, 0.21)  # of the variable's range


def measure(workshop: Workshop, systems: tuple[str, ...] = SYSTEMS) -> list[dict[str, Any]]:
    """Return one row for every system, configuration, variable and change.

    How far the decoded body moves from the unaltered one [m], in the mean square over its masses
    and at most, and the mean over masses of the direction that it moves in.
    """
    rows = []
    for system in tqdm(systems, desc='altering latents', disable=not workshop.progress):
        for name, variable, change, reference, altered in _alterations(workshop, system):
            moved = (altered - reference).reshape(-1, 2)
            distance = np.linalg.norm(moved, axis=1)
            rows.append(
                {
                    'system': system,
                    'model': FLAT.name,
                    'latent_size': LATENT_SIZE,
                    'configuration': name,
                    'variable': variable,
                    'change_of_range': change,
                    'displacement_rms_m': float(np.sqrt(np.mean(distance**2))),
                    'displacement_max_m': float(distance.max()),
                    'mean_displacement_x_m': float(moved[:, 0].mean()),
                    'mean_displacement_y_m': float(moved[:, 1].mean()),
                }
            )
    return rows


def draw(workshop: Workshop, system: str, path: Path) -> None:
    """Draw the altered configurations of one system, a column each configuration."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    network = load_network(system)
    colours = [to_hex(colormaps['coolwarm'](value)) for value in (0.0, 0.15, 0.3, 0.7, 0.85, 1.0)]
    names = list(special_configurations(network, workshop.dataset(system)))
    figure = new_figure(3.2 * len(names), 5.4)
    panels = figure.subplots(LATENT_SIZE, len(names), sharex=True, sharey=True)
    for name, variable, change, reference, altered in _alterations(workshop, system):
        panel = panels[variable, names.index(name)]
        label = f'{change:+.0%}'
        colour = colours[CHANGES.index(change)]
        draw_springs(network, panel, altered, color=colour, lw=0.5, label=label)
        if change == CHANGES[-1]:
            style = {'color': '#e69f00', 'lw': 0.9, 'label': 'decoded, unaltered'}
            draw_springs(network, panel, reference, **style)
            panel.set_title(f'{name}, ξ{"₀₁"[variable]}', fontsize='medium')
            panel.set_aspect('equal')
            panel.autoscale_view()
    for panel in panels[-1]:
        panel.set_xlabel('x [m]')
    for panel in panels[:, 0]:
        panel.set_ylabel('y [m]')
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=7, frameon=False)
    save_figure(figure, path)


def special_configurations(
    network: MassSpringNetwork, dataset: Dataset
) -> dict[str, Float[np.ndarray, ' n']]:
    """Return the body at rest, and farthest to the left, to the right and down."""
    frames = np.concatenate([dataset.train, dataset.validation])
    centre = frames.reshape(len(frames), -1, 2).mean(axis=1)
    return {
        'rest': network.rest_configuration,
        'left': frames[np.argmin(centre[:, 0])],
        'right': frames[np.argmax(centre[:, 0])],
        'down': frames[np.argmin(centre[:, 1])],
    }


def _alterations(workshop: Workshop, system: str) -> list[tuple]:
    """Return name, variable, change, unaltered and altered decoded configuration of each."""
    network, dataset = load_network(system), workshop.dataset(system)
    autoencoder = workshop.trained(FLAT, system, LATENT_SIZE).autoencoder()
    every = np.concatenate([dataset.train, dataset.validation, dataset.test])
    extent = np.ptp(autoencoder.encode(every), axis=0)
    alterations = []
    for name, configuration in special_configurations(network, dataset).items():
        latent = autoencoder.encode(configuration)
        reference = autoencoder.decode(latent)
        for variable in range(LATENT_SIZE):
            for change in CHANGES:
                altered = latent.copy()
                altered[variable] += change * extent[variable]
                decoded = autoencoder.decode(altered)
                alterations.append((name, variable, change, reference, decoded))
    return alterations
