"""What a constant force can hold: static equilibria of the full body, and the one nearest a target.

The static bound of a target is the best that a controller which comes to rest with a constant force
on the actuated mass can do, of the equilibria that are stable without feedback. It is known before
anything runs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee
from tqdm import tqdm

from dpc_ros.control.equilibrium import EquilibriumError
from dpc_ros.control.force_search import next_force
from dpc_ros.control.saturation import shorten
from dpc_ros.network import Mechanics

STARTS = 20
_TOLERANCE = 1e-9  # N, largest component of the force that is out of balance
_RESOLUTION = 1e-13  # relative decrease that the potential still resolves in float64
_NEWTON_ITERATIONS = 200
_LONGEST_NEWTON_STEP = 5.0  # m, norm over all coordinates
_FIRST_SHIFT = 0.1  # N/m, added to the diagonal of a Hessian that is not positive
_LARGEST_FORCE_STEP = 1.0  # N between two equilibria of one search
_SEARCH_ITERATIONS = 60
_FORCE_TOLERANCE = 1e-7  # N
_START_FORCE = 15.0  # N, the forces that searches start from are up to this long


@dataclass(frozen=True, eq=False)
class StaticBound:
    """The constant force whose stable equilibrium is nearest to a target, of those that were found.

    Attributes:
        force: u [N] on the actuated mass.
        configuration: the equilibrium q [m].
        nmse: MSE(q, q̄)/MSE(q_rest, q̄), the static bound; infinite for the target rest where the
            body can't be held there.
        rms: root mean square of q − q̄ over the coordinates [m].
    """

    force: Float[np.ndarray, ' 2']
    configuration: Float[np.ndarray, ' n']
    nmse: float
    rms: float


class _Banded:
    """Solves Hx = b for positive matrices of one pattern, renumbered so that they are banded.

    A body's masses touch few others: the reverse Cuthill–McKee order leaves a narrow band.
    """

    def __init__(self, pattern: Float[np.ndarray, 'n n']) -> None:
        n = len(pattern)
        self._order = reverse_cuthill_mckee(csr_array(pattern != 0), symmetric_mode=True)
        row, column = np.nonzero(pattern[np.ix_(self._order, self._order)])
        width = int((column - row).max())
        above = np.arange(n) - np.arange(width, -1, -1)[:, None]  # row of each entry of the band
        self._outside = above < 0
        self._place = self._order[np.maximum(above, 0)] * n + self._order[None, :]

    def factor(self, matrix: Float[np.ndarray, 'n n']) -> Float[np.ndarray, 'width n']:
        """Return the Cholesky factor; LinAlgError where the matrix is not positive."""
        band = matrix.ravel()[self._place]
        band[self._outside] = 0.0
        return cholesky_banded(band, overwrite_ab=True, check_finite=False)

    def solve(self, factor: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Return x for one right-hand side, (n,), or several, (n, k)."""
        solution = np.empty_like(right)
        solution[self._order] = cho_solve_banded(
            (factor, False), right[self._order], check_finite=False
        )
        return solution


