"""The online halves of the loop without ROS: what encoder and controller keep between messages.

The nodes are adapters around these; a log that is run again is fed to the very same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder import Autoencoder, Checkpoint, load_checkpoint, with_encoder
from dpc_ros.control.law import ControlLaw, LawSettings
from dpc_ros.control.observer import LatentObserver, ObserverSettings
from dpc_ros.control.registry import make_law
from dpc_ros.control.schedule import TargetSchedule
from dpc_ros.control.targets import Target
from dpc_ros.network import Gravity, MassSpringNetwork, Mechanics, load_network
from dpc_ros.parameters import ParameterError, read_options
from dpc_ros.reduction import CompressedSystem


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
        self.network, self.checkpoint, self.autoencoder = _load_models(parameters)
        self.observer = _make_observer(self.network, self.autoencoder, parameters)
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
        _check_finite(latent, latent_velocity)
        if self.observer is not None:
            estimate = self.observer.estimate(latent, latent_velocity, stamp)
            _check_finite(*estimate)
        else:
            estimate = latent, latent_velocity
        self._last_latent = latent
        return estimate


class OnlineController:
    """A control law and the targets that it is given, each from a stamp on.

    Args:
        parameters: of the controller node, by name.

    Attributes:
        law: the control law.
        has_target: whether the law has ever had a target that it can use.

    Raises:
        FileNotFoundError: there is no such network or checkpoint.
        ValueError: a parameter, or a checkpoint of another network.
    """

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self.network, self.checkpoint, autoencoder = _load_models(parameters)
        gravity = Gravity(parameters['gravity_magnitude'], parameters['gravity_angle'])
        system = CompressedSystem(
            Mechanics(self.network, gravity), autoencoder, parameters['actuated_mass']
        )
        self.law: ControlLaw = make_law(parameters['law'], system, law_settings(parameters))
        self.has_target = False
        self._schedule = TargetSchedule()
        self._seen: Target | None = None

    def add_target(self, stamp: int, target: Target) -> None:
        """Take a target that counts from a stamp [ns] on; zero means at once."""
        self._schedule.add(stamp, target)

    def restart(self) -> None:
        """Begin anew with a law that keeps nothing of before."""
        self.law.restart()

    def begin_epoch(self) -> None:
        """Begin anew where stamps do; the target in force stays so."""
        self._schedule.restart()
        self.restart()

    def regulate(self, stamp: int) -> Target | None:
        """Give the law the target in force at a stamp [ns]; return it where it is new, else none.

        Raises:
            Exception: whatever the law raises; the one that it had before stays in force.
        """
        target = self._schedule.in_force(stamp)
        if target is None or target is self._seen:
            return None
        self._seen = target
        self.law.regulate(target)
        self.has_target = True
        return target

    def force(
        self,
        latent: Float[np.ndarray, ' m'],
        latent_velocity: Float[np.ndarray, ' m'],
        stamp: int,
    ) -> Float[np.ndarray, ' 2']:
        """Return u [N] for the next latent state.

        Raises:
            ValueError: the law gives no finite force in the plane.
            Exception: whatever else a law of another package raises.
        """
        force = self.law.force(latent, latent_velocity, stamp)
        if not (force.shape == (2,) and np.isfinite(force).all()):
            raise ValueError(f'expected a finite force in the plane, got {force}')
        return force


def law_settings(parameters: Mapping[str, Any]) -> LawSettings:
    """Return what a controller's parameters say about its law: they have the names of its fields.

    Raises:
        ParameterError: the options are no YAML of names and values.
        ValueError: a number is out of its range.
    """
    options = read_options(parameters['law_options'], 'law_options')
    numbers = {each.name for each in fields(LawSettings)} - {'options'}
    return LawSettings(**{name: parameters[name] for name in numbers}, options=options)


def _check_finite(latent: np.ndarray, latent_velocity: np.ndarray) -> None:
    if not (np.isfinite(latent).all() and np.isfinite(latent_velocity).all()):
        raise ValueError('expected a finite latent state, got one that is not')


def _make_observer(
    network: MassSpringNetwork, autoencoder: Autoencoder, parameters: Mapping[str, Any]
) -> LatentObserver | None:
    """Return the observer that an encoder's parameters ask for: they have its settings' names."""
    observes = parameters['observer'] == 'kalman'
    if parameters['measure_delay'] and not observes:
        raise ParameterError('measure_delay: expected observer kalman, which foresees the delay')
    if parameters['measure_delay'] and parameters['delay']:
        raise ParameterError('measure_delay: expected delay 0, or measure_delay false: not both')
    if not observes:
        return None
    gravity = Gravity(parameters['gravity_magnitude'], parameters['gravity_angle'])
    system = CompressedSystem(Mechanics(network, gravity), autoencoder, parameters['actuated_mass'])
    names = (each.name for each in fields(ObserverSettings))
    return LatentObserver(system, ObserverSettings(**{name: parameters[name] for name in names}))


def _load_models(
    parameters: Mapping[str, Any],
) -> tuple[MassSpringNetwork, Checkpoint, Autoencoder]:
    network = load_network(parameters['network'])
    checkpoint = load_checkpoint(parameters['checkpoint'])
    checkpoint.check_network(network)
    autoencoder = with_encoder(
        checkpoint.autoencoder(), parameters['encoder'], parameters['projection_iterations']
    )
    return network, checkpoint, autoencoder
