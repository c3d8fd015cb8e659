"""Compressed simulation beside the full one: at equal error, and one evaluation at each size.

The error is the relative one of q over five seconds of a test simulation of the paper's system 2,
from rest, against the full body at a tenth of the paper's step. The full body takes its fastest
method and step that errs no more. For other sizes a decoder of the shipped one's layers with random
weights stands in, since its cost does not depend on them.
"""

import numpy as np
import torch
from body_scaling import SIDES, grid
from side_by_side import row, shortest, side_by_side

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.autoencoder.architecture import FlatArchitecture
from dpc_ros.autoencoder.flat_module import FlatModule
from dpc_ros.data import simulate_condition
from dpc_ros.network import INTEGRATORS, Gravity, Integrator, Mechanics, load_network, simulate
from dpc_ros.network.kernels import accelerate, workspace
from dpc_ros.reduction import CompressedSystem, simulate_compressed

SIMULATION = 14  # under the strongest gravity
SECONDS = 5.0
FINE = 0.0005  # s, of the reference
COMPRESSED_STEPS = (0.05, 0.02, 0.01)  # s
FULL_STEPS = (0.01, 0.005, 0.0025, 0.001)  # s
REPETITIONS = 15


def measure():
    """Return a row for each compressed step, and one for each size."""
    return [*_at_equal_error(), *_by_size()]


def _at_equal_error():
    network = load_network('paper_2')
    condition, _ = simulate_condition(network, SIMULATION)
    mechanics = Mechanics(network, condition.gravity)
    system = CompressedSystem(mechanics, load_checkpoint('paper_2_extended_m5').autoencoder(), 162)
    rest, still = network.rest_configuration, np.zeros(network.configuration_size)
    start = system.autoencoder.encoder_jacobian_vector_product(rest, still)
    exact = simulate(Integrator(mechanics, FINE), rest, still, round(SECONDS / FINE)).configuration

    def error(configurations, step):
        expected = exact[:: round(step / FINE)]
        with np.errstate(over='ignore'):  # where the step is too long
            return np.linalg.norm(configurations - expected) / np.linalg.norm(expected)

    full = []
    for method in INTEGRATORS:
        for step in FULL_STEPS:
            integrator = Integrator(mechanics, step, method)

            def run(integrator=integrator):
                return simulate(integrator, rest, still, round(SECONDS / integrator.step))

            found = error(run().configuration, step)
            if np.isfinite(found):
                full.append((shortest(run), found, f'{method} {1e3 * step:g} ms', run))
    rows = []
    for step in COMPRESSED_STEPS:

        def compressed(step=step):
            trajectory = simulate_compressed(system, *start, step, round(SECONDS / step))
            return system.autoencoder.decode(trajectory.latent)

        reached = error(compressed(), step)
        good = [each for each in full if each[1] <= reached]
        _, their_error, name, theirs = min(good, key=lambda each: each[0])
        medians = side_by_side(compressed, theirs, REPETITIONS)
        errors = {'ours_error': reached, 'peer_error': their_error}
        rows.append(row(f'compressed_5_s_{1e3 * step:g}_ms', f'full {name}', *medians) | errors)
    return rows


def _by_size():
    torch.manual_seed(0)
    shipped = load_checkpoint('paper_2_extended_m5').architecture
    rows = []
    for side in SIDES:
        network = grid(side)
        mechanics = Mechanics(network, Gravity(9.81))
        architecture = FlatArchitecture(
            network.configuration_size, 5, shipped.hidden_sizes, shipped.activation
        )
        module = FlatModule(architecture).double()
        module.configuration_mean.copy_(torch.from_numpy(network.rest_configuration))
        system = CompressedSystem(mechanics, module.export(), int(network.mobile[0]))
        latent = np.random.default_rng(0).normal(size=(2, 5))
        still = np.zeros(network.configuration_size)
        state = network.rest_configuration, still, still
        own = mechanics.arrays, mechanics.gravity_vector
        work, result = workspace(mechanics.arrays), np.empty_like(still)

        def compressed(system=system, latent=latent):
            system.acceleration(*latent)

        def full(own=own, state=state, work=work, result=result):
            accelerate(*own, *state, work, result)

        medians = side_by_side(compressed, full, REPETITIONS)
        masses = len(network.mass)
        rows.append(row(f'compressed_evaluation_{masses}_masses', 'full', *medians))
    return rows
