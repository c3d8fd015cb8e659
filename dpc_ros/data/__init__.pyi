"""Simulated configurations that autoencoders learn from and are measured on."""

from dpc_ros.data.conditions import Condition, extra_conditions, load_conditions
from dpc_ros.data.dataset import (
    Dataset,
    load_dataset,
    make_dataset,
    save_dataset,
)
from dpc_ros.data.simulations import simulate_condition, simulate_conditions
from dpc_ros.data.thinning import thin

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
