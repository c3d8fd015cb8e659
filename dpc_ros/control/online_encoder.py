"""The encoder without ROS: what it keeps between messages.

Its node is an adapter around this; a log that is run again is fed to the very same.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from dpc_ros.control.models import load_models
from dpc_ros.finite import all_finite
from dpc_ros.parameters import ParameterError


class OnlineEncoder:
    """Encodes one configuration after the other; the search for each begins at the one before.

    With an observer, what comes out are its estimates.

    Args:
        parameters: of the encoder node, by name.

    Attributes:
        observer: the filter, where the parameters ask for one.

    Raises:
        FileNotFoundError: there is no such network or checkpoint.
        ValueError: a parameter, or a checkpoint of another network.
    """

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self.network, self.checkpoint, self.autoencoder = load_models(parameters)
        self.observer = None
        if parameters['observer'] == 'kalman':
            # With the body's mechanics, which an encoder alone has no use for.
            from dpc_ros.control.observer import make_observer

            self.observer = make_observer(self.network, self.autoencoder, parameters)
        elif parameters['measure_delay']:
            raise ParameterError(
                'measure_delay: expected observer kalman, which foresees the delay'
            )
        self._last_latent: np.ndarray | None = None

    def restart(self) -> None:
        """Begin anew, as where a motion does."""
        self._last_latent = None
        if self.observer is not None:
            self.observer.restart()

    def warm_up(self) -> None:
        """Compile what compiles at its first call, and forget it."""
        rest = self.network.rest_configuration
        for stamp in range(2):
            self.encode(rest, np.zeros_like(rest), stamp)
        self.restart()

    def encode(
        self,
        configuration: Float[np.ndarray, ' n'],
        velocity: Float[np.ndarray, ' n'],
        stamp: int,
    ) -> tuple[Float[np.ndarray, ' m'], Float[np.ndarray, ' m']]:
        """Return ξ and ξ̇ of the next configuration [m] and its velocity [m/s] at a stamp [ns].

        Raises:
            ValueError: they are not finite; the next search begins where this one did.
            Exception: whatever else an autoencoder of another package raises.
        """
        with np.errstate(all='ignore'):  # what is not finite is refused
            latent, latent_velocity = self.autoencoder.encoder_jacobian_vector_product(
                configuration, velocity, self._last_latent
            )
        expected = (self.autoencoder.latent_size,)
        if not np.shape(latent) == np.shape(latent_velocity) == expected:
            raise ValueError(f'expected a latent state of the shape {expected}')
        _check_finite(latent, latent_velocity)
        if self.observer is not None:
            estimate = self.observer.estimate(latent, latent_velocity, stamp)
            _check_finite(*estimate)
        else:
            estimate = latent, latent_velocity
        self._last_latent = latent
        return estimate


def _check_finite(latent: np.ndarray, latent_velocity: np.ndarray) -> None:
    if not (all_finite(latent) and all_finite(latent_velocity)):
        raise ValueError('expected a finite latent state, got one that is not')
