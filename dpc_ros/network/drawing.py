"""A network as a picture: its springs, its masses, and what holds it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from dpc_ros.figure import new_figure, save_figure, tidy
from dpc_ros.network.mass_spring_network import MassSpringNetwork

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LONGER_SIDE, _LEGEND = 8.0, 2.0  # inch
_MARGIN = 0.05  # of the body's longer side
_NARROWEST = 0.4  # of the body's longer side
_SMALLEST = 0.1  # m, of a body without extent
_LABELS = 20  # mass numbers in a picture, about
_SPRING, _MOBILE, _FIXED, _DARK = '#8a8a8a', '#0072b2', '#d55e00', '#222222'


def draw_network(
    network: MassSpringNetwork,
    axes: Axes,
    configuration: Float[np.ndarray, ' n'] | None = None,
    *,
    label_every: int | None = None,
    legend: bool = True,
) -> None:
    """Draw springs, mobile and fixed masses with some of their numbers, to scale in metres.

    Args:
        network: the body.
        axes: of a matplotlib figure.
        configuration: q to draw it in [m], at rest where left out.
        label_every: number the masses 0, k, 2k, …; about twenty of them where left out, none at 0.
        legend: explain the markers.

    Raises:
        NetworkError: the configuration is not one of this network, or not finite.
    """
    # Half a second to import, which nobody who only simulates need wait for.
    from matplotlib.patheffects import withStroke

    position = _position(network, configuration)
    label = f'springs ({len(network.springs)})'
    draw_springs(network, axes, configuration, color=_SPRING, lw=0.7, label=label)
    size = float(np.clip(40 / np.sqrt(len(position)), 1.5, 6.0))  # points
    for masses, colour, marker, scale, label in (
        (network.mobile, _MOBILE, 'o', 1.0, f'mobile masses ({len(network.mobile)})'),
        (network.fixed, _FIXED, 's', 1.6, f'fixed masses ({len(network.fixed)})'),
    ):
        x, y = position[masses].T
        axes.plot(x, y, marker, color=colour, ms=scale * size, mew=0, label=label, zorder=3)
    every = _label_step(len(position)) if label_every is None else label_every
    for mass in range(0, len(position), every) if every else ():
        axes.annotate(
            str(mass),
            position[mass],
            xytext=(3, 3),
            textcoords='offset points',
            fontsize='x-small',
            color=_DARK,
            path_effects=[withStroke(linewidth=1.5, foreground='white')],
            zorder=4,
        )
    low, high = picture_limits(position)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel='x [m]', ylabel='y [m]')
    axes.set_aspect('equal')
    tidy(axes)
    if legend:
        axes.legend(loc='upper left', bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize='small')


def draw_springs(
    network: MassSpringNetwork,
    axes: Axes,
    configuration: Float[np.ndarray, ' n'] | None = None,
    **style: Any,
) -> None:
    """Draw the springs only.

    Args:
        network: the body.
        axes: of a matplotlib figure.
        configuration: q to draw it in [m], at rest where left out.
        style: of a matplotlib `LineCollection`: color, lw, label, …

    Raises:
        NetworkError: the configuration is not one of this network, or not finite.
    """
    from matplotlib.collections import LineCollection

    position = _position(network, configuration)
    axes.add_collection(LineCollection(list(position[network.springs]), **style))


def draw_figure(
    network: MassSpringNetwork,
    path: str | Path,
    configuration: Float[np.ndarray, ' n'] | None = None,
) -> None:
    """Draw a network on its own and save it as PNG.

    Raises:
        NetworkError: the configuration is not one of this network, or not finite.
        OSError: the file can't be written.
    """
    low, high = picture_limits(_position(network, configuration))
    size = _LONGER_SIDE * (high - low) / (high - low).max()
    figure = new_figure(size[0] + _LEGEND, size[1])
    axes = figure.subplots()
    draw_network(network, axes, configuration)
    axes.set_title(network.identifier, loc='left')
    save_figure(figure, path)


def _position(network: MassSpringNetwork, configuration: np.ndarray | None) -> np.ndarray:
    return network.rest_position if configuration is None else network.positions(configuration)


def picture_limits(
    position: Float[np.ndarray, 'masses 2'],
) -> tuple[Float[np.ndarray, ' 2'], Float[np.ndarray, ' 2']]:
    """Return lower left and upper right corner of a picture that has masses well inside it [m]."""
    low, high = position.min(axis=0), position.max(axis=0)
    longer = max((high - low).max(), _SMALLEST)
    half = np.maximum(0.5 * (high - low) + _MARGIN * longer, 0.5 * _NARROWEST * longer)
    centre = 0.5 * (low + high)
    return centre - half, centre + half


def _label_step(masses: int) -> int:
    """Return the smallest of 1, 2, 5, 10, 20, 50, … that leaves about twenty labels."""
    steps = (factor * 10**power for power in range(20) for factor in (1, 2, 5))
    return next(step for step in steps if masses <= step * _LABELS * 1.5)
