"""Thinning: drop configurations that are nearly the same as one already kept."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numba import njit

THINNING_DISTANCE = 0.1  # m, the paper's ε


def thin(
    configurations: Float[np.ndarray, 'frames n'], distance: float = THINNING_DISTANCE
) -> Int[np.ndarray, ' kept']:
    """Return the frames to keep so that no two are nearer than a distance (paper, section A.1).

    Greedy in time order: frame 0 is kept, then each frame that is no nearer than `distance`
    (Euclidean, over all coordinates [m]) to every frame kept before it.

    Raises:
        ValueError: the distance is negative or not a number.
    """
    if not distance >= 0:
        raise ValueError(f'thinning distance: expected a length ≥ 0 m, got {distance}')
    return np.flatnonzero(_keep(np.ascontiguousarray(configurations), distance * distance))


@njit(cache=True)
def _keep(configurations, squared_distance):
    frames, coordinates = configurations.shape
    kept = np.zeros(frames, dtype=np.bool_)
    for frame in range(frames):
        near = False
        # The nearest kept frame is nearly always a recent one: look backwards.
        for other in range(frame - 1, -1, -1):
            if not kept[other]:
                continue
            total = 0.0
            for i in range(coordinates):
                difference = configurations[frame, i] - configurations[other, i]
                total += difference * difference
                if total >= squared_distance:
                    break
            if total < squared_distance:
                near = True
                break
        kept[frame] = not near
    return kept