class ConstantForce:
    """A body under a constant force on one mass: its potential V(q) − uᵀGᵀq and the derivatives.

    Args:
        mechanics: the body in its field of gravity.
        actuated_mass: number of the mass that carries the force.

    Raises:
        NetworkError: the mass does not exist or is fixed.
    """

    def __init__(self, mechanics: Mechanics, actuated_mass: int) -> None:
        self.mechanics = mechanics
        self.input_field = mechanics.input_field(actuated_mass)
        hessian = mechanics.potential_hessian(mechanics.network.rest_configuration)
        masses = np.abs(hessian).reshape(len(hessian) // 2, 2, -1, 2).sum(axis=(1, 3)) > 0
        self._banded = _Banded(np.kron(masses, np.ones((2, 2))))

    def equilibrium(
        self, force: Float[np.ndarray, ' 2'], start: Float[np.ndarray, ' n']
    ) -> Float[np.ndarray, ' n']:
        """Return a stable static equilibrium q [m] under a force u [N].

        Minimises the potential from `start` by Newton's method with backtracking and a Hessian
        shifted to be positive: a minimum comes out, never a saddle (Nocedal and Wright, section
        3.4).

        Raises:
            EquilibriumError: no convergence within the bound on iterations, an equilibrium that is
                not stable, or a force or start that is not finite.
        """
        if not (np.isfinite(force).all() and np.isfinite(start).all()):
            raise EquilibriumError(f'expected a finite force and start, got {force} N')
        push = self.input_field @ force
        configuration = np.array(start, float)
        for _ in range(_NEWTON_ITERATIONS):
            gradient = self.mechanics.potential_gradient(configuration) - push
            value = self._value(configuration, push)
            direction, stable = self._direction(configuration, gradient)
            decrease = -float(gradient @ direction)
            if stable and decrease <= _RESOLUTION * max(abs(value), 1.0):
                configuration = configuration + direction
                break
            scale = 1.0
            while (
                scale > 1e-10
                and self._value(configuration + scale * direction, push)
                > value - 1e-4 * scale * decrease
            ):
                scale *= 0.5
            configuration = configuration + scale * direction
        out_of_balance = self.mechanics.potential_gradient(configuration) - push
        if not np.abs(out_of_balance).max() <= _TOLERANCE:
            raise EquilibriumError(
                f'no static equilibrium under the force {np.round(force, 3).tolist()} N within '
                f'{_NEWTON_ITERATIONS} steps'
            )
        if not self.is_stable(configuration):
            raise EquilibriumError(
                f'the equilibrium under the force {np.round(force, 3).tolist()} N is not stable'
            )
        return configuration

    def is_stable(self, configuration: Float[np.ndarray, ' n']) -> bool:
        """Return whether the potential has a strict minimum, its Hessian being positive there."""
        try:
            self._banded.factor(self.mechanics.potential_hessian(configuration))
        except LinAlgError:
            return False
        return True

    def slope(self, configuration: Float[np.ndarray, ' n']) -> Float[np.ndarray, 'n 2']:
        """Return ∂q_eq/∂u = (∇²V)⁻¹G [m/N] at a stable equilibrium.

        Raises:
            EquilibriumError: it is none.
        """
        try:
            factor = self._banded.factor(self.mechanics.potential_hessian(configuration))
        except LinAlgError as error:
            raise EquilibriumError('expected a stable equilibrium') from error
        return self._banded.solve(factor, self.input_field)

    def _value(self, configuration: np.ndarray, push: np.ndarray) -> float:
        return self.mechanics.potential(configuration) - float(push @ configuration)

    def _direction(
        self, configuration: np.ndarray, gradient: np.ndarray
    ) -> tuple[np.ndarray, bool]:
        """Return Newton's step, no longer than a bound, and whether the Hessian is positive.

        Where it is not, the smallest tried multiple of the identity is added that makes it so.
        """
        hessian = self.mechanics.potential_hessian(configuration)
        shift = 0.0
        while True:
            try:
                factor = self._banded.factor(hessian)
            except LinAlgError:
                added = max(3.0 * shift, _FIRST_SHIFT)
                hessian[np.diag_indices_from(hessian)] += added
                shift += added
                continue
            step = -self._banded.solve(factor, gradient)
            return shorten(step, _LONGEST_NEWTON_STEP), shift == 0.0


def static_bound(
    mechanics: Mechanics,
    actuated_mass: int,
    target: Float[np.ndarray, ' n'],
    largest_force: float = np.inf,
    starts: int = STARTS,
    seed: int = 0,
    progress: bool = False,
) -> StaticBound:
    """Return the best static equilibrium that searches from several starts find for a target.

    One search starts from the unforced body at rest, one from the equilibrium that the unforced
    body falls to from the target itself, the others from random forces, each reached from one of
    these two.

    Args:
        mechanics: the body in its field of gravity.
        actuated_mass: number of the mass that carries the force.
        target: q̄ [m].
        largest_force: bound on |u| [N].
        starts: how many searches, at least 2.
        seed: of the random forces.
        progress: show a progress bar.

    Raises:
        ValueError: fewer than 2 starts, a negative bound, or a target of another body.
        NetworkError: the mass does not exist or is fixed.
        EquilibriumError: no search found any equilibrium.
    """
    if starts < 2:
        raise ValueError(f'starts: expected at least 2, got {starts}')
    if not largest_force >= 0:
        raise ValueError(f'largest force: expected a number ≥ 0 N, got {largest_force}')
    body = ConstantForce(mechanics, actuated_mass)
    rest = mechanics.network.rest_configuration
    if target.shape != rest.shape or not np.isfinite(target).all():
        raise ValueError(f'target: expected {rest.size} finite numbers, got shape {target.shape}')
    draw = np.random.default_rng(seed)
    best: StaticBound | None = None
    for k in tqdm(range(starts), desc='searching', unit='start', disable=not progress):
        force = np.zeros(2)
        if k > 1:
            length, angle = draw.uniform(0, _START_FORCE), draw.uniform(0, 2 * np.pi)
            force = shorten(length * np.array([np.cos(angle), np.sin(angle)]), largest_force)
        try:
            unforced = body.equilibrium(np.zeros(2), (rest, target)[k % 2])
            found = nearest_equilibrium(body, target, force, unforced, largest_force)
        except EquilibriumError:
            continue
        if best is None or found.rms < best.rms:
            best = found
    if best is None:
        raise EquilibriumError('no static equilibrium was found from any start')
    return best


def nearest_equilibrium(
    body: ConstantForce,
    target: Float[np.ndarray, ' n'],
    force: Float[np.ndarray, ' 2'],
    start: Float[np.ndarray, ' n'],
    largest_force: float = np.inf,
) -> StaticBound:
    """Return the equilibrium nearest to a target on the branch that a force and a start lead to.

    Levenberg–Marquardt over the two components of the force (`next_force`), each trial's
    equilibrium continued from the present one with the slope ∂q_eq/∂u = (∇²V)⁻¹G.

    Args:
        body: the body under a constant force.
        target: q̄ [m].
        force: u to begin with [N].
        start: configuration to begin with [m].
        largest_force: bound on |u| [N].

    Raises:
        EquilibriumError: there is no equilibrium to begin with.
    """
    configuration = body.equilibrium(force, start)
    residual = configuration - target
    damping = 1e-3
    for _ in range(_SEARCH_ITERATIONS):
        try:
            slope = body.slope(configuration)
        except EquilibriumError:  # at the end of the branch
            break
        trial = next_force(force, slope, residual, damping, _LARGEST_FORCE_STEP, largest_force)
        if np.linalg.norm(trial - force) < _FORCE_TOLERANCE:
            break
        try:
            reached = body.equilibrium(trial, configuration + slope @ (trial - force))
        except EquilibriumError:
            damping *= 4.0
            continue
        new_residual = reached - target
        if new_residual @ new_residual < residual @ residual:
            force, configuration, residual = trial, reached, new_residual
            damping = max(damping / 4.0, 1e-9)
        else:
            damping *= 4.0
    mse = float(np.mean(residual**2))
    scale = float(np.mean((body.mechanics.network.rest_configuration - target) ** 2))
    nmse = mse / scale if scale else (np.inf if mse else 0.0)
    return StaticBound(force, configuration, nmse, float(np.sqrt(mse)))
