"""The convergence of a run as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dpc_ros.bag.convergence import Convergence
from dpc_ros.bag.convergence_table import describe_target
from dpc_ros.figure import COLOURS, new_figure, save_figure, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE = (10.0, 10.0)  # inch
_DARK, _GREY = '#222222', '#8a8a8a'
_LARGEST_LEGEND = 8  # curves


def draw(convergence: Convergence, path: str | Path) -> None:
    """Draw nMSE, latents, force and energies over time and save them as PNG.

    The second panel shows the latent error where it is known, else the latent coordinates.
    """
    figure = new_figure(*_SIZE)
    nmse, latent, force, energy = figure.subplots(4, 1, sharex=True)
    _draw_nmse(nmse, convergence)
    _draw_latent(latent, convergence)
    _draw_force(force, convergence)
    _draw_energy(energy, convergence)
    for panel in (nmse, latent, force, energy):
        _finish(panel)
    if convergence.target_time > 0:
        for panel in (latent, force, energy):
            panel.axvline(convergence.target_time, color=_DARK, lw=1)
    energy.set_xlabel('time since the first configuration [s]')
    energy.set_xlim(0, convergence.time[-1] or 1.0)
    figure.align_ylabels()
    _title(figure, convergence)
    save_figure(figure, path)


def _draw_nmse(panel: Axes, convergence: Convergence) -> None:
    panel.set_ylabel('nMSE [–]')
    shown = np.isfinite(convergence.nmse) & (convergence.nmse > 0)
    if not shown.any():
        return _say(panel, 'no target in force')
    panel.set_yscale('log')
    panel.plot(convergence.time[shown], convergence.nmse[shown], color=COLOURS[0], lw=1.6)
    if convergence.final_nmse > 0 and np.isfinite(convergence.final_nmse):
        label = f'final {convergence.final_nmse:.3g}'
        panel.axhline(convergence.final_nmse, color=_GREY, lw=1, ls='--', label=label)
    if np.isfinite(convergence.settling_time):
        label = f'settled at {convergence.settling_time:.3g} s'
        panel.axvline(convergence.settling_time, color=COLOURS[2], lw=1.2, ls=':', label=label)
    if convergence.target_time > 0:
        label = f'last target from {convergence.target_time:.3g} s'
        panel.axvline(convergence.target_time, color=_DARK, lw=1, label=label)
    return _legend(panel)


def _draw_latent(panel: Axes, convergence: Convergence) -> None:
    error, latent = convergence.latent_error, convergence.run.latent
    if error is not None and np.isfinite(error).any():
        panel.set_ylabel('latent error [–]')
        panel.plot(convergence.latent_time, error, color=COLOURS[0], lw=1.6, label='|ξ − ξ̄|')
        panel.set_ylim(bottom=0)
    elif len(latent):
        panel.set_ylabel('latent state ξ [–]')
        for i, coordinate in enumerate(latent.T):
            panel.plot(
                convergence.latent_time,
                coordinate,
                color=COLOURS[i % len(COLOURS)],
                lw=1.3,
                label=f'ξ{_subscript(i)}',
            )
    else:
        panel.set_ylabel('latent state ξ [–]')
        return _say(panel, 'no latent state in the log')
    return _legend(panel)


def _draw_force(panel: Axes, convergence: Convergence) -> None:
    panel.set_ylabel('force u [N]')
    if not len(convergence.force):
        return _say(panel, 'no control force in the log')
    time, held = convergence.force_time, 'steps-post'
    for i, axis in enumerate('xy'):
        component, label = convergence.force[:, i], f'$u_{axis}$'
        panel.plot(time, component, color=COLOURS[i], label=label, drawstyle=held, lw=1.3)
    norm = convergence.force_norm
    panel.plot(time, norm, color=_GREY, label='|u|', drawstyle=held, lw=1.3, zorder=1)
    return _legend(panel)


def _draw_energy(panel: Axes, convergence: Convergence) -> None:
    panel.set_ylabel('energy [J]')
    energy = convergence.energy
    if energy is None:
        return _say(panel, 'the mechanics was not given')
    curves = {
        'kinetic': energy.kinetic,
        'elastic': energy.elastic,
        'gravitational': energy.gravitational,
    }
    for colour, (name, values) in zip(COLOURS, curves.items(), strict=False):
        panel.plot(convergence.time, values, color=colour, lw=1.3, label=name)
    panel.plot(convergence.time, energy.total, color=_DARK, lw=1.6, label='total', zorder=1)
    return _legend(panel)


def _finish(panel: Axes) -> None:
    tidy(panel)
    panel.margins(y=0.08)


def _legend(panel: Axes) -> None:
    handles, labels = panel.get_legend_handles_labels()
    if 0 < len(handles) <= _LARGEST_LEGEND:
        panel.legend(
            handles,
            labels,
            loc='upper left',
            bbox_to_anchor=(1.005, 1.02),
            frameon=False,
            fontsize='medium',
        )


def _say(panel: Axes, text: str) -> None:
    panel.text(0.5, 0.5, text, transform=panel.transAxes, ha='center', va='center', color=_GREY)
    panel.set_yticks([])


def _title(figure: Figure, convergence: Convergence) -> None:
    run = convergence.run
    outcome = 'failed' if convergence.failed else f'final nMSE {convergence.final_nmse:.3g}'
    if convergence.target is None:
        outcome = 'no target'
    checkpoint = run.autoencoder_identifier or 'no checkpoint'
    figure.suptitle(
        f'{run.network_identifier or "unnamed network"}  ·  {checkpoint}\n'
        f'target: {describe_target(convergence)}  ·  {outcome}',
        fontsize='large',
    )


def _subscript(number: int) -> str:
    return str(number).translate(str.maketrans('0123456789', '₀₁₂₃₄₅₆₇₈₉'))
