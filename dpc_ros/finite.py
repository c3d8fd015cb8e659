"""Whether numbers are finite, or within a bound, for code that asks of every message.

The sum of squares is found sooner than each value looked at, by `vdot` without a warning of what
overflows.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float


def all_finite(values: Float[np.ndarray, ' k']) -> bool:
    """Return whether no value is infinite or NaN."""
    return math.isfinite(np.vdot(values, values)) or bool(np.isfinite(values).all())


def all_within(values: Float[np.ndarray, ' k'], largest: float) -> bool:
    """Return whether no value is beyond a bound, or NaN."""
    # Whatever the rounding, the sum is no less than the square of any value.
    squares = np.vdot(values, values)
    return bool(squares < largest * largest or np.all(np.abs(values) <= largest))
