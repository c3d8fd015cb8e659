"""A second of the paper's system 2 at equal accuracy: ours beside scipy and MuJoCo.

The error is the greatest of a coordinate at the end, from rest under gravity, against scipy's
DOP853 at a tolerance far below. Each of our methods and steps stands beside scipy's `solve_ivp`
over numpy and scipy.sparse, and each of MuJoCo's beside ours: the fastest that errs no more.
"""

import numpy as np
from body_peers import (
    GRAVITY,
    INTEGRATORS,
    STABLE,
    mujoco_second,
    our_second,
    scipy_second,
    system_2,
)
from side_by_side import row, shortest, side_by_side
from sparse_body import SparseBody

METHODS = ('rk4', 'symplectic_euler')
STEPS = (0.005, 0.0025, 0.001, 0.0005)  # s
SMALL_STEPS = (*STEPS, 0.0002)  # s, ours where MuJoCo errs less than with all of these
SCIPY = [(method, 10.0**-k) for method in ('RK45', 'DOP853') for k in range(3, 11)]
REFERENCE = 1e-11  # tolerance
REPETITIONS = 3
ROUNDING = 1.001  # of errors: those of the same method are equal but for it


def measure():
    """Return a row for each method and step that is stable."""
    network = system_2()
    sparse = SparseBody(network, GRAVITY)
    exact = scipy_second(sparse, network, 'DOP853', REFERENCE)()
    ours = {
        f'{method} {1e3 * step:g} ms': our_second(network, step, method)
        for method in METHODS
        for step in SMALL_STEPS
    }
    scipy = {
        f'solve_ivp {method} {tolerance:g}': scipy_second(sparse, network, method, tolerance)
        for method, tolerance in SCIPY
    }
    mujoco = {
        f'MuJoCo {name} {1e3 * step:g} ms': mujoco_second(network, step, name)
        for name in INTEGRATORS
        for step in STEPS
    }
    for method in METHODS:
        our_second(network, STEPS[0], method)()  # compiled
    tried = {name: _try(run, exact) for name, run in (ours | scipy | mujoco).items()}
    pairs = [(name, name, _fastest(scipy, tried, tried[name][0])) for name in ours]
    pairs += [(name, _fastest(ours, tried, tried[name][0]), name) for name in mujoco]
    rows = []
    for name, mine, peer in pairs:
        if mine is None or peer is None or not max(tried[mine][0], tried[peer][0]) < STABLE:
            continue
        medians = side_by_side(ours[mine], (scipy | mujoco)[peer], REPETITIONS)
        errors = {'ours': mine, 'ours_error_m': tried[mine][0], 'peer_error_m': tried[peer][0]}
        rows.append(row(f'body_second_{name.replace(" ", "_")}', peer, *medians) | errors)
    return rows


def _try(run, exact):
    """Return error [m] and time [s]; the error is not a number where the step is too long."""
    error = float(np.abs(run() - exact).max())
    return error, shortest(run)


def _fastest(names, tried, error):
    """Return the name of the fastest that errs no more, None where there is none."""
    good = [name for name in names if tried[name][0] <= ROUNDING * error]
    return min(good, key=lambda name: tried[name][1], default=None)
