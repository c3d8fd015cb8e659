"""Full, reconstructed and compressed motion as pictures: errors, energies, frames, animation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from dpc_ros.figure import new_figure, save_figure, tidy
from dpc_ros.files import replacing
from dpc_ros.network import draw_springs
from dpc_ros.reduction.comparison import Comparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito; what each motion is called and how it is drawn.
_FULL, _POINTWISE, _COMPRESSED = '#e69f00', '#d55e00', '#0072b2'
_MOTIONS = (
    ('full', 'simulated', _FULL, '-'),
    ('pointwise', 'reconstructed pointwise', _POINTWISE, ':'),
    ('compressed', 'compressed', _COMPRESSED, '--'),
)
_ENERGIES = ('kinetic', 'potential', 'total')
_MARGIN = 0.05  # of the body's larger side
_GIF_RESOLUTION = 80  # dots per inch
_GIF_COLOURS = 64
_PICTURE = 0.04  # s that one is shown


def draw_errors(comparison: Comparison, path: Path) -> None:
    """Draw the errors of q, q̇ and energy of the compressed motion over time."""
    figure = new_figure(9, 3)
    panels = figure.subplots(1, 3)
    for panel, errors, label in zip(
        panels,
        (comparison.configuration_error, comparison.velocity_error, comparison.energy_error),
        ('MSE of q [m²]', 'MSE of q̇ [m²/s²]', 'squared error of the energy [J²]'),
        strict=True,
    ):
        panel.semilogy(comparison.time, errors, color=_COMPRESSED, lw=1.3)
        panel.set(xlabel='time [s]', ylabel=label)
        tidy(panel)
    save_figure(figure, path)


def draw_energies(comparisons: Mapping[str, Comparison], path: Path) -> None:
    """Draw kinetic, potential and total energy of the three motions, a row each model."""
    figure = new_figure(10, 0.7 + 2.2 * len(comparisons))
    panels = figure.subplots(len(comparisons), 3, sharex=True, sharey='col', squeeze=False)
    for row, (name, comparison) in zip(panels, comparisons.items(), strict=True):
        for panel, energy in zip(row, _ENERGIES, strict=True):
            for motion, label, colour, style in _MOTIONS:
                values = getattr(getattr(comparison, motion), energy)
                width = 2.4 if motion == 'full' else 1.4
                panel.plot(comparison.time, values, style, color=colour, lw=width, label=label)
            tidy(panel)
        row[0].set_ylabel(f'{name}\nenergy [J]')
    for panel, energy in zip(panels[0], _ENERGIES, strict=True):
        panel.set_title(energy, fontsize='medium')
    for panel in panels[-1]:
        panel.set_xlabel('time [s]')
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=3, frameon=False)
    save_figure(figure, path)


def draw_frames(comparisons: Mapping[str, Comparison], times: Sequence[float], path: Path) -> None:
    """Draw the three bodies over one another at some times [s], a row each model."""
    low, high = _limits(list(comparisons.values()))
    width, height = 2.2, 2.2 * (high - low)[1] / (high - low)[0]
    figure = new_figure(width * len(times), 0.9 + (0.85 * height + 0.2) * len(comparisons))
    panels = figure.subplots(len(comparisons), len(times), sharex=True, sharey=True, squeeze=False)
    for row, (name, comparison) in zip(panels, comparisons.items(), strict=True):
        for panel, time in zip(row, times, strict=True):
            frame = int(np.argmin(np.abs(comparison.time - time)))
            _draw_bodies(panel, comparison, frame)
            panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect='equal')
            tidy(panel)
        row[0].set_ylabel(f'{name}\ny [m]', fontsize='small')
    for panel, time in zip(panels[0], times, strict=True):
        panel.set_title(f'{time:g} s', fontsize='medium')
    for panel in panels[-1]:
        panel.set_xlabel('x [m]')
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=3, frameon=False)
    save_figure(figure, path)


def animate(
    comparisons: Mapping[str, Comparison], path: Path, every: int = 0, progress: bool = False
) -> None:
    """Draw the three bodies moving in real time as GIF, a column each model.

    Args:
        comparisons: of one motion, at the same steps, by the model.
        path: GIF to write.
        every: frames of the motion per picture; about 25 pictures a second where it is zero.
        progress: show a progress bar.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    first = next(iter(comparisons.values()))
    low, high = _limits(list(comparisons.values()))
    width = max(4.0, 6.5 / len(comparisons))  # the legend's at least
    figure = new_figure(width * len(comparisons), 0.9 + 4 * (high - low)[1] / (high - low)[0])
    canvas = FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(comparisons), sharex=True, sharey=True, squeeze=False)[0]
    figure.set_dpi(_GIF_RESOLUTION)
    for panel, (name, comparison) in zip(panels, comparisons.items(), strict=True):
        _draw_bodies(panel, comparison, 0, animated=True)
        panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect='equal', xlabel='x [m]')
        panel.set_title(f'{name}, 0 s', animated=True)
        tidy(panel)
    panels[0].set_ylabel('y [m]')
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=3, frameon=False)
    canvas.draw()
    still = canvas.copy_from_bbox(figure.bbox)  # all but the bodies and the time
    pictures = []
    every = every or max(round(_PICTURE / first.step), 1)
    frames = range(0, len(first.time), every)
    for frame in tqdm(frames, desc='drawing', unit='picture', disable=not progress):
        canvas.restore_region(still)
        for panel, (name, comparison) in zip(panels, comparisons.items(), strict=True):
            panel.title.set_text(f'{name}, {first.time[frame]:.2f} s')
            for springs, (motion, *_) in zip(panel.collections, _MOTIONS, strict=True):
                configuration = getattr(comparison, motion).configuration[frame]
                position = comparison.network.positions(configuration)
                springs.set_segments(position[comparison.network.springs])
            for artist in (*panel.collections, panel.title):
                panel.draw_artist(artist)
        image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert('RGB')
        pictures.append(image.quantize(_GIF_COLOURS))
    with replacing(path) as partial:
        pictures[0].save(
            partial,
            format='GIF',
            save_all=True,
            append_images=pictures[1:],
            duration=round(1000 * every * first.step),
            loop=0,
        )


def _draw_bodies(panel: Axes, comparison: Comparison, frame: int, **style: Any) -> None:
    for motion, label, colour, _ in _MOTIONS:
        width = 1.6 if motion == 'full' else 0.6
        look = {'color': colour, 'lw': width, 'label': label, **style}
        configuration = getattr(comparison, motion).configuration[frame]
        draw_springs(comparison.network, panel, configuration, **look)


def _limits(comparisons: Sequence[Comparison]) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of what holds all simulated bodies."""
    fixed = comparisons[0].network.rest_position
    places = [each.full.configuration.reshape(-1, 2) for each in comparisons]
    every = np.concatenate([fixed[comparisons[0].network.fixed], *places])
    low, high = every.min(axis=0), every.max(axis=0)
    margin = _MARGIN * (high - low).max()
    return low - margin, high + margin
