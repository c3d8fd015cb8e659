"""The closed loop in one process, without ROS: what a lockstep run over DDS repeats bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder import Autoencoder
from dpc_ros.control.laws import ControlLaw
from dpc_ros.network import Body
from dpc_ros.threads import single_threaded_algebra


@dataclass(frozen=True, eq=False)
class ClosedLoopRun:
    """What happened at each control step; force k is held from state k to state k + 1.

    Attributes:
        step: control step [s].
        configuration: q [m].
        velocity: q̇ [m/s].
        latent: ξ.
        latent_velocity: ξ̇.
        force: u on the actuated mass [N].
    """

    step: float
    configuration: Float[np.ndarray, 'frames n']
    velocity: Float[np.ndarray, 'frames n']
    latent: Float[np.ndarray, 'frames m']
    latent_velocity: Float[np.ndarray, 'frames m']
    force: Float[np.ndarray, 'frames 2']


def run_closed_loop(
    body: Body,
    autoencoder: Autoencoder,
    law: ControlLaw,
    steps: int,
    on_step: Callable[[int], None] = lambda step: None,
) -> ClosedLoopRun:
    """Run body, encoder and controller in turn: encode, compute the force, integrate one step.

    Args:
        body: the body where it stands; its time step is the control step.
        autoencoder: the encoder.
        law: the controller, its target already set.
        steps: number of steps; states 0 … steps are encoded and answered.
        on_step: called with the number of each state, for progress.
    """
    rows: list[tuple[np.ndarray, ...]] = []
    latent: np.ndarray | None = None
    with single_threaded_algebra():
        for k in range(steps + 1):
            latent, latent_velocity = autoencoder.encoder_jacobian_vector_product(
                body.configuration, body.velocity, latent
            )
            force = law.force(latent, latent_velocity)
            rows.append((body.configuration, body.velocity, latent, latent_velocity, force))
            if k < steps:
                body.advance(force)
            on_step(k)
    return ClosedLoopRun(
        body.integrator.step, *(np.array(column) for column in zip(*rows, strict=True))
    )
