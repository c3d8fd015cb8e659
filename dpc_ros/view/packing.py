"""Numbers in a page: arrays as base64, positions in sixteen bits."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt16

MISSING = 2**16 - 1  # stands for a position that is not known
_LARGEST = MISSING - 1  # level of the largest position


def packed(array: np.ndarray) -> dict[str, str]:
    """Return an array, flat, as Plotly takes typed arrays: `dtype` and base64 of its bytes."""
    little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder('<'))
    kind = f'{array.dtype.kind}{array.dtype.itemsize}'
    return {'dtype': kind, 'bdata': base64.b64encode(little.tobytes()).decode()}


@dataclass(frozen=True, eq=False)
class Quantised:
    """Positions in frames, each within half a step of what it was.

    Attributes:
        low: the smallest x and y [m].
        step: of the levels of x and y [m].
        level: of each position above `low`, `MISSING` for all of a frame that is not finite.
    """

    low: Float[np.ndarray, ' 2']
    step: Float[np.ndarray, ' 2']
    level: UInt16[np.ndarray, 'frames masses 2']

    def positions(self) -> Float[np.ndarray, 'frames masses 2']:
        """Return the positions [m], NaN where they are missing."""
        return np.where(self.level == MISSING, np.nan, self.low + self.step * self.level)


def quantise(positions: Float[np.ndarray, 'frames masses 2']) -> Quantised:
    """Return positions in sixteen bits over their own limits.

    Args:
        positions: [m]; a frame with one that is not finite is missing as a whole.
    """
    known = np.isfinite(positions).all(axis=(1, 2))
    finite = positions[known].reshape(-1, 2)
    low, high = (finite.min(axis=0), finite.max(axis=0)) if len(finite) else np.zeros((2, 2))
    step = (high - low) / _LARGEST
    level = np.full(positions.shape, MISSING, dtype=np.uint16)
    level[known] = np.rint((positions[known] - low) / np.where(step > 0, step, 1.0))
    return Quantised(low, step, level)
