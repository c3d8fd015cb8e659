"""Plots beside a scene: error, latents and their targets, force, energies over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from dpc_ros.figure import COLOURS
from dpc_ros.view.history import History

if TYPE_CHECKING:
    from viser import GuiApi, GuiUplotHandle, ViserServer
    from viser.uplot import Scale, Series

DRAWING_PERIOD = 0.2  # s between two drawings of the curves
_PANEL_WIDTH, _HEIGHT = 330, 170  # pixels, of the panel and of a plot
_MOST_POINTS = 400  # of a curve, more than the pixels that it has
_WIDTH, _DASH = 1.5, (5, 4)  # pixels
_NOTHING = (np.zeros(2), np.ones(2))  # uPlot draws no plot without a point


class Plots:
    """Curves of a history.

    Args:
        gui: of a viser server, within the panel that they are to stand in.
        latent_size: m.
        span: of the time that they show [s]; where left out, that of the history.
    """

    def __init__(
        self, gui: GuiApi, latent_size: int, span: tuple[float, float] | None = None
    ) -> None:
        self._gui = gui
        self._time_scale: Scale = {'time': False}
        if span is not None:
            self._time_scale['range'] = span
        self._nmse = self._add('log₁₀ nMSE [–]', ['log₁₀ nMSE'])
        latents = [subscripted('ξ', i) for i in range(latent_size)]
        self._latent = (
            self._add(
                'latent state ξ, dashed its target', latents, [f'{name} target' for name in latents]
            )
            if latents
            else None
        )
        self._force = self._add('force [N]', ['x', 'y'], legend=True)
        energies = ['kinetic', 'elastic', 'gravitational']
        self._energies = self._add('energy [J]', energies, legend=True)

    def show(self, history: History) -> None:
        """Draw what a history holds."""
        curves = history.curves()
        time = curves.time
        nmse = curves.nmse[:, np.newaxis]
        # Of a logarithmic axis uPlot rounds what is small to 0.
        self._nmse.data = _thinned(time, np.log10(np.where(nmse > 0, nmse, np.nan)))
        if self._latent is not None:
            self._latent.data = _thinned(time, np.hstack([curves.latent, curves.target_latent]))
        self._force.data = _thinned(time, curves.force)
        self._energies.data = _thinned(time, curves.energies)

    def _add(
        self,
        title: str,
        names: list[str],
        dashed: Sequence[str] = (),
        *,
        legend: bool = False,
    ) -> GuiUplotHandle:
        series: list[Series] = [{'label': 't [s]'}]
        for i, name in enumerate([*names, *dashed]):
            colour = COLOURS[i % len(names) % len(COLOURS)]
            series.append({'label': name, 'stroke': colour, 'width': _WIDTH})
            if name in dashed:
                series[-1]['dash'] = _DASH
        empty, one = _NOTHING
        return self._gui.add_uplot(
            data=(empty, *(one for _ in series[1:])),
            series=tuple(series),
            title=title,
            scales={'x': self._time_scale},
            height=_HEIGHT,
            legend={'show': legend, 'live': False},
        )


def add_plots(
    server: ViserServer, latent_size: int, span: tuple[float, float] | None = None
) -> Plots:
    """Return plots in a panel on the left; the controls go to the right. See `Plots`."""
    gui = server.gui
    panel = gui.add_panel()
    with panel.add_tab('Plots'):
        plots = Plots(gui, latent_size, span)
    panel.dock_left()
    panel.set_width(_PANEL_WIDTH)
    gui.main_panel.dock_right()
    return plots


def _thinned(
    time: Float[np.ndarray, ' frames'], values: Float[np.ndarray, 'frames curves']
) -> tuple[np.ndarray, ...]:
    """Return time and curves as uPlot takes them, without the times at which nothing is known."""
    known = np.flatnonzero(np.isfinite(values).any(axis=1))
    known = known[:: max(1, -(-len(known) // _MOST_POINTS))]
    if len(known) < 2:
        empty, one = _NOTHING
        return (empty, *(one for _ in values.T))
    return (time[known], *np.ascontiguousarray(values[known].T))


def subscripted(letter: str, number: int) -> str:
    """Return a letter with a number below the line."""
    return letter + str(number).translate(str.maketrans('0123456789', '₀₁₂₃₄₅₆₇₈₉'))
