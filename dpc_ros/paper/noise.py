"""Reconstruction of the true configuration from a noisy one (paper, section A.3)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from dpc_ros.autoencoder.encoders import ENCODERS
from dpc_ros.figure import new_figure, save_figure, tidy
from dpc_ros.paper.colours import COLOURS
from dpc_ros.paper.models import Workshop
from dpc_ros.paper.published import NOISE, NOISE_DEVIATIONS
from dpc_ros.paper.recipes import EXTENDED, FLAT, GRAPH, OURS, SYSTEMS

SEED = 0
LATENT_SIZE = 5
_STRIDE = 10  # of the test frames
_MODELS = (
    (FLAT, ('network',)),
    (GRAPH, ('network',)),
    (OURS, ENCODERS),
    (EXTENDED, ENCODERS),
)


def measure(workshop: Workshop, systems: tuple[str, ...] = SYSTEMS) -> list[dict[str, Any]]:
    """Return one row for every system, model, encoder and σ; errors of D(E(q + ε)) against q [m²].

    Each tenth frame of the test simulations is taken, under the same noise for every model.
    `projected_noise` is σ²m/n, what an orthogonal projection onto m dimensions leaves of the noise.
    """
    rows = []
    for system in systems:
        frames = workshop.dataset(system).test[::_STRIDE]
        draw_noise = np.random.default_rng(SEED)
        noise = draw_noise.standard_normal(frames.shape)
        each = [(model, encoder) for model, encoders in _MODELS for encoder in encoders]
        for model, encoder in tqdm(each, desc=f'noise on {system}', disable=not workshop.progress):
            trained = workshop.trained(model, system, LATENT_SIZE)
            autoencoder = trained.autoencoder(encoder)
            published = NOISE.get((system, model.name), (None,) * len(NOISE_DEVIATIONS))
            for sigma, paper in zip(NOISE_DEVIATIONS, published, strict=True):
                decoded = autoencoder.decode(autoencoder.encode(frames + sigma * noise))
                rows.append(
                    {
                        **trained.columns(encoder),
                        'sigma_m': sigma,
                        'frames': len(frames),
                        'test_mse': float(np.mean((decoded - frames) ** 2)),
                        'projected_noise': sigma**2 * LATENT_SIZE / frames.shape[1],
                        'paper_test_mse': paper,
                    }
                )
    return rows


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw error over σ, one panel a system, the published values dotted."""
    systems = list(dict.fromkeys(row['system'] for row in rows))
    figure = new_figure(3.0 * len(systems), 4.0)
    panels = np.atleast_1d(figure.subplots(1, len(systems), sharey=True))
    curves = (
        ('flat', 'paper', 'network', 'flat', COLOURS['flat'], 'o-'),
        ('graph', 'paper', 'network', 'graph', COLOURS['graph'], 'o-'),
        ('ours', 'extended', 'network', 'ours, more data', COLOURS['ours'], 'o-'),
        ('ours', 'extended', 'projection', '… and projection', COLOURS['projection'], 's-'),
    )
    for panel, system in zip(panels, systems, strict=True):
        for model, data, encoder, label, colour, style in curves:
            wanted = {'system': system, 'model': model, 'training_data': data, 'encoder': encoder}
            chosen = [row for row in rows if wanted.items() <= row.items()]
            sigma = [row['sigma_m'] for row in chosen]
            errors = [row['test_mse'] for row in chosen]
            panel.loglog(sigma, errors, style, color=colour, ms=4, lw=1.3, label=label)
            if model != 'ours':
                published = [row['paper_test_mse'] for row in chosen]
                panel.loglog(sigma, published, ':', color=colour, label=f'{label}, published')
        left = [row['projected_noise'] for row in chosen]
        panel.loglog(sigma, left, '--', color=COLOURS['paper'], lw=1, label='σ²m/n')
        panel.set(title=f'system {system[-1]}', xlabel='noise σ [m]')
        tidy(panel)
    panels[0].set_ylabel('MSE against the true configuration [m²]')
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=4, frameon=False)
    save_figure(figure, path)
