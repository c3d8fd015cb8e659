"""The network as plain data: what it is made of, read from and written to JSON."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from dpc_ros.files import replacing
from dpc_ros.resources import find_resource

_DIGEST_LENGTH = 12
_WHOLE_NUMBERS = ('fixed', 'springs')
DAMPING_KINDS = ('isotropic', 'axial')


class NetworkError(ValueError):
    """A network that can't be a body: what was expected, what came, what to do."""


@dataclass(frozen=True, eq=False)
class MassSpringNetwork:
    """A planar network of point masses joined by springs with dampers in parallel.

    Masses are numbered from zero over all of them; `fixed` ones are a boundary condition. The
    configuration q ∈ ℝⁿ holds x₁ y₁ x₂ y₂ … of the *mobile* masses in ascending order.

    Attributes:
        name: a word that names the network in messages and files.
        mass: mass of each point [kg], > 0.
        fixed: numbers of the masses that do not move.
        rest_position: position of each mass at rest [m].
        springs: the two masses that each spring joins.
        stiffness: k of each spring [N/m], ≥ 0.
        rest_length: l of each spring [m], ≥ 0.
        damping: d of the damper beside each spring [N·s/m], ≥ 0.
        background_stiffness: k_s, the small stiffness of ½k_s|d − c·d⁰|² on each spring [N/m], ≥ 0.
        background_rest_fraction: c, the fraction of the rest vector d⁰ at which that term is zero.
        description: free text.
        damping_kind: what the dampers resist: `isotropic`, all relative motion of their two
            masses, or `axial`, only the part of it along the spring.

    Raises:
        NetworkError: a value has the wrong shape, sign or is not finite, a spring joins masses
            that do not exist, or a mass is connected to no fixed one.
    """

    name: str
    mass: Float[np.ndarray, ' masses']
    fixed: Int[np.ndarray, ' fixed']
    rest_position: Float[np.ndarray, 'masses 2']
    springs: Int[np.ndarray, 'springs 2']
    stiffness: Float[np.ndarray, ' springs']
    rest_length: Float[np.ndarray, ' springs']
    damping: Float[np.ndarray, ' springs']
    background_stiffness: float = 0.0
    background_rest_fraction: float = 0.0
    description: str = ''
    damping_kind: str = 'isotropic'

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, field.name, _frozen(field.name, value))
            elif isinstance(value, int):  # the digest is one of floats
                object.__setattr__(self, field.name, _float(field.name, value))
        _check(self)

    @cached_property
    def mobile(self) -> Int[np.ndarray, ' mobile']:
        """Numbers of the masses that move, ascending."""
        return np.setdiff1d(np.arange(len(self.mass)), self.fixed)

    @property
    def configuration_size(self) -> int:
        """Return n, the number of mobile coordinates."""
        return 2 * len(self.mobile)

    @cached_property
    def rest_configuration(self) -> Float[np.ndarray, ' n']:
        """Configuration of the rest position [m]."""
        return self.rest_position[self.mobile].ravel()

    @cached_property
    def mobile_edges(self) -> Int[np.ndarray, 'edges 2']:
        """Pairs of mobile masses that a spring joins, by their places among the mobile ones."""
        place = np.full(len(self.mass), -1)
        place[self.mobile] = np.arange(len(self.mobile))
        edges = place[self.springs]
        return edges[(edges >= 0).all(axis=1)]

    @cached_property
    def coordinate_names(self) -> list[str]:
        """Names of the coordinates of q, from `mass_007/x` and `mass_007/y` on."""
        return [f'mass_{i:03d}/{axis}' for i in self.mobile for axis in 'xy']

    @cached_property
    def digest(self) -> str:
        """Twelve hexadecimal digits that change with anything the mechanics depends on."""
        sha = hashlib.sha256()
        for field in fields(self):
            if field.name in ('name', 'description'):
                continue
            if field.name == 'damping_kind' and self.damping_kind == 'isotropic':
                continue  # as if it stood in no file: older ones do not have it
            value = np.asarray(getattr(self, field.name))
            sha.update(f'{field.name}{value.shape}'.encode())
            sha.update(np.ascontiguousarray(value).astype(value.dtype.newbyteorder('<')).tobytes())
        return sha.hexdigest()[:_DIGEST_LENGTH]

    @property
    def identifier(self) -> str:
        """`<name>@<digest>`, the `frame_id` of its configurations."""
        return f'{self.name}@{self.digest}'

    def positions(
        self, configuration: Float[np.ndarray, '*batch n']
    ) -> Float[np.ndarray, '*batch masses 2']:
        """Return where all masses are, the fixed ones too [m].

        Raises:
            NetworkError: the configuration is not one of this network, or not finite.
        """
        shape = np.shape(configuration)
        if shape[-1:] != (self.configuration_size,) or not np.isfinite(configuration).all():
            raise NetworkError(
                f'configuration: expected {self.configuration_size} finite numbers for '
                f'{self.name}, got an array of shape {shape}'
            )
        positions = np.empty((*shape[:-1], *self.rest_position.shape))
        positions[..., self.fixed, :] = self.rest_position[self.fixed]
        mobile = (*shape[:-1], len(self.mobile), 2)
        positions[..., self.mobile, :] = np.reshape(configuration, mobile)
        return positions

    def strains(
        self, configuration: Float[np.ndarray, '*batch n']
    ) -> Float[np.ndarray, '*batch springs']:
        """Return (|d| − l)/l of each spring; of one whose rest length is zero, |d| per metre.

        Raises:
            NetworkError: the configuration is not one of this network, or not finite.
        """
        ends = self.positions(configuration)[..., self.springs, :]
        length = np.linalg.norm(ends[..., 0, :] - ends[..., 1, :], axis=-1)
        return (length - self.rest_length) / np.where(self.rest_length > 0, self.rest_length, 1.0)

    def mobile_index(self, mass: int) -> int:
        """Return the place of a mass among the mobile ones.

        Raises:
            NetworkError: the mass does not exist or is fixed.
        """
        if not 0 <= mass < len(self.mass):
            raise NetworkError(
                f'{self.name} has no mass {mass}: masses are numbered 0 to {len(self.mass) - 1}'
            )
        if mass in self.fixed:
            raise NetworkError(
                f'mass {mass} of {self.name} is fixed and can carry no force: '
                f'choose another than {self.fixed.tolist()}'
            )
        return int(np.searchsorted(self.mobile, mass))


