"""Which trainings the paper's experiments need, by the body and the latent size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dpc_ros.autoencoder.recipe import Recipe

SYSTEMS = ('paper_1', 'paper_2', 'paper_3', 'paper_4', 'paper_5')

# The paper's best hyperparameters: learning rate, λ, step, γ.
_FLAT: dict[str, tuple[float, float, int, float]] = {
    'paper_1': (5e-4, 1e-6, 200, 0.5),
    'paper_2': (1e-3, 1e-5, 200, 0.3),
    'paper_3': (1e-3, 1e-5, 100, 0.5),
    'paper_4': (1e-3, 1e-5, 100, 0.5),
    'paper_5': (1e-3, 1e-7, 100, 0.5),
}
_GRAPH: dict[str, tuple[float, float, int, float]] = {
    'paper_1': (6e-3, 1e-5, 30, 0.8),
    'paper_2': (6e-3, 1e-7, 40, 0.7),
    'paper_3': (3e-3, 1e-6, 40, 0.7),
    'paper_4': (3e-3, 1e-6, 30, 0.8),
    'paper_5': (3e-3, 1e-5, 30, 0.8),
}
# 150 epochs of batches of 64 take more steps of Adam than the paper's 500 of 256, in a third of the
# time; the learning rate falls after as many epochs of the whole as in the paper's.
_GRAPH_EPOCHS, _PAPER_EPOCHS = 150, 500
_GRAPH_BATCH = 64

# Weight decay and batch size, of which validation data choose.
_REGULARISATIONS = ((0.3, 256), (1.0, 256), (3.0, 256), (0.6, 128))
_EXTRA_SIMULATIONS = 400


@dataclass(frozen=True)
class Model:
    """A row of the tables: a kind of autoencoder, and the trainings of which the best is taken.

    Attributes:
        name: in the column `model`.
        recipe: `paper` or `best`, in the column of that name.
        training_data: `paper`, simulations 1 to 5, or `extended`, more beside them.
        candidates: system, latent size → recipes, of which the smallest validation error wins.
    """

    name: str
    recipe: str
    training_data: str
    candidates: Callable[[str, int], list[Recipe]]


def flat(system: str, latent_size: int) -> list[Recipe]:
    """Return the paper's flat autoencoder with the hyperparameters that it found best."""
    rate, decay, step, factor = _FLAT[system]
    return [
        Recipe(
            name=f'{system}_flat_m{latent_size}',
            network=system,
            latent_size=latent_size,
            learning_rate=rate,
            weight_decay=decay,
            step_epochs=step,
            step_factor=factor,
        )
    ]


def graph(system: str, latent_size: int) -> list[Recipe]:
    """Return the paper's graph autoencoder with the hyperparameters that it found best."""
    rate, decay, step, factor = _GRAPH[system]
    return [
        Recipe(
            name=f'{system}_graph_m{latent_size}',
            network=system,
            kind='graph',
            latent_size=latent_size,
            epochs=_GRAPH_EPOCHS,
            batch_size=_GRAPH_BATCH,
            learning_rate=rate,
            weight_decay=decay,
            step_epochs=step * _GRAPH_EPOCHS // _PAPER_EPOCHS,
            step_factor=factor,
        )
    ]


def pod(system: str, latent_size: int) -> list[Recipe]:
    """Return the linear baseline."""
    name = f'{system}_pod_m{latent_size}'
    return [Recipe(name=name, network=system, kind='pod', latent_size=latent_size)]


def ours(system: str, latent_size: int) -> list[Recipe]:
    """Return our autoencoder on the paper's training data, regularised more and less."""
    return [
        Recipe(
            name=f'{system}_ours_m{latent_size}_decay_{decay}',
            network=system,
            latent_size=latent_size,
            hidden_sizes=(128, 128, 64),
            activation='silu',
            skip=True,
            pod_size=64,
            epochs=150,
            batch_size=batch_size,
            optimizer='adamw',
            learning_rate=3e-3,
            weight_decay=decay,
            schedule='one_cycle',
        )
        for decay, batch_size in _REGULARISATIONS
    ]


def extended(system: str, latent_size: int) -> list[Recipe]:
    """Return our autoencoder on more simulations than the paper's."""
    return [
        Recipe(
            name=f'{system}_extended_m{latent_size}',
            network=system,
            latent_size=latent_size,
            hidden_sizes=(128, 128, 64),
            activation='silu',
            skip=True,
            pod_size=64,
            extra_simulations=_EXTRA_SIMULATIONS,
            input_noise=0.02,
            epochs=60,
            batch_size=128,
            optimizer='adamw',
            learning_rate=3e-3,
            weight_decay=0.0,
            schedule='one_cycle',
        )
    ]


FLAT = Model('flat', 'paper', 'paper', flat)
GRAPH = Model('graph', 'paper', 'paper', graph)
POD = Model('pod', 'paper', 'paper', pod)
OURS = Model('ours', 'best', 'paper', ours)
EXTENDED = Model('ours', 'best', 'extended', extended)
