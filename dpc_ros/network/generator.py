"""Random networks like the paper's: squares and triangles of mesh, chained with laterals."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from itertools import pairwise

import numpy as np
from tqdm import tqdm

from dpc_ros.network.mass_spring_network import MassSpringNetwork, NetworkError

_ATTEMPTS = 1000
_PATIENCE = 2.0  # s
_LEAST = {'squares': 0, 'triangles': 0, 'width': 2}
_CHANCES = ('lateral_probability', 'lateral_decay')
_POSITIVE = ('spacing', 'mass')
_ROUNDING = 1e-6  # of lengths in units of the spacing
_NEAREST = 0.51  # spacings between masses; two sides that meet at 30° come to 0.518


@dataclass(frozen=True)
class GeneratorSettings:
    """What a random network is made of; the defaults are the paper's (section A.1 and its data).

    A body has w + s·w(w − 1) + t·w(w − 1)/2 masses, the first w of them fixed, for s squares and
    t triangles of width w: 205 by default, with 636 springs, whatever the seed.

    Attributes:
        squares: number of square pieces, each of (w − 1)² cells with both diagonals.
        triangles: number of triangular pieces, each of (w − 1)² triangular cells.
        width: w, masses along a side of a piece.
        lateral_probability: chance that a lateral begins at a side that the chain leaves free.
        lateral_decay: factor on that chance with each further piece of the lateral.
        spacing: distance of neighbouring masses, the rest length of an edge [m].
        mass: of each point [kg].
        stiffness: of the edges [N/m].
        diagonal_stiffness: of the diagonals of square cells [N/m].
        damping_coefficient: d of every spring [N·s/m].
        damping_kind: `isotropic` or `axial`.
        background_stiffness: k_s [N/m].
        background_rest_fraction: c.

    Raises:
        NetworkError: a value is out of its range, or there is no piece.
    """

    squares: int = 7
    triangles: int = 6
    width: int = 5
    lateral_probability: float = 0.3
    lateral_decay: float = 0.6
    spacing: float = 0.3
    mass: float = 1 / 205
    stiffness: float = 50.0
    diagonal_stiffness: float = 100.0
    damping_coefficient: float = 0.1
    damping_kind: str = 'isotropic'
    background_stiffness: float = 0.2
    background_rest_fraction: float = 1 / 205

    def __post_init__(self) -> None:
        for field in fields(self):
            key, value = field.name, getattr(self, field.name)
            if key == 'damping_kind':
                continue  # the network's to check
            if key in _LEAST:
                least = _LEAST[key]
                if isinstance(value, bool) or not isinstance(value, int) or value < least:
                    raise NetworkError(f'{key}: expected a whole number ≥ {least}, got {value!r}')
            elif not isinstance(value, int | float) or not 0 <= value < math.inf:
                raise NetworkError(f'{key}: expected a finite number ≥ 0, got {value!r}')
            elif key in _CHANCES and value > 1:
                raise NetworkError(f'{key}: expected a number from 0 to 1, got {value}')
            elif key in _POSITIVE and value == 0:
                raise NetworkError(f'{key}: expected a number > 0, got {value}')
        if self.squares + self.triangles == 0:
            raise NetworkError('squares, triangles: expected at least one piece, got none')


def generate_network(
    name: str,
    seed: int = 0,
    settings: GeneratorSettings | None = None,
    progress: bool = False,
) -> MassSpringNetwork:
    """Return a random body that hangs from a fixed side; the same for the same seed and settings.

    Pieces are glued side to side. The chain goes on straight behind a square and turns by ±60°
    behind a triangle, never upwards; laterals begin at the sides that it leaves free. A body whose
    pieces overlap, or that rises above its support, is thrown away and drawn anew.

    Args:
        name: of the network.
        seed: of the random numbers, ≥ 0.
        settings: what it is made of, as in the paper where left out.
        progress: show a bar of the pieces where it takes more than two seconds.

    Raises:
        NetworkError: the seed or the name is bad, or no attempt gave a body without overlaps.
    """
    settings = settings or GeneratorSettings()
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise NetworkError(f'seed: expected a whole number ≥ 0, got {seed!r}')
    rng = np.random.default_rng(seed)
    pieces = settings.squares + settings.triangles
    with tqdm(total=pieces, delay=_PATIENCE, leave=False, disable=not progress) as bar:
        for attempt in range(1, _ATTEMPTS + 1):
            bar.set_description(f'attempt {attempt}', refresh=False)
            mesh = _Mesh(settings, rng)
            if mesh.grow(bar):
                return _network(name, seed, settings, mesh)
    raise NetworkError(
        f'seed {seed}: expected a body of {settings.squares} squares and {settings.triangles} '
        f'triangles without overlaps, got none in {_ATTEMPTS} attempts: '
        'take fewer triangles or another seed'
    )


class _Mesh:
    """A body while it grows; lengths in units of the spacing.

    A side is an array of masses in such an order that what is outside lies to the right.
    """

    def __init__(self, settings: GeneratorSettings, rng: np.random.Generator) -> None:
        width = settings.width
        self._settings = settings
        self._rng = rng
        self.position = np.column_stack([np.arange(width, dtype=float), np.zeros(width)])
        self.edges = list(pairwise(range(width)))
        self.diagonals: list[tuple[int, int]] = []
        self._outlines = np.empty((0, 4, 2))
        self._pieces = ['square'] * settings.squares + ['triangle'] * settings.triangles
        rng.shuffle(self._pieces)
        if settings.squares:  # the paper's all begin with one
            self._pieces.remove('square')
            self._pieces.append('square')

    def grow(self, bar: tqdm) -> bool:
        """Chain all pieces, counted by a bar; return whether there was room for them."""
        tip = np.arange(self._settings.width)
        while self._pieces:
            sides = self._attach(tip)
            if sides is None:
                return False
            onward, sideways = sides
            turns = [i for i, side in enumerate(onward) if self._outward(side)[1] < -_ROUNDING]
            tip = onward.pop(self._rng.choice(turns))
            for side in onward + sideways:
                self._grow_lateral(side)
            bar.update(len(self._outlines) - bar.n)
        return True

    def _grow_lateral(self, side: np.ndarray) -> None:
        chance = self._settings.lateral_probability
        while self._pieces and self._rng.random() < chance:
            sides = self._attach(side)
            if sides is None:
                return
            onward, _ = sides
            side = onward[self._rng.integers(len(onward))]
            chance *= self._settings.lateral_decay

    def _attach(self, side: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]] | None:
        """Glue the next piece to a side; return its free sides, onward and sideways.

        None where it would overlap the body or rise above the support; nothing is changed then.
        """
        square = self._pieces[-1] == 'square'
        start, end = self.position[side[[0, -1]]]
        along, out = (end - start) / (len(side) - 1), self._outward(side)
        rows, new = [side], [np.empty((0, 2))]
        for i in range(1, len(side)):
            step = out if square else 0.5 * along + 0.5 * math.sqrt(3) * out
            count = len(side) if square else len(side) - i
            first = len(self.position) + sum(len(row) for row in new)
            rows.append(np.arange(first, first + count))
            new.append(start + i * step + np.arange(count)[:, None] * along)
        points = np.concatenate(new)
        far = new[-1][0]
        # Four corners for a triangle, too: one of them halfway along a side.
        outline = np.array([start, end, new[-1][-1], far if square else 0.5 * (far + start)])
        if not self._has_room(points, outline):
            return None
        self._pieces.pop()
        self._outlines = np.concatenate([self._outlines, outline[None]])
        self.position = np.concatenate([self.position, points])
        for above, below in pairwise(rows):
            self.edges += [*pairwise(below), *zip(above, below, strict=False)]
            slanted = self.diagonals if square else self.edges
            slanted += zip(above[1:], below, strict=False)
            if square:
                slanted += zip(above, below[1:], strict=False)
        left = np.array([row[0] for row in rows])
        right = np.array([row[-1] for row in reversed(rows)])
        return ([rows[-1]], [left, right]) if square else ([left, right], [])

    def _outward(self, side: np.ndarray) -> np.ndarray:
        x, y = self.position[side[1]] - self.position[side[0]]
        return np.array([y, -x])

    def _has_room(self, points: np.ndarray, outline: np.ndarray) -> bool:
        if points[:, 1].max() > _ROUNDING:
            return False
        apart = np.linalg.norm(self.position[:, None] - points, axis=2)
        return apart.min() > _NEAREST and not _overlap(outline, self._outlines)


def _overlap(outline: np.ndarray, others: np.ndarray) -> bool:
    """Return whether a convex polygon shares more than an edge with any other of (k, corners, 2).

    Two convex polygons are apart where the normal of a side of one of them separates them.
    """
    apart = np.zeros(len(others), dtype=bool)
    for axes in (np.broadcast_to(_normals(outline), others.shape), _normals(others)):
        one, other = axes @ outline.T, axes @ others.swapaxes(1, 2)
        gap = np.maximum(one.min(axis=2) - other.max(axis=2), other.min(axis=2) - one.max(axis=2))
        apart |= (gap > -_ROUNDING).any(axis=1)
    return not apart.all()


def _normals(polygons: np.ndarray) -> np.ndarray:
    sides = np.roll(polygons, -1, axis=-2) - polygons
    return np.stack([sides[..., 1], -sides[..., 0]], axis=-1)


def _network(name: str, seed: int, settings: GeneratorSettings, mesh: _Mesh) -> MassSpringNetwork:
    masses, edges, diagonals = len(mesh.position), len(mesh.edges), len(mesh.diagonals)
    chosen = asdict(settings)
    lengths = np.repeat([1.0, math.sqrt(2)], [edges, diagonals])
    return MassSpringNetwork(
        name=name,
        mass=np.full(masses, settings.mass),
        fixed=np.arange(settings.width),
        rest_position=settings.spacing * mesh.position,
        springs=np.array(mesh.edges + mesh.diagonals),
        stiffness=np.repeat([settings.stiffness, settings.diagonal_stiffness], [edges, diagonals]),
        rest_length=settings.spacing * lengths,
        damping=np.full(edges + diagonals, settings.damping_coefficient),
        background_stiffness=settings.background_stiffness,
        background_rest_fraction=settings.background_rest_fraction,
        description=f'Random network of seed {seed}: {chosen}',
        damping_kind=settings.damping_kind,
    )
