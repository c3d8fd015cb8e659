"""Random networks have the size that was asked for, hold together and do not overlap."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

from dpc_ros.network import (
    GeneratorSettings,
    Gravity,
    Integrator,
    Mechanics,
    NetworkError,
    generate_network,
    generator,
    load_network,
    save_network,
    simulate,
)

SEEDS = st.integers(0, 2**32 - 1)
SETTINGS = st.builds(
    GeneratorSettings,
    squares=st.integers(0, 6),
    triangles=st.integers(1, 6),
    width=st.integers(2, 6),
    lateral_probability=st.floats(0, 1),
    lateral_decay=st.floats(0, 1),
    spacing=st.floats(0.01, 10),
)
DIAGONAL = math.sqrt(2)


def crossings(network):
    """Count the pairs of springs, without a mass in common, that cross."""
    ends = network.rest_position[network.springs]
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]

    def cross(a, b):
        return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]

    gap = start[None] - start[:, None]
    determinant = cross(along[:, None], along[None])
    with np.errstate(divide='ignore', invalid='ignore'):
        first = cross(gap, along[None]) / determinant
        second = cross(gap, along[:, None]) / determinant
    inside = 1e-6
    within = (first > inside) & (first < 1 - inside) & (second > inside) & (second < 1 - inside)
    return int((within & (np.abs(determinant) > 1e-9)).sum()) // 2


@given(SEEDS)
def test_default_has_the_size_of_the_papers_systems(paper_2, seed):
    network, paper = generate_network('any', seed), paper_2
    assert (len(network.mobile), len(network.springs)) == (200, 636)
    assert network.damping_kind == paper.damping_kind
    for key in ('fixed', 'mass', 'damping', 'stiffness', 'rest_length'):
        ours, theirs = np.sort(getattr(network, key)), np.sort(getattr(paper, key))
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)
    for key in ('background_stiffness', 'background_rest_fraction'):
        assert getattr(network, key) == pytest.approx(getattr(paper, key))
    np.testing.assert_allclose(network.rest_position[:5], paper.rest_position[:5], rtol=1e-12)


@given(SEEDS, SETTINGS)
def test_size_follows_from_the_pieces(seed, settings):
    network = generate_network('any', seed, settings)
    s, t, w = settings.squares, settings.triangles, settings.width
    assert len(network.fixed) == w
    assert len(network.mobile) == w * (w - 1) * s + w * (w - 1) * t // 2
    square, triangle = (w - 1) * (4 * w - 3), (w - 1) * (3 * w - 2) // 2
    assert len(network.springs) == w - 1 + square * s + triangle * t


@given(SEEDS, SETTINGS)
def test_nothing_overlaps(seed, settings):
    network = generate_network('any', seed, settings)
    assert pdist(network.rest_position).min() > 0.5 * settings.spacing
    # Springs cross within square cells only, once in each, and no two join the same masses.
    assert crossings(network) == settings.squares * (settings.width - 1) ** 2
    assert len(np.unique(np.sort(network.springs, axis=1), axis=0)) == len(network.springs)
    assert network.rest_position[:, 1].max() <= 1e-6 * settings.spacing


@given(SEEDS, SETTINGS)
def test_springs_are_as_long_as_at_rest(seed, settings):
    network = generate_network('any', seed, settings)
    ends = network.rest_position[network.springs]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    np.testing.assert_allclose(network.rest_length, length, rtol=1e-9)
    diagonal = length > 1.2 * settings.spacing
    np.testing.assert_allclose(length, settings.spacing * np.where(diagonal, DIAGONAL, 1.0))
    expected = np.where(diagonal, settings.diagonal_stiffness, settings.stiffness)
    np.testing.assert_array_equal(network.stiffness, expected)


@given(SEEDS)
def test_a_seed_gives_one_body(seed):
    network = generate_network('any', seed)
    assert generate_network('other', seed).digest == network.digest
    assert f'seed {seed}' in network.description


def test_seeds_give_different_bodies():
    assert len({generate_network('any', seed).digest for seed in range(20)}) == 20


def test_laterals_branch_off():
    def free_corners(chance):
        settings = GeneratorSettings(lateral_probability=chance)
        bodies = [generate_network('any', seed, settings) for seed in range(20)]
        return np.mean([(np.bincount(body.springs.ravel()) <= 3).sum() for body in bodies])

    assert free_corners(1.0) > free_corners(0.0) + 2


@pytest.mark.parametrize('seed', range(3))
def test_generated_bodies_hang_still_in_the_end(seed):
    settings = GeneratorSettings(squares=2, triangles=2, width=4)
    network = generate_network('any', seed, settings)
    mechanics = Mechanics(network, Gravity(9.81))
    rest = network.rest_configuration
    trajectory = simulate(Integrator(mechanics, 0.005), rest, np.zeros_like(rest), 4000)
    assert np.isfinite(trajectory.configuration).all()
    assert np.abs(trajectory.velocity[-1]).max() < 1e-2


def test_every_physical_setting_arrives(tmp_path):
    settings = GeneratorSettings(
        squares=1,
        triangles=1,
        width=3,
        spacing=0.5,
        mass=0.2,
        stiffness=3.0,
        diagonal_stiffness=4.0,
        damping_coefficient=0.7,
        damping_kind='axial',
        background_stiffness=0.9,
        background_rest_fraction=0.8,
    )
    network = generate_network('any', 0, settings)
    assert set(network.mass) == {0.2}
    assert set(network.damping) == {0.7}
    assert set(network.stiffness) == {3.0, 4.0}
    assert network.damping_kind == 'axial'
    assert (network.background_stiffness, network.background_rest_fraction) == (0.9, 0.8)
    save_network(network, tmp_path / 'any.json')
    assert load_network(tmp_path / 'any.json').identifier == network.identifier


@pytest.mark.parametrize(
    ('settings', 'message'),
    [
        ({'squares': -1}, 'squares: expected a whole number ≥ 0, got -1'),
        ({'triangles': 1.5}, 'triangles: expected a whole number ≥ 0, got 1.5'),
        ({'squares': True}, 'squares: expected a whole number'),
        ({'width': 1}, 'width: expected a whole number ≥ 2, got 1'),
        ({'squares': 0, 'triangles': 0}, 'expected at least one piece'),
        ({'lateral_probability': 1.5}, 'lateral_probability: expected a number from 0 to 1'),
        ({'lateral_decay': 2.0}, 'lateral_decay: expected a number from 0 to 1'),
        ({'spacing': 0.0}, 'spacing: expected a number > 0'),
        ({'mass': 0}, 'mass: expected a number > 0'),
    ],
)
def test_bad_settings_are_refused(settings, message):
    with pytest.raises(NetworkError, match=message):
        GeneratorSettings(**settings)


NUMBERS = [field.name for field in fields(GeneratorSettings) if field.type == 'float']


@pytest.mark.parametrize('key', NUMBERS)
@pytest.mark.parametrize('value', [-1.0, math.nan, math.inf, 'much'])
def test_numbers_have_to_be_finite_and_not_negative(key, value):
    with pytest.raises(NetworkError, match=f'{key}: expected a finite number ≥ 0, got'):
        replace(GeneratorSettings(), **{key: value})


@pytest.mark.parametrize('seed', [-1, 0.5, None, True])
def test_bad_seeds_are_refused(seed):
    with pytest.raises(NetworkError, match='seed: expected a whole number'):
        generate_network('any', seed)


@pytest.mark.parametrize(
    ('name', 'kind', 'message'),
    [('two words', 'axial', 'name: expected one word'), ('any', 'radial', 'damping_kind: ')],
)
def test_what_the_network_refuses(name, kind, message):
    settings = GeneratorSettings(squares=1, triangles=0, damping_kind=kind)
    with pytest.raises(NetworkError, match=message):
        generate_network(name, 0, settings)


def test_no_room_is_an_error(monkeypatch):
    monkeypatch.setattr(generator, '_ATTEMPTS', 2)
    crowded = GeneratorSettings(0, 100, lateral_probability=1.0, lateral_decay=1.0)
    with pytest.raises(NetworkError, match=r'100 triangles without overlaps, got none in 2'):
        generate_network('any', 0, crowded)
