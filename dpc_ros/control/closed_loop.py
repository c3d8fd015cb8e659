"""The closed loop in one process, without ROS: what a lockstep run over DDS repeats bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder import Autoencoder
from dpc_ros.control.law import NANOSECOND, ControlLaw
from dpc_ros.network import Body
from dpc_ros.threads import single_threaded_algebra


@dataclass(frozen=True, eq=False)
class ClosedLoopRun:
    """What happened at each control step; force k acts from state k to state k + 1.

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


@dataclass(frozen=True)
class Imperfections:
    """What stands between a body and its controller.

    Attributes:
        hold: steps from one measurement to the next; the force is held meanwhile, at least 1.
        latency: steps from a measurement to its force; zero force before the first.
        noise: deviation of normal noise on every measured coordinate [m].
        seed: of the noise.

    Raises:
        ValueError: a value is out of its range.
    """

    hold: int = 1
    latency: int = 0
    noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not (self.hold >= 1 and self.latency >= 0 and 0 <= self.noise < np.inf):
            raise ValueError(f'expected hold ≥ 1, latency ≥ 0 and a finite noise ≥ 0, got {self}')


def run_closed_loop(
    body: Body,
    autoencoder: Autoencoder,
    law: ControlLaw,
    steps: int,
    on_step: Callable[[int], None] = lambda step: None,
    imperfections: Imperfections | None = None,
) -> ClosedLoopRun:
    """Run body, encoder and controller in turn: encode, compute the force, integrate one step.

    Args:
        body: the body where it stands; its time step is the control step.
        autoencoder: the encoder.
        law: the controller, its target already set.
        steps: number of steps; states 0 … steps are encoded and answered.
        on_step: called with the number of each state, for progress.
        imperfections: of measurement and timing; none where left out.
    """
    loop = imperfections or Imperfections()
    draw = np.random.default_rng(loop.seed)
    waiting = [np.zeros(2)] * loop.latency
    rows: list[tuple[np.ndarray, ...]] = []
    latent: np.ndarray | None = None
    latent_velocity = answer = np.zeros(2)  # until the first state is measured
    period = round(body.integrator.step / NANOSECOND)  # ns, as the simulator's stamps
    with single_threaded_algebra():
        for k in range(steps + 1):
            if k % loop.hold == 0:
                measured = body.configuration
                if loop.noise:
                    measured = measured + loop.noise * draw.standard_normal(measured.shape)
                latent, latent_velocity = autoencoder.encoder_jacobian_vector_product(
                    measured, body.velocity, latent
                )
                answer = law.force(latent, latent_velocity, k * period)
            waiting.append(answer)
            force = waiting.pop(0)
            assert latent is not None
            rows.append((body.configuration, body.velocity, latent, latent_velocity, force))
            if k < steps:
                body.advance(force)
            on_step(k)
    return ClosedLoopRun(
        body.integrator.step, *(np.array(column) for column in zip(*rows, strict=True))
    )
