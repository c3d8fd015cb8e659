"""Figure of many bodies on one domain: what they cost, as the tests across hosts measured it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dpc_ros.figure import COLOURS, new_figure, save_figure, tidy

_PANELS = {
    'processor time of all nodes [cores]': {'cores': ''},
    'round trip [ms]': {'round_trip_p50_ms': 'median', 'round_trip_p99_ms': 'p99'},
    'a newcomer knows all nodes after [s]': {'discovery_s': ''},
}


def of_bodies(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows of docs/results/hosts.json that are about numbers of bodies, by number."""
    return sorted((row for row in rows if 'bodies' in row), key=lambda row: row['bodies'])


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw a panel for each quantity over the number of bodies."""
    rows = of_bodies(rows)
    bodies = [row['bodies'] for row in rows]
    figure = new_figure(3.2 * len(_PANELS), 3.0)
    for panel, (name, series) in zip(
        figure.subplots(1, len(_PANELS)), _PANELS.items(), strict=True
    ):
        for colour, (key, label) in zip(COLOURS, series.items(), strict=False):
            panel.plot(bodies, [row[key] for row in rows], 'o-', color=colour, label=label)
        panel.set_title(name, fontsize='medium')
        panel.set_xscale('log', base=2)
        panel.set_xticks(bodies, [f'{each:g}' for each in bodies])
        panel.set_xlabel('bodies')
        panel.set_ylim(bottom=0.0)
        if len(series) > 1:
            panel.legend(frameon=False)
        tidy(panel)
    save_figure(figure, path)
