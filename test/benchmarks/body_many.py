"""Many simulations of the paper's system 2: side by side on one core and two, and one by one."""

import numpy as np
from side_by_side import row, side_by_side

from dpc_ros.network import Gravity, Integrator, Mechanics, load_network, simulate, simulate_many

TRAJECTORIES = 32
STEPS = 200
STEP = 0.005  # s
REPETITIONS = 7
CORES = (1, 2)


def measure():
    """Return a row for each number of cores; times are of one trajectory."""
    network = load_network('paper_2')
    draw = np.random.default_rng(0)
    integrators = [
        Integrator(Mechanics(network, Gravity(strength)), STEP)
        for strength in draw.uniform(3.0, 17.0, TRAJECTORIES)
    ]
    q = np.tile(network.rest_configuration, (TRAJECTORIES, 1))
    velocity = np.zeros_like(q)

    def one_by_one():
        starts = zip(integrators, q, velocity, strict=True)
        return [simulate(*start, STEPS) for start in starts]

    rows = []
    for cores in CORES:

        def beside(cores=cores):
            return simulate_many(integrators, q, velocity, STEPS, threads=cores)

        for found, expected in zip(beside(), one_by_one(), strict=True):
            np.testing.assert_array_equal(found.configuration, expected.configuration)
        medians = [
            median / TRAJECTORIES for median in side_by_side(beside, one_by_one, REPETITIONS)
        ]
        rates = {
            'trajectories_per_s': 1.0 / medians[0],
            'one_by_one_per_s': 1.0 / medians[1],
            'force_evaluation_s': medians[0] / (4 * STEPS),
        }
        rows.append(row(f'body_many_{cores}_cores', 'one by one', *medians) | rates)
    return rows
