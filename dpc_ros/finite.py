"""Whether numbers are finite, for code that asks of every message."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def all_finite(values: Float[np.ndarray, ' k']) -> bool:
    """Return whether no value is infinite or NaN."""
    return np.count_nonzero(np.isfinite(values)) == np.size(values)  # faster than `all`
