"""Figures: one look, saved whole or not at all. matplotlib is loaded when one is made."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dpc_ros.files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito: told apart by those who see no red or green, too.
COLOURS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9')
_RESOLUTION = 130  # dots per inch


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure; sizes in inch."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout='constrained')
    FigureCanvasAgg(figure)
    return figure


def tidy(panel: Axes) -> None:
    """Give a panel a light grid and no box."""
    panel.grid(color='#e3e3e3', lw=0.7)
    panel.set_axisbelow(True)
    panel.spines[['top', 'right']].set_visible(False)


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG."""
    with replacing(path) as partial:
        figure.savefig(partial, dpi=_RESOLUTION, format='png')
