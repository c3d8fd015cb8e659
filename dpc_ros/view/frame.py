"""What there is to see of a loop at one moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Frame:
    """One moment of a loop, what is not known left out.

    Attributes:
        time: since the run began [s].
        configuration: q [m].
        latent: ξ.
        reconstruction: D(ξ) [m].
        target: q̄ [m].
        target_latent: ξ̄.
        force: u [N].
        mass: number of the mass that it acts on.
        nmse: MSE(q, q̄) over what it was when the target came into force; NaN without one.
        energies: kinetic, elastic and gravitational [J]; NaN where they are not known.
    """

    time: float
    configuration: Float[np.ndarray, ' n']
    latent: Float[np.ndarray, ' m'] | None = None
    reconstruction: Float[np.ndarray, ' n'] | None = None
    target: Float[np.ndarray, ' n'] | None = None
    target_latent: Float[np.ndarray, ' m'] | None = None
    force: Float[np.ndarray, ' 2'] | None = None
    mass: int | None = None
    nmse: float = np.nan
    energies: tuple[float, float, float] = (np.nan, np.nan, np.nan)
