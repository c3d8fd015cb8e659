"""How far the state can be compressed: test error by latent size (paper, section IV)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from dpc_ros.autoencoder.training import reconstruction_mse
from dpc_ros.figure import new_figure, save_figure, tidy
from dpc_ros.network import load_network
from dpc_ros.paper.colours import COLOURS
from dpc_ros.paper.models import Workshop
from dpc_ros.paper.published import published_mse, published_mse_by_size
from dpc_ros.paper.recipes import FLAT, GRAPH, OURS, POD, SYSTEMS, Model

_WHOLE_RANGE = tuple(range(1, 9))
_SYSTEM = 'paper_2'  # measured at every latent size
_MASSES = (204, 162, 100)  # whose paths are drawn
_SIMULATION = 14  # of the test: from rest under the strongest gravity
_SHOWN_SIZES = (1, 2, 3, 5)


def latent_sizes(model: Model, system: str) -> tuple[int, ...]:
    """Return the latent sizes at which a model is trained on a system."""
    if system == _SYSTEM:
        return (2, 3, 5) if model is GRAPH else _WHOLE_RANGE
    return (5,) if model is GRAPH else (2, 3, 5)


def measure(workshop: Workshop, systems: tuple[str, ...] = SYSTEMS) -> list[dict[str, Any]]:
    """Return one row for every system, model and latent size; errors in m²."""
    rows = []
    for system in systems:
        each = [
            (model, m) for model in (FLAT, GRAPH, POD, OURS) for m in latent_sizes(model, system)
        ]
        for model, m in tqdm(each, desc=f'measuring {system}', disable=not workshop.progress):
            trained = workshop.trained(model, system, m)
            test = workshop.dataset(system).test
            rows.append(
                {
                    **trained.columns(),
                    'validation_mse': trained.checkpoint.provenance['scores']['validation_mse'],
                    'test_mse': reconstruction_mse(trained.autoencoder(), test),
                    'paper_test_mse': published_mse(system, model.name, m),
                }
            )
    return rows


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw test error over latent size, one panel a system, the published values as crosses."""
    systems = list(dict.fromkeys(row['system'] for row in rows))
    figure = new_figure(3.0 * len(systems), 3.8)
    panels = np.atleast_1d(figure.subplots(1, len(systems), sharey=True))
    for panel, system in zip(panels, systems, strict=True):
        for name in ('flat', 'graph', 'pod', 'ours'):
            chosen = [row for row in rows if (row['system'], row['model']) == (system, name)]
            sizes = [row['latent_size'] for row in chosen]
            errors = [row['test_mse'] for row in chosen]
            panel.plot(sizes, errors, 'o-', color=COLOURS[name], ms=4, lw=1.3, label=name)
            published = sorted(published_mse_by_size(system, name).items())
            label = f'{name}, published'
            if published:
                panel.plot(*zip(*published, strict=True), 'x', color=COLOURS[name], label=label)
        panel.set(title=f'system {system[-1]}', xlabel='latent size m', yscale='log')
        panel.set_xticks(_WHOLE_RANGE)
        tidy(panel)
    panels[0].set_ylabel('test MSE [m²]')
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=6, frameon=False)
    save_figure(figure, path)


def draw_paths(workshop: Workshop, path: Path) -> None:
    """Draw the paths of a few masses in one test simulation, by latent size."""
    network, dataset = load_network(_SYSTEM), workshop.dataset(_SYSTEM)
    frames = dataset.test[dataset.test_simulation == _SIMULATION]
    figure = new_figure(3.2 * len(_SHOWN_SIZES), 4.8)
    panels = figure.subplots(2, len(_SHOWN_SIZES), sharex=True, sharey=True)
    for model, row in zip((FLAT, OURS), panels, strict=True):
        for m, panel in zip(_SHOWN_SIZES, row, strict=True):
            autoencoder = workshop.trained(model, _SYSTEM, m).autoencoder()
            decoded = autoencoder.decode(autoencoder.encode(frames))
            for mass in _MASSES:
                i = 2 * network.mobile_index(mass)
                true = panel.plot(*frames[:, i : i + 2].T, color=COLOURS['paper'], lw=2.2)
                ours = panel.plot(*decoded[:, i : i + 2].T, color=COLOURS[model.name], lw=1.0)
                panel.annotate(f'mass {mass}', frames[0, i : i + 2], fontsize='x-small')
            panel.set_title(f'{model.name}, m = {m}', fontsize='medium')
            panel.set_aspect('equal')
            tidy(panel)
    for panel in panels[-1]:
        panel.set_xlabel('x [m]')
    for panel in panels[:, 0]:
        panel.set_ylabel('y [m]')
    labels = ['simulated', 'reconstructed']
    figure.legend([true[0], ours[0]], labels, loc='outside upper center', ncols=2, frameon=False)
    save_figure(figure, path)
