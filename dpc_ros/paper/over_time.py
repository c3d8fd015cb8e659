"""Errors over time: medians and percentiles over the test simulations, and their figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dpc_ros.figure import new_figure, save_figure, tidy
from dpc_ros.paper.colours import COLOURS

QUANTITIES = {
    'configuration': ('MSE of q', 'm²'),
    'velocity': ('MSE of q̇', 'm²/s²'),
    'energy': ('squared error of the energy', 'J²'),
}


def percentile_rows(
    time: Float[np.ndarray, ' times'], errors: Mapping[str, Float[np.ndarray, 'simulations times']]
) -> list[dict[str, float]]:
    """Return one row for every time: of each quantity the median, and what 20 and 80 % are below.

    Args:
        time: of each column [s].
        errors: of every quantity, squared, over simulations and times.
    """
    rows = []
    for k, seconds in enumerate(time):
        row = {'time_s': float(seconds)}
        for quantity, values in errors.items():
            low, median, high = np.percentile(values[:, k], (20, 50, 80))
            row[f'{quantity}_median'] = float(median)
            row[f'{quantity}_20'], row[f'{quantity}_80'] = float(low), float(high)
        rows.append(row)
    return rows


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw medians with the 20th to 80th percentiles over time, a column each system."""
    systems = list(dict.fromkeys(row['system'] for row in rows))
    keys = ('model', 'encoder', 'training_data')
    models = list(dict.fromkeys(tuple(row[key] for key in keys) for row in rows))
    figure = new_figure(3.0 * len(systems), 8)
    panels = figure.subplots(
        len(QUANTITIES), len(systems), sharex=True, sharey='row', squeeze=False
    )
    for column, system in zip(panels.T, systems, strict=True):
        column[0].set_title(f'system {system[-1]}')
        for variant in models:
            wanted = {'system': system, **dict(zip(keys, variant, strict=True))}
            chosen = [row for row in rows if wanted.items() <= row.items()]
            colour, label = _appearance(variant, models)
            time = [row['time_s'] for row in chosen]
            for panel, quantity in zip(column, QUANTITIES, strict=True):
                low, median, high = (
                    [row[f'{quantity}_{which}'] for row in chosen]
                    for which in ('20', 'median', '80')
                )
                panel.fill_between(time, low, high, color=colour, alpha=0.2, lw=0)
                panel.semilogy(time, median, color=colour, lw=1.3, label=label)
        column[-1].set_xlabel('time [s]')
    for panel, (name, unit) in zip(panels[:, 0], QUANTITIES.values(), strict=True):
        panel.set_ylabel(f'{name} [{unit}]')
    for panel in panels.ravel():
        tidy(panel)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=4, frameon=False)
    save_figure(figure, path)


_Variant = tuple[str, str, str]  # model, encoder, training data


def _appearance(variant: _Variant, every: Sequence[_Variant]) -> tuple[str, str]:
    """Return colour and label of a variant; the second one of a model has a colour of its own."""
    model, encoder, data = variant
    of_model = [each for each in every if each[0] == model]
    colour = COLOURS['projection' if of_model.index(variant) else model]
    label = model + (', projection' if encoder == 'projection' else '')
    several_data = len({each[2] for each in of_model}) > 1
    return colour, label + (', more data' if several_data and data == 'extended' else '')
