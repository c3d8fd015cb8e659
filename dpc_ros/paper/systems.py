"""The five systems at rest (paper, figure of section IV)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dpc_ros.figure import new_figure, save_figure
from dpc_ros.network import draw_network, load_network
from dpc_ros.paper.models import Workshop
from dpc_ros.paper.recipes import SYSTEMS

_MARGIN = 0.3  # m


def measure(workshop: Workshop, systems: tuple[str, ...] = SYSTEMS) -> list[dict[str, Any]]:
    """Return one row for every system: what it is made of, and its extent [m]."""
    rows = []
    for system in systems:
        network = load_network(system)
        width, height = np.ptp(network.rest_position, axis=0)
        rows.append(
            {
                'system': system,
                'network': network.identifier,
                'mobile_masses': len(network.mobile),
                'fixed_masses': len(network.fixed),
                'springs': len(network.springs),
                'width_m': float(width),
                'height_m': float(height),
            }
        )
    return rows


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the systems side by side, to one scale."""
    networks = [load_network(row['system']) for row in rows]
    low = min(network.rest_position[:, 1].min() for network in networks) - _MARGIN
    high = max(network.rest_position[:, 1].max() for network in networks) + _MARGIN
    widths = [row['width_m'] + 2 * _MARGIN for row in rows]
    figure = new_figure(14, 14 * (high - low) / sum(widths) + 1.2)  # titles and labels
    panels = np.atleast_1d(figure.subplots(1, len(rows), width_ratios=widths))
    for panel, network, row in zip(panels, networks, rows, strict=True):
        draw_network(network, panel, label_every=0, legend=False)
        x = network.rest_position[:, 0]
        panel.set(xlim=(x.min() - _MARGIN, x.max() + _MARGIN), ylim=(low, high))
        panel.set_title(f'system {row["system"][-1]}')
    for panel in panels[1:]:
        panel.set_ylabel('')
        panel.tick_params(labelleft=False)
    save_figure(figure, path)
