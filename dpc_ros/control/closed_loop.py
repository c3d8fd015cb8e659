"""The closed loop in one process, without ROS: what a lockstep run over DDS repeats bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder import Autoencoder
from dpc_ros.control.law import NANOSECOND, ControlLaw
from dpc_ros.control.observer import LatentObserver
from dpc_ros.network import Body
from dpc_ros.threads import single_threaded_algebra


@dataclass(frozen=True, eq=False)
class ClosedLoopRun:
    """What happened at each control step; force k acts from state k to state k + 1.

    Attributes:
        step: control step [s].
        configuration: q [m].
        velocity: q̇ [m/s].
        latent: ξ as the law got it, measured or estimated.
        latent_velocity: ξ̇, the same.
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
        velocity_noise: of that on every measured velocity [m/s].
        seed: of the noise.

    Raises:
        ValueError: a value is out of its range.
    """

    hold: int = 1
    latency: int = 0
    noise: float = 0.0
    velocity_noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        noises = (self.noise, self.velocity_noise)
        if not (
            self.hold >= 1 and self.latency >= 0 and all(0 <= each < np.inf for each in noises)
        ):
            raise ValueError(f'expected hold ≥ 1, latency ≥ 0 and finite noises ≥ 0, got {self}')


def run_closed_loop(
    body: Body,
    autoencoder: Autoencoder,
    law: ControlLaw,
    steps: int,
    on_step: Callable[[int], None] = lambda step: None,
    imperfections: Imperfections | None = None,
    observer: LatentObserver | None = None,
) -> ClosedLoopRun:
    """Run body, encoder and controller in turn: encode, compute the force, integrate one step.

    Args:
        body: the body where it stands; its time step is the control step.
        autoencoder: the encoder.
        law: the controller, its target already set.
        steps: number of steps; states 0 … steps are encoded and answered.
        on_step: called with the number of each state, for progress.
        imperfections: of measurement and timing; none where left out.
        observer: estimates the latent state between encoder and controller.
    """
    loop = imperfections or Imperfections()
    draw = np.random.default_rng(loop.seed)
    waiting = [np.zeros(2)] * loop.latency
    rows: list[tuple[np.ndarray, ...]] = []
    encoded: np.ndarray | None = None
    state = (np.zeros(0), np.zeros(0))  # until the first one is measured
    answer = np.zeros(2)
    period = round(body.integrator.step / NANOSECOND)  # ns, as the simulator's stamps
    with single_threaded_algebra():
        for k in range(steps + 1):
            if k % loop.hold == 0:
                stamp = k * period
                configuration = _noisy(body.configuration, loop.noise, draw)
                velocity = _noisy(body.velocity, loop.velocity_noise, draw)
                encoded, encoded_velocity = autoencoder.encoder_jacobian_vector_product(
                    configuration, velocity, encoded
                )
                state = encoded, encoded_velocity
                if observer is not None:
                    state = observer.estimate(*state, stamp)
                answer = law.force(*state, stamp)
                if observer is not None:
                    observer.acted(stamp, answer)
            waiting.append(answer)
            force = waiting.pop(0)
            rows.append((body.configuration, body.velocity, *state, force))
            if k < steps:
                body.advance(force)
            on_step(k)
    return ClosedLoopRun(
        body.integrator.step, *(np.array(column) for column in zip(*rows, strict=True))
    )


def _noisy(values: np.ndarray, deviation: float, draw: np.random.Generator) -> np.ndarray:
    return values + deviation * draw.standard_normal(values.shape) if deviation else values
