"""What a page may ask of the loop that it shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from dpc_ros.control import Target


class Actions(Protocol):
    """Takes what people want, from any thread, and returns at once; the page is told what came."""

    def pause(self, paused: bool) -> None:
        """Let the body stand still, or go on."""

    def step(self) -> None:
        """Advance a paused body by one step."""

    def reset(self) -> None:
        """Put the body at rest."""

    def aim(self, target: Target) -> None:
        """Steer the body to a target from now on."""

    def push(self, mass: int, force: Float[np.ndarray, ' 2']) -> None:
        """Push a mass [N] until it is pushed otherwise, or for as long as the simulator lets it."""

    def tune(self, parameters: Mapping[str, Any]) -> None:
        """Give the controller other parameters, all of them or none."""

    def record(self, recording: bool) -> None:
        """Begin a log, or end it."""
