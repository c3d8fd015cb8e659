"""The frames of the last seconds, as arrays for plots."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from dpc_ros.view.frame import Frame

_MOST_FRAMES = 2000  # of a history; more than a plot has pixels
_HEAD = 7  # columns before those of the latent coordinates


class Curves(NamedTuple):
    """What is plotted of some frames; NaN where something is not known.

    Attributes:
        time: of each [s].
        nmse: normalised mean square error.
        force: of the controller [N].
        energies: kinetic, elastic and gravitational [J].
        latent: ξ.
        target_latent: ξ̄.
    """

    time: Float[np.ndarray, ' frames']
    nmse: Float[np.ndarray, ' frames']
    force: Float[np.ndarray, 'frames 2']
    energies: Float[np.ndarray, 'frames 3']
    latent: Float[np.ndarray, 'frames m']
    target_latent: Float[np.ndarray, 'frames m']


class History:
    """Keeps of each frame what is plotted, and forgets what is older than a span of time.

    Where time falls back it begins anew: so does the body.

    Args:
        latent_size: m.
        seconds: the span [s].
    """

    def __init__(self, latent_size: int, seconds: float = np.inf) -> None:
        self._latent_size = latent_size
        self._seconds = seconds
        self._rows: deque[np.ndarray] = deque(maxlen=_MOST_FRAMES)

    def add(self, frame: Frame) -> None:
        """Take the next frame; one of the same time as the last is left out."""
        if self._rows and frame.time <= self._rows[-1][0]:
            if frame.time == self._rows[-1][0]:
                return
            self._rows.clear()
        nothing = np.full(self._latent_size, np.nan)
        row = np.concatenate(
            [
                [frame.time, frame.nmse],
                [np.nan, np.nan] if frame.force is None else frame.force,
                frame.energies,
                nothing if frame.latent is None else frame.latent,
                nothing if frame.target_latent is None else frame.target_latent,
            ]
        )
        row[~np.isfinite(row)] = np.nan
        self._rows.append(row)
        while frame.time - self._rows[0][0] > self._seconds:
            self._rows.popleft()

    def curves(self) -> Curves:
        """Return all that is kept."""
        m = self._latent_size
        rows = np.array(self._rows, dtype=float).reshape(-1, _HEAD + 2 * m)
        return Curves(
            time=rows[:, 0],
            nmse=rows[:, 1],
            force=rows[:, 2:4],
            energies=rows[:, 4:_HEAD],
            latent=rows[:, _HEAD : _HEAD + m],
            target_latent=rows[:, _HEAD + m :],
        )
