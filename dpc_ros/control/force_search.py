"""One step of a search over the constant force: Levenberg–Marquardt on a disk."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from dpc_ros.control.saturation import shorten

_ON_BOUND = 1e-9  # relative distance from the largest force within which a force lies on the bound


def next_force(
    force: Float[np.ndarray, ' 2'],
    slope: Float[np.ndarray, 'n 2'],
    residual: Float[np.ndarray, ' n'],
    damping: float,
    longest_step: float,
    largest_force: float,
) -> Float[np.ndarray, ' 2']:
    """Return the force to try next for a smaller |q_eq(u) − q̄| under |u| ≤ `largest_force`.

    A Levenberg–Marquardt step (Nocedal and Wright, Numerical Optimization, section 10.3). Where it
    would leave the disk from its edge, the step is the one along the edge, so that the search ends
    at the constrained optimum.

    Args:
        force: the present u [N].
        slope: ∂q_eq/∂u there [m/N].
        residual: q_eq(u) − q̄ [m].
        damping: of the step, relative to the trace of the normal matrix.
        longest_step: bound on the step [N].
        largest_force: bound on |u| [N].
    """
    normal, gradient = slope.T @ slope, slope.T @ residual
    damped = normal + damping * np.trace(normal) * np.eye(2)
    step = -np.linalg.solve(damped, gradient)
    length = float(np.linalg.norm(force))
    if length >= largest_force * (1 - _ON_BOUND) and length > 0 and force @ step > 0:
        along = np.array([-force[1], force[0]]) / length
        step = -(along @ gradient) / (along @ damped @ along) * along
    return shorten(force + shorten(step, longest_step), largest_force)
