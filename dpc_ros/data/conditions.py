"""Conditions of the paper's simulations: the gravity of each and where it starts from."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dpc_ros.network import Gravity
from dpc_ros.resources import config_path

SPLITS = ('train', 'validation', 'test', 'outside')
_FIRST_RANDOM = 1001  # number of the first random simulation
STARTS = ('rest', 'continue', 'previous_end')


@dataclass(frozen=True)
class Condition:
    """One simulation: number, part of the data that it belongs to, gravity, start.

    Attributes:
        simulation: its number.
        split: `train`, `validation`, `test` or `outside` (a test beyond the training range, which
            is simulated because the next one starts from its end, but is not measured on).
        gravity: the field over the whole simulation.
        start: `rest`; `continue`, from the last state of the one before, velocity included; or
            `previous_end`, from its last position, at rest.
    """

    simulation: int
    split: str
    gravity: Gravity
    start: str


def load_conditions(path: str | Path) -> list[Condition]:
    """Read conditions from a CSV file in the form of `config/systems/*_conditions.csv`.

    Raises:
        ValueError: a column is missing, a value can't be read, or a split or start is unknown.
    """
    conditions = []
    with Path(path).open(newline='') as file:
        for line, row in enumerate(csv.DictReader(file), start=2):
            try:
                conditions.append(_condition(row))
            except (KeyError, TypeError, ValueError) as error:
                raise ValueError(f'{path}, line {line}: {error!r} in {dict(row)}') from error
    if not conditions or conditions[0].start != 'rest':
        raise ValueError(f'{path}: expected at least one condition, the first starting from rest')
    return conditions


def training_conditions() -> list[Condition]:
    """Return the paper's simulations 1–5 (training) and 6–7 (validation)."""
    return load_conditions(config_path('systems', 'training_conditions.csv'))


def test_conditions() -> list[Condition]:
    """Return the paper's test simulations, the 28 measured ones with split `test`."""
    return load_conditions(config_path('systems', 'test_conditions.csv'))


test_conditions.__test__ = False  # type: ignore[attr-defined]  # pytest takes it for a test


def random_conditions(training: int, validation: int, seed: int = 0) -> list[Condition]:
    """Return simulations under gravities drawn from the range that the paper tests in.

    Uniform in 3 to 17 m/s² and in −3π/4 to −π/4 (section A.1). Every fourth starts from rest, the
    others from the last position of the one before. None is one of the paper's.

    Args:
        training: how many train.
        validation: how many validate.
        seed: of the draw.
    """
    draw = np.random.default_rng(seed)
    conditions = []
    for k in range(training + validation):
        gravity = Gravity(float(draw.uniform(3.0, 17.0)), float(draw.uniform(-0.75, -0.25) * np.pi))
        split = 'train' if k < training else 'validation'
        start = 'previous_end' if k % 4 else 'rest'
        conditions.append(Condition(_FIRST_RANDOM + k, split, gravity, start))
    return conditions


def extra_conditions(training: int) -> list[Condition]:
    """Return simulations under random gravity that stand beside the paper's in training.

    For every eight that train there is one more that validates.
    """
    return random_conditions(training, -(-training // 8))


def _condition(row: dict[str, str]) -> Condition:
    split = row['split'] if 'split' in row else ('outside', 'test')[int(row['in_paper_28'])]
    if split not in SPLITS:
        raise ValueError(f'split {split!r}: expected one of {SPLITS}')
    if row['start'] not in STARTS:
        raise ValueError(f'start {row["start"]!r}: expected one of {STARTS}')
    gravity = Gravity(float(row['gravity_m_s2']), float(row['angle_rad']))
    return Condition(int(row['simulation']), split, gravity, row['start'])