def load_network(name_or_path: str | Path) -> MassSpringNetwork:
    """Read a network from a JSON file, or a shipped one by its name (`paper_1` … `paper_5`).

    Raises:
        FileNotFoundError: there is no such file.
        NetworkError: the file is not JSON, a key is missing or unknown, or the network is invalid.
    """
    path = find_resource(name_or_path, 'systems', '.json')
    try:
        content = json.loads(path.read_text())
    except (ValueError, RecursionError) as error:
        raise NetworkError(f'{path}: expected a network as JSON, but {error}') from error
    if not isinstance(content, dict):
        raise NetworkError(f'{path}: expected a JSON object, got a {type(content).__name__}')
    try:
        return _from_json(content)
    except NetworkError as error:
        raise NetworkError(f'{path}: {error}') from error


def save_network(network: MassSpringNetwork, path: str | Path) -> None:
    """Write a network as JSON; `load_network` gives it back with the same digest."""
    content: dict[str, Any] = {}
    for field in fields(network):
        value = getattr(network, field.name)
        content[field.name] = value.tolist() if isinstance(value, np.ndarray) else value
    content['units'] = 'SI: m, kg, N/m, N s/m'
    with replacing(path) as partial:
        partial.write_text(json.dumps(content) + '\n')


def _from_json(content: dict[str, Any]) -> MassSpringNetwork:
    known = {field.name for field in fields(MassSpringNetwork)}
    optional = {'background_stiffness', 'background_rest_fraction', 'description', 'damping_kind'}
    missing = sorted(known - optional - content.keys())
    if missing:
        raise NetworkError(f'expected the keys {missing}, which are missing')
    unknown = sorted(content.keys() - known - {'units'})
    if unknown:
        raise NetworkError(f'unknown keys {unknown}: a network has {sorted(known)}')
    rest_position = _array(content['rest_position'], 'rest_position', float)
    mass = content['mass']
    if isinstance(mass, int | float):
        mass = [mass] * len(rest_position)
    return MassSpringNetwork(
        name=content['name'],
        description=content.get('description', ''),
        mass=_array(mass, 'mass', float),
        fixed=_array(content['fixed'], 'fixed', int),
        rest_position=rest_position,
        springs=_array(content['springs'], 'springs', int),
        stiffness=_array(content['stiffness'], 'stiffness', float),
        rest_length=_array(content['rest_length'], 'rest_length', float),
        damping=_array(content['damping'], 'damping', float),
        background_stiffness=_number(content, 'background_stiffness'),
        background_rest_fraction=_number(content, 'background_rest_fraction'),
        damping_kind=content.get('damping_kind', 'isotropic'),
    )


def _array(value: Any, key: str, kind: type) -> np.ndarray:
    kinds, what = ('if', 'numbers') if kind is float else ('i', 'whole numbers')
    if not isinstance(value, list):
        raise NetworkError(f'{key}: expected an array of {what}, got {value!r}')
    try:
        array = np.array(value)
    except ValueError:
        lengths = [len(row) if isinstance(row, list) else 0 for row in value]
        odd = next((i for i, length in enumerate(lengths) if length != lengths[0]), 0)
        raise NetworkError(_entry(key, 'rows of equal length', odd, value)) from None
    if array.size and array.dtype.kind not in kinds:
        # Numbers of both kinds may stand side by side: it is an entry that is none of the kind.
        for place, entry in enumerate(value):
            if np.array(entry).dtype.kind not in kinds:
                raise NetworkError(_entry(key, f'an array of {what}', place, value))
    return array.astype(kind)


