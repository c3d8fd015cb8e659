"""`dpc paper …`: each experiment writes files in docs/results/ and draws its figures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from dpc_ros.paper import (
    bodies,
    compression,
    control,
    interpretability,
    mse_table,
    noise,
    over_time,
    pointwise,
    reduced,
    systems,
    tables,
)
from dpc_ros.paper.models import Workshop
from dpc_ros.paper.recipes import SYSTEMS
from dpc_ros.results import read_results, write_results

TRAINING_SEED = 0  # of every recipe


def run(experiment: str, workshop: Workshop, docs: Path) -> None:
    """Run one experiment, or make the tables of the pages, and a figure, from the results.

    Raises:
        ValueError: there is no such experiment, or a training can not be used.
    """
    if experiment == 'tables':
        for page in tables.write_tables(docs):
            print(f'page        {page}')
        figure = docs / 'bodies.png'
        bodies.draw(read_results(docs / 'results' / 'hosts.json'), figure)
        print(f'figure      {figure}')
        return
    if experiment not in EXPERIMENTS:
        raise ValueError(f'no experiment {experiment!r}: expected one of {NAMES}')
    if workshop.law and experiment != 'control':
        raise ValueError(f'--law: expected the experiment control, got {experiment!r}')
    # One thread a training: sums in another order would be another training.
    torch.set_num_threads(1)
    name = experiment.replace('-', '_')
    measure, seed, draw = EXPERIMENTS[experiment]
    measured = measure(workshop)
    for file, rows in (measured if isinstance(measured, dict) else {name: measured}).items():
        results = docs / 'results' / f'{file}.json'
        write_results(results, rows, seed=seed)
        print(f'results     {results}')
    for figure in draw(workshop, measured, docs):
        print(f'figure      {figure}')


def _mse_table(workshop: Workshop, rows: list[dict[str, Any]], docs: Path) -> list[Path]:
    path = docs / 'mse_table.png'
    mse_table.draw(rows, path)
    return [path]


def _compression(workshop: Workshop, rows: list[dict[str, Any]], docs: Path) -> list[Path]:
    curves, paths = docs / 'compression.png', docs / 'compression_paths.png'
    compression.draw(rows, curves)
    compression.draw_paths(workshop, paths)
    return [curves, paths]


def _noise(workshop: Workshop, rows: list[dict[str, Any]], docs: Path) -> list[Path]:
    path = docs / 'noise.png'
    noise.draw(rows, path)
    return [path]


def _systems(workshop: Workshop, rows: list[dict[str, Any]], docs: Path) -> list[Path]:
    path = docs / 'systems.png'
    systems.draw(rows, path)
    return [path]


def _interpretability(workshop: Workshop, rows: list[dict[str, Any]], docs: Path) -> list[Path]:
    paths = {system: docs / f'interpretability_{system[-1]}.png' for system in SYSTEMS}
    for system, path in paths.items():
        interpretability.draw(workshop, system, path)
    return list(paths.values())


def _pointwise(workshop: Workshop, rows: list[dict[str, Any]], docs: Path) -> list[Path]:
    path = docs / 'pointwise.png'
    over_time.draw(rows, path)
    return [path]


def _no_figure(workshop: Workshop, rows: list[dict[str, Any]], docs: Path) -> list[Path]:
    return []


_Measure = Callable[[Workshop], Any]  # the rows of one file, or of several by their names
_Draw = Callable[[Workshop, Any, Path], list[Path]]

EXPERIMENTS: dict[str, tuple[_Measure, int | None, _Draw]] = {
    'systems': (systems.measure, None, _systems),
    'mse-table': (mse_table.measure, TRAINING_SEED, _mse_table),
    'compression': (compression.measure, TRAINING_SEED, _compression),
    'noise': (noise.measure, noise.SEED, _noise),
    'interpretability': (interpretability.measure, TRAINING_SEED, _interpretability),
    'pointwise': (pointwise.measure, TRAINING_SEED, _pointwise),
    'reduced': (reduced.measure, TRAINING_SEED, reduced.draw),
    'control-tuning': (control.tune_gains, control.SEED, _no_figure),
    'control': (control.measure, control.SEED, control.draw),
}
NAMES = (*EXPERIMENTS, 'tables')
