"""Simulated configurations that autoencoders learn from and are measured on."""

from .conditions import Condition, extra_conditions, load_conditions
from .dataset import (
    Dataset,
    load_dataset,
    make_dataset,
    save_dataset,
)
from .simulations import simulate_condition, simulate_conditions
from .thinning import thin

__all__ = [
    'Condition',
    'Dataset',
    'extra_conditions',
    'load_conditions',
    'load_dataset',
    'make_dataset',
    'save_dataset',
    'simulate_condition',
    'simulate_conditions',
    'thin',
]