def _number(content: dict[str, Any], key: str) -> float:
    value = content.get(key, 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise NetworkError(f'{key}: expected a number, got {value!r}')
    try:
        return float(value)
    except OverflowError:
        raise NetworkError(f'{key}: expected a finite number, got one too large') from None


def _float(name: str, value: int) -> float:
    try:
        return float(value)
    except OverflowError as error:
        raise NetworkError(f'{name}: expected a number of at most 1.8e308') from error


def _frozen(key: str, value: np.ndarray) -> np.ndarray:
    whole = key in _WHOLE_NUMBERS
    if whole and value.size and not np.issubdtype(value.dtype, np.integer):
        raise NetworkError(f'{key}: expected whole numbers, got an array of {value.dtype}')
    frozen = np.array(value, dtype=np.int64 if whole else np.float64, order='C')
    frozen.flags.writeable = False
    return frozen


def _check(network: MassSpringNetwork) -> None:
    if not isinstance(network.name, str) or not network.name or not network.name.isidentifier():
        raise NetworkError(
            f'name: expected one word of letters, digits and underscores, got {network.name!r}'
        )
    if network.damping_kind not in DAMPING_KINDS:
        raise NetworkError(
            f'damping_kind: expected one of {DAMPING_KINDS}, got {network.damping_kind!r}'
        )
    masses = len(network.rest_position)
    _check_shapes(network, masses)
    _check_values(network)
    _check_indices('fixed', network.fixed, masses)
    _check_indices('springs', network.springs, masses)
    if len(np.unique(network.fixed)) != len(network.fixed):
        raise NetworkError('fixed: a mass is named twice')
    if not 0 < len(network.fixed) < masses:
        raise NetworkError(
            f'fixed: expected at least one fixed and one mobile mass, '
            f'got {len(network.fixed)} fixed of {masses}'
        )
    loops = np.flatnonzero(network.springs[:, 0] == network.springs[:, 1])
    if len(loops):
        mass = network.springs[loops[0], 0]
        raise NetworkError(f'springs: spring {loops[0]} joins mass {mass} to itself')
    _check_connected(network, masses)


def _check_shapes(network: MassSpringNetwork, masses: int) -> None:
    springs = len(network.springs)
    shapes = {
        'rest_position': (masses, 2),
        'mass': (masses,),
        'fixed': (len(network.fixed),),
        'springs': (springs, 2),
        'stiffness': (springs,),
        'rest_length': (springs,),
        'damping': (springs,),
    }
    for key, expected in shapes.items():
        shape = getattr(network, key).shape
        if shape != expected:
            raise NetworkError(
                f'{key}: expected shape {expected} for {masses} masses and {springs} springs, '
                f'got {shape}'
            )


def _check_values(network: MassSpringNetwork) -> None:
    for key in ('rest_position', 'mass', 'stiffness', 'rest_length', 'damping'):
        value = getattr(network, key)
        bad = np.flatnonzero(~np.isfinite(value).reshape(len(value), -1).all(axis=1))
        if len(bad):
            raise NetworkError(_entry(key, 'finite numbers', bad[0], value))
    for key in ('background_stiffness', 'background_rest_fraction'):
        if not np.isfinite(getattr(network, key)):
            raise NetworkError(f'{key}: expected a finite number, got {getattr(network, key)}')
    for key in ('stiffness', 'rest_length', 'damping', 'background_stiffness'):
        value = np.atleast_1d(getattr(network, key))
        bad = np.flatnonzero(value < 0)
        if len(bad):
            raise NetworkError(_entry(key, 'no negative value', bad[0], value))
    bad = np.flatnonzero(network.mass <= 0)
    if len(bad):
        raise NetworkError(_entry('mass', 'positive masses', bad[0], network.mass))


def _entry(key: str, expected: str, place: int, value: np.ndarray | list) -> str:
    return f'{key}: expected {expected}, but entry {place} is {value[place]}'


def _check_indices(key: str, indices: np.ndarray, masses: int) -> None:
    bad = np.argwhere((indices < 0) | (indices >= masses))
    if len(bad):
        entry = tuple(bad[0])
        raise NetworkError(
            f'{key}: entry {entry[0]} names mass {indices[entry]}, which does not exist: '
            f'the {masses} masses are numbered 0 to {masses - 1}'
        )


def _check_connected(network: MassSpringNetwork, masses: int) -> None:
    first, second = network.springs.T
    held = np.zeros(masses, dtype=bool)
    held[network.fixed] = True
    count = 0
    while count < held.sum():  # by one spring further from the fixed ones each time
        count = held.sum()
        held[first[held[second]]] = True
        held[second[held[first]]] = True
    loose = np.flatnonzero(~held)
    if len(loose):
        raise NetworkError(
            f'springs: mass {loose[0]} is disconnected, no chain of springs leads from it to a '
            f'fixed mass ({len(loose)} such masses): add a spring or remove the mass'
        )
