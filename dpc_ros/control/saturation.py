"""Bounding a vector's length without turning it, and how fast a vector changes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def shorten(vector: Float[np.ndarray, ' k'], longest: float) -> Float[np.ndarray, ' k']:
    """Return the vector, scaled down to the length `longest` where it is longer."""
    length = float(np.sqrt(vector @ vector))
    return vector if length <= longest else vector * (longest / length)


def approach(
    vector: Float[np.ndarray, ' k'], goal: Float[np.ndarray, ' k'], longest: float
) -> Float[np.ndarray, ' k']:
    """Return the goal, or the point on the way to it that is `longest` away from the vector."""
    way = goal - vector
    step = shorten(way, longest)
    return goal if step is way else vector + step
