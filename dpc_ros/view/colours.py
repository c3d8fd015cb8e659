"""Colours that pages, markers and the viewer share."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8

LARGEST_STRAIN = 0.2  # from which on a spring has the full colour

# Compressed, at rest, stretched; told apart by those who see no red or green, too.
_COMPRESSED, _AT_REST, _STRETCHED = (
    np.array(colour, dtype=float) for colour in ((0, 114, 178), (150, 150, 150), (213, 94, 0))
)


def strain_colours(
    strain: Float[np.ndarray, '*springs'], largest: float = LARGEST_STRAIN
) -> UInt8[np.ndarray, '*springs 3']:
    """Return red, green and blue of springs: blue if compressed, grey at rest, orange if stretched.

    Args:
        strain: (|d| − l)/l of each.
        largest: magnitude from which on the colour is full, > 0.

    Raises:
        ValueError: `largest` is not positive.
    """
    if not largest > 0:
        raise ValueError(f'largest strain: expected a positive number, got {largest}')
    share = np.clip(strain / largest, -1.0, 1.0)[..., np.newaxis]
    full = np.where(share < 0, _COMPRESSED, _STRETCHED)
    return np.rint(_AT_REST + np.abs(share) * (full - _AT_REST)).astype(np.uint8)
