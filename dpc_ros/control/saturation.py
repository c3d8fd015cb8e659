"""Bounding a vector's length without turning it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def shorten(vector: Float[np.ndarray, ' k'], longest: float) -> Float[np.ndarray, ' k']:
    """Return the vector, scaled down to the length `longest` where it is longer."""
    length = float(np.sqrt(vector @ vector))
    return vector if length <= longest else vector * (longest / length)
