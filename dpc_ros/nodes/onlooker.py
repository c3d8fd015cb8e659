"""What the newest messages of a run show: the body, what its latent state says, target, force."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder import Autoencoder, Checkpoint, load_checkpoint
from dpc_ros.control import Controllers
from dpc_ros.network import MassSpringNetwork, load_network
from dpc_ros.nodes.messages import (
    MessageError,
    check_within,
    hear_controller,
    is_latent,
    latent_names,
    read_force,
    read_message,
    read_stamp,
    read_state,
)
from dpc_ros.nodes.target_messages import read_target
from dpc_ros.nodes.topics import TOPICS

_LARGEST_FORCE = 1e9  # N; an arrow for more is of no use, and could be longer than a number


class Sight(NamedTuple):
    """A configuration that is known.

    Attributes:
        stamp: of the message that it is from [ns].
        configuration: q, or what a latent state decodes to [m].
        seen: when it came [s], by the clock of who looks on.
        velocity: q̇ [m/s], of the body.
        latent: ξ, where a latent state was decoded.
    """

    stamp: int
    configuration: Float[np.ndarray, ' n']
    seen: float
    velocity: Float[np.ndarray, ' n'] | None = None
    latent: Float[np.ndarray, ' m'] | None = None


class Push(NamedTuple):
    """A force that the controller commands; stamp and time as of a `Sight`.

    Attributes:
        mass: number of the mass that it acts on.
        force: in the plane [N].
    """

    stamp: int
    mass: int
    force: Float[np.ndarray, ' 2']
    seen: float


class Onlooker:
    """Reads messages of the loop, refuses those that do not fit, and knows what is in force.

    Args:
        parameters: `largest_displacement` [m] of a coordinate from rest; `answer_timeout` [s], for
            which a force, its controller and, where the body moves on, a latent state count.
        network: the body.
        checkpoint: of latent states, trained on it; without one nothing is decoded.
        autoencoder: that of the checkpoint.

    Attributes:
        network: the body.
        models: identifiers of network and checkpoint, by these words.
        topics: those that it reads.
        body, reconstruction, target, push: what is known and counts, None where there is nothing.
    """

    def __init__(
        self,
        parameters: Mapping[str, Any],
        network: MassSpringNetwork,
        checkpoint: Checkpoint | None = None,
        autoencoder: Autoencoder | None = None,
    ) -> None:
        self.network = network
        self.models = {'network': network.identifier}
        self.topics = ['configuration', 'target_in_force', 'control_force']
        self._autoencoder = autoencoder
        self._latent_names: list[str] = []
        if checkpoint is not None and autoencoder is not None:
            self.models['checkpoint'] = checkpoint.identifier
            self._latent_names = latent_names(autoencoder.latent_size)
            autoencoder.decode(np.zeros(autoencoder.latent_size))  # compiles, where it does
            self.topics.append('latent_state')
        self._largest_displacement = parameters['largest_displacement']
        self._timeout = parameters['answer_timeout']
        self._reads: dict[str, Callable[[Any, int, float], None]] = {
            'configuration': self._see_body,
            'latent_state': self._see_latent_state,
            'target_in_force': self._see_target,
            'control_force': self._see_force,
        }
        self.forget()

    def forget(self) -> None:
        """Know of nothing any more."""
        self._controllers = Controllers(self._timeout)
        self.body: Sight | None = None
        self.reconstruction: Sight | None = None
        self.target: Sight | None = None
        self.push: Push | None = None

    def read(self, topic: str, data: bytes, now: float) -> None:
        """Take a message of one of the topics.

        Args:
            topic: its name.
            data: its bytes.
            now: time [s] by a steady clock.

        Raises:
            MessageError: it can't be used; what was known stays so.
        """
        message = read_message(data, TOPICS[topic].message_type)
        self._reads[topic](message, read_stamp(message.header.stamp), now)

    def pass_time(self, now: float) -> bool:
        """Forget what does not count any more at a time [s], and return whether there was any.

        The body keeps its last shape.
        """
        body, reconstruction, push = self.body, self.reconstruction, self.push
        is_over = push is not None and now - push.seen > self._timeout
        lags = (
            body is not None
            and reconstruction is not None
            and body.seen - reconstruction.seen > self._timeout
        )
        if is_over:
            self.push = None
        if lags:
            self.reconstruction = None
        return is_over or lags

    def _see_body(self, message: Any, stamp: int, now: float) -> None:
        network = self.network
        configuration, velocity = read_state(message, network.identifier, network.coordinate_names)
        self.body = Sight(stamp, self._plausible(configuration), now, velocity=velocity)

    def _see_latent_state(self, message: Any, stamp: int, now: float) -> None:
        latent, _ = read_state(message, self.models['checkpoint'], self._latent_names)
        self.reconstruction = Sight(stamp, self._decoded(latent), now, latent=latent)

    def _see_target(self, message: Any, stamp: int, now: float) -> None:
        network = self.network
        latent_size = len(self._latent_names)
        if self._autoencoder is None and is_latent(message):
            self.target = None
            return
        target = read_target(message, network.identifier, network.coordinate_names, latent_size)
        known = self._decoded if target.is_latent else self._plausible
        self.target = Sight(stamp, known(target.value), now, latent=target.latent)

    def _see_force(self, message: Any, stamp: int, now: float) -> None:
        frame, force = read_force(message)
        check_within(force, _LARGEST_FORCE, 'force', 'N')
        try:
            self.network.mobile_index(frame.mass)
        except ValueError as error:
            raise MessageError(str(error)) from error
        hear_controller(self._controllers, frame, now)
        self.push = Push(stamp, frame.mass, force, now) if force.any() else None

    def _decoded(self, latent: Float[np.ndarray, ' m']) -> Float[np.ndarray, ' n']:
        assert self._autoencoder is not None
        with np.errstate(all='ignore'):  # what is no number is refused
            return self._plausible(self._autoencoder.decode(latent))

    def _plausible(self, configuration: Float[np.ndarray, ' n']) -> Float[np.ndarray, ' n']:
        displacement = configuration - self.network.rest_configuration
        check_within(displacement, self._largest_displacement, 'displacement', 'm')
        return configuration


def load_onlooker(parameters: Mapping[str, Any]) -> Onlooker:
    """Return one who knows the network and, unless its name is empty, the checkpoint of parameters.

    Raises:
        FileNotFoundError: there is no such network or checkpoint.
        ValueError: one that can't be used, or a checkpoint of another network.
    """
    network = load_network(parameters['network'])
    if not parameters['checkpoint']:
        return Onlooker(parameters, network)
    checkpoint = load_checkpoint(parameters['checkpoint'])
    checkpoint.check_network(network)
    return Onlooker(parameters, network, checkpoint, checkpoint.autoencoder())
