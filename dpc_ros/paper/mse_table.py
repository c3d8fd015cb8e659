"""Training, validation and test error of every model on every system (paper, section IV)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from dpc_ros.autoencoder import Autoencoder
from dpc_ros.autoencoder.encoders import ENCODERS
from dpc_ros.figure import new_figure, save_figure, tidy
from dpc_ros.paper.colours import COLOURS
from dpc_ros.paper.models import Trained, Workshop, in_batches
from dpc_ros.paper.published import best_test_mse, published_mse
from dpc_ros.paper.recipes import EXTENDED, FLAT, GRAPH, OURS, POD, SYSTEMS, Model

_PAPER_BATCH = 256  # frames over which the paper averages before it averages again
ROWS: tuple[tuple[Model, int, tuple[str, ...]], ...] = (
    (FLAT, 5, ('network',)),
    (GRAPH, 5, ('network',)),
    (POD, 5, ('network',)),
    (OURS, 5, ENCODERS),
    (EXTENDED, 5, ENCODERS),
    (FLAT, 3, ('network',)),
    (OURS, 3, ('network',)),
    (FLAT, 2, ('network',)),
    (OURS, 2, ('network',)),
)


def measure(workshop: Workshop, systems: tuple[str, ...] = SYSTEMS) -> list[dict[str, Any]]:
    """Return one row for every system, model, latent size and encoder; errors in m²."""
    rows = []
    for system in systems:
        trained = [(workshop.trained(model, system, m), encoders) for model, m, encoders in ROWS]
        each = [(model, encoder) for model, encoders in trained for encoder in encoders]
        for model, encoder in tqdm(each, desc=f'measuring {system}', disable=not workshop.progress):
            rows.append(_row(workshop, model, encoder))
    return rows


def _row(workshop: Workshop, trained: Trained, encoder: str) -> dict[str, Any]:
    dataset = workshop.dataset(trained.system)
    autoencoder = trained.autoencoder(encoder)
    train, validation, test = (
        _frame_errors(autoencoder, frames)
        for frames in (dataset.train, dataset.validation, dataset.test)
    )
    errors = {
        'train_mse': float(train.mean()),
        'validation_mse': float(validation.mean()),
        'test_mse': float(test.mean()),
        'train_mse_of_batches': _mean_of_batches(train),
        'validation_mse_of_batches': _mean_of_batches(validation),
    }
    name = trained.model.name
    published = (
        published_mse(trained.system, name, trained.latent_size)
        if name in ('flat', 'graph')
        else best_test_mse(trained.system, trained.latent_size)
    )
    return {
        **trained.columns(encoder),
        **errors,
        'paper_test_mse': published,
        'ratio_to_paper': None if published is None else errors['test_mse'] / published,
    }


def _frame_errors(
    autoencoder: Autoencoder, configurations: Float[np.ndarray, 'frames n']
) -> Float[np.ndarray, ' frames']:
    """Return the mean square error over coordinates of each frame [m²]."""
    difference = autoencoder.decode(autoencoder.encode(configurations)) - configurations
    return np.mean(difference**2, axis=1)


def _mean_of_batches(errors: Float[np.ndarray, ' frames']) -> float:
    """Return the paper's average: the mean over consecutive batches of the mean over each."""
    return float(np.mean([batch.mean() for batch in in_batches(errors, _PAPER_BATCH)]))


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the test errors at m = 5 side by side with the paper's."""
    figure = new_figure(10, 4.5)
    panel = figure.subplots()
    systems = list(dict.fromkeys(row['system'] for row in rows))
    bars = [
        ('flat', 'paper', 'network', 'flat', COLOURS['flat'], ''),
        ('graph', 'paper', 'network', 'graph', COLOURS['graph'], ''),
        ('pod', 'paper', 'network', 'POD', COLOURS['pod'], ''),
        ('ours', 'paper', 'network', 'ours', COLOURS['ours'], ''),
        ('ours', 'paper', 'projection', 'ours, projection', COLOURS['ours'], '///'),
        ('ours', 'extended', 'network', 'ours, more data', COLOURS['projection'], ''),
        ('ours', 'extended', 'projection', '… and projection', COLOURS['projection'], '///'),
    ]
    width = 0.8 / len(bars)
    for i, (model, data, encoder, label, colour, hatch) in enumerate(bars):
        values = [_find(rows, system, model, data, encoder) for system in systems]
        x = np.arange(len(systems)) + (i - (len(bars) - 1) / 2) * width
        heights = [row['test_mse'] for row in values]
        panel.bar(
            x, heights, 0.9 * width, label=label, color=colour, hatch=hatch, edgecolor='white', lw=0
        )
        if model in ('flat', 'graph'):
            published = [row['paper_test_mse'] for row in values]
            (line,) = panel.plot(x, published, '_', color=COLOURS['paper'], ms=12, mew=2)
            line.set_label('published' if i == 0 else '_')
    panel.set_yscale('log')
    panel.set_xticks(range(len(systems)), [f'system {name[-1]}' for name in systems])
    panel.set_ylabel('test MSE at m = 5 [m²]')
    panel.legend(
        ncols=4, frameon=False, fontsize='small', loc='upper center', bbox_to_anchor=(0.5, 1.2)
    )
    tidy(panel)
    save_figure(figure, path)


def _find(
    rows: list[dict[str, Any]], system: str, model: str, data: str, encoder: str
) -> dict[str, Any]:
    wanted = {
        'system': system,
        'model': model,
        'training_data': data,
        'encoder': encoder,
        'latent_size': 5,
    }
    return next(row for row in rows if wanted.items() <= row.items())
