"""Reconstruction of configuration, velocity and energy over time, point by point (section IV)."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from dpc_ros.autoencoder import Autoencoder
from dpc_ros.data import Dataset
from dpc_ros.data.conditions import test_conditions
from dpc_ros.data.dataset import TEST_STRIDE
from dpc_ros.data.simulations import STEP
from dpc_ros.network import Mechanics, load_network
from dpc_ros.paper.models import Workshop
from dpc_ros.paper.over_time import QUANTITIES, percentile_rows
from dpc_ros.paper.recipes import EXTENDED, FLAT, GRAPH, SYSTEMS

LATENT_SIZE = 5
_STRIDE = 5  # of the test frames
_MODELS = ((FLAT, 'network'), (GRAPH, 'network'), (EXTENDED, 'network'), (EXTENDED, 'projection'))


def measure(workshop: Workshop, systems: tuple[str, ...] = SYSTEMS) -> list[dict[str, Any]]:
    """Return one row for every system, model, encoder and time.

    Of each quantity the median and the 20th and 80th percentiles over the 28 test simulations:
    the mean square error of D(ξ) [m²] and of J ξ̇ [m²/s²], the squared error of kinetic plus
    potential energy [J²].
    """
    rows = []
    for system in systems:
        for model, encoder in tqdm(
            _MODELS, desc=f'reconstructing {system}', disable=not workshop.progress
        ):
            trained = workshop.trained(model, system, LATENT_SIZE)
            errors = _errors(system, workshop.dataset(system), trained.autoencoder(encoder))
            time = _STRIDE * TEST_STRIDE * STEP * np.arange(errors['configuration'].shape[1])
            rows += [{**trained.columns(encoder), **row} for row in percentile_rows(time, errors)]
    return rows


def _errors(
    system: str, dataset: Dataset, autoencoder: Autoencoder
) -> dict[str, Float[np.ndarray, 'simulations times']]:
    network = load_network(system)
    errors: dict[str, list[np.ndarray]] = {quantity: [] for quantity in QUANTITIES}
    for condition in test_conditions():
        if condition.split != 'test':
            continue
        mechanics = Mechanics(network, condition.gravity)
        mine = dataset.test_simulation == condition.simulation
        states = zip(
            dataset.test[mine][::_STRIDE], dataset.test_velocity[mine][::_STRIDE], strict=True
        )
        found = [state_errors(mechanics, autoencoder, *state) for state in states]
        for quantity, values in zip(QUANTITIES, np.transpose(found), strict=True):
            errors[quantity].append(values)
    return {quantity: np.stack(values) for quantity, values in errors.items()}


def state_errors(
    mechanics: Mechanics,
    autoencoder: Autoencoder,
    configuration: Float[np.ndarray, ' n'],
    velocity: Float[np.ndarray, ' n'],
) -> tuple[float, float, float]:
    """Return the errors of one state: of q [m²], of q̇ [m²/s²], of the energy [J²]."""
    latent, latent_velocity = autoencoder.encoder_jacobian_vector_product(configuration, velocity)
    decoded, jacobian = autoencoder.decode_with_jacobian(latent)
    decoded_velocity = jacobian @ latent_velocity
    energy = mechanics.total_energy(configuration, velocity)
    decoded_energy = mechanics.total_energy(decoded, decoded_velocity)
    return (
        float(np.mean((decoded - configuration) ** 2)),
        float(np.mean((decoded_velocity - velocity) ** 2)),
        (decoded_energy - energy) ** 2,
    )
