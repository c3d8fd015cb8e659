"""Networks come back from JSON as they were, and no bad one gets in."""

import json
import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.network import DAMPING_KINDS, NetworkError, load_network, save_network
from dpc_ros.resources import config_path

SYSTEMS = [f'paper_{i}' for i in range(1, 6)]
ARRAYS = ['mass', 'fixed', 'rest_position', 'springs', 'stiffness', 'rest_length', 'damping']


@pytest.fixture
def content(small_network, tmp_path):
    """A valid network as the content of its JSON file."""
    save_network(small_network, tmp_path / 'good.json')
    return json.loads((tmp_path / 'good.json').read_text())


@pytest.fixture
def load(tmp_path):
    """Write content (or text) as a file and load it."""

    def write_and_load(content):
        path = tmp_path / 'network.json'
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return load_network(path)

    return write_and_load


def with_entry(key, entry, value):
    """Return a change: put a value at an entry of a list."""

    def change(content):
        target = content
        *way, last = (key, *np.atleast_1d(entry).tolist())
        for part in way:
            target = target[part]
        target[last] = value

    return change


def with_key(key, value):
    """Return a change: put a value at a key."""
    return lambda content: content.update({key: value})


def cut_loose(content):
    content['springs'] = [pair for pair in content['springs'] if 14 not in pair]
    for key in ('stiffness', 'rest_length', 'damping'):
        content[key] = content[key][: len(content['springs'])]


@pytest.mark.parametrize('name', SYSTEMS)
def test_the_shipped_systems_are_the_papers(name):
    network = load_network(name)
    assert network.name == name
    assert (len(network.mass), len(network.fixed), len(network.springs)) == (205, 5, 636)
    assert network.configuration_size == 400
    np.testing.assert_allclose(network.mass, 1 / 205)
    np.testing.assert_allclose(network.damping, 0.1)
    assert network.background_stiffness == pytest.approx(0.2)
    assert network.background_rest_fraction == pytest.approx(1 / 205)
    diagonal = network.rest_length > 0.3 * 1.2
    np.testing.assert_allclose(network.rest_length, np.where(diagonal, 0.3 * math.sqrt(2), 0.3))
    np.testing.assert_allclose(network.stiffness[~diagonal], 50.0)
    assert set(network.stiffness) == {50.0, 100.0}


def test_the_shipped_checkpoints_know_their_network():
    checkpoint = json.loads(config_path('checkpoints', 'paper_2_flat_m2.json').read_text())
    assert load_network('paper_2').digest == checkpoint['network']['digest'] == '69bb9fad8f83'


def test_the_shipped_systems_are_five_bodies():
    assert len({load_network(name).digest for name in SYSTEMS}) == 5


@given(st.integers(0, 2**32 - 1))
def test_round_trip_keeps_every_value_and_the_digest(random_network, tmp_path_factory, seed):
    kind = DAMPING_KINDS[seed % 2]
    network = replace(random_network(seed), damping_kind=kind)
    path = tmp_path_factory.mktemp('network') / 'network.json'
    save_network(network, path)
    loaded = load_network(path)
    assert loaded.identifier == network.identifier
    for field in fields(network):
        np.testing.assert_array_equal(getattr(loaded, field.name), getattr(network, field.name))


def test_round_trip_keeps_the_digest_of_whole_numbers(small_network, tmp_path):
    network = replace(
        small_network,
        mass=np.full(15, 2),
        stiffness=np.full(len(small_network.springs), 50),
        background_stiffness=1,
    )
    save_network(network, tmp_path / 'network.json')
    assert load_network(tmp_path / 'network.json').digest == network.digest
    as_floats = replace(network, mass=np.full(15, 2.0), background_stiffness=1.0)
    assert as_floats.digest == network.digest


@pytest.mark.parametrize('key', ['mass', 'rest_position', 'stiffness', 'rest_length', 'damping'])
def test_any_physical_value_changes_the_digest(small_network, key):
    value = getattr(small_network, key)
    for entry in np.ndindex(value.shape):
        changed = value.copy()
        changed[entry] = np.nextafter(changed[entry], np.inf)
        assert replace(small_network, **{key: changed}).digest != small_network.digest


@pytest.mark.parametrize(
    'changes',
    [
        {'background_stiffness': 0.3},
        {'background_rest_fraction': 0.3},
        {'fixed': np.array([0, 1])},
        {'damping_kind': 'axial'},
    ],
)
def test_background_supports_and_kind_of_damping_change_the_digest(small_network, changes):
    assert replace(small_network, **changes).digest != small_network.digest


def test_another_spring_changes_the_digest(small_network):
    springs = small_network.springs.copy()
    springs[0] = [0, 14]
    assert replace(small_network, springs=springs).digest != small_network.digest


def test_words_do_not_change_the_digest(small_network):
    renamed = replace(small_network, name='other', description='says something else')
    assert renamed.digest == small_network.digest
    assert renamed.identifier == f'other@{small_network.digest}'


def test_optional_keys_have_defaults_and_one_mass_stands_for_all(content, load):
    for key in (
        'background_stiffness',
        'background_rest_fraction',
        'damping_kind',
        'description',
        'units',
    ):
        del content[key]
    content['mass'] = 0.25
    network = load(content)
    np.testing.assert_array_equal(network.mass, np.full(15, 0.25))
    assert (network.background_stiffness, network.background_rest_fraction) == (0.0, 0.0)
    assert network.damping_kind == 'isotropic'


def test_mobile_masses_and_coordinates_ascend(small_network):
    shuffled = replace(small_network, fixed=np.array([2, 0, 1]))
    np.testing.assert_array_equal(shuffled.mobile, np.arange(3, 15))
    assert shuffled.coordinate_names[:3] == ['mass_003/x', 'mass_003/y', 'mass_004/x']
    assert len(shuffled.coordinate_names) == shuffled.configuration_size == 24
    assert [shuffled.mobile_index(mass) for mass in shuffled.mobile] == list(range(12))


def test_values_can_not_be_changed(small_network):
    for key in ARRAYS:
        with pytest.raises(ValueError, match='read-only'):
            getattr(small_network, key)[0] = 0


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (with_entry('springs', [3, 1], 15), r'springs: entry 3 names mass 15.*0 to 14'),
        (with_entry('springs', [3, 0], -1), r'springs: entry 3 names mass -1'),
        (with_entry('springs', 4, [7, 7]), r'springs: spring 4 joins mass 7 to itself'),
        (with_entry('springs', 4, [7]), r'springs: .*entry 4'),
        (with_entry('springs', 4, [7, 8.5]), r'springs: .*whole numbers.*entry 4'),
        (with_key('springs', [0, 1, 1, 2]), r'springs: expected shape'),
        (with_key('springs', [[0, 1, 2]]), r'springs: expected shape'),
        (with_key('springs', 3), r'springs: expected an array of whole numbers'),
        (with_key('springs', []), r'(springs|stiffness): '),
        (cut_loose, r'springs: mass 14 is disconnected'),
        (with_entry('fixed', 1, 15), r'fixed: entry 1 names mass 15.*0 to 14'),
        (with_entry('fixed', 1, 0), r'fixed: a mass is named twice'),
        (with_entry('fixed', 1, 'top'), r'fixed: .*whole numbers.*entry 1 is top'),
        (with_key('fixed', []), r'fixed: expected at least one fixed'),
        (with_key('fixed', list(range(15))), r'fixed: .*one mobile mass'),
        (with_key('fixed', 1), r'fixed: expected an array of whole numbers'),
        (with_entry('stiffness', 2, -50.0), r'stiffness: .*negative.*entry 2 is -50'),
        (with_entry('rest_length', 2, -0.1), r'rest_length: .*negative.*entry 2'),
        (with_entry('damping', 2, -0.1), r'damping: .*negative.*entry 2'),
        (with_entry('mass', 6, 0.0), r'mass: expected positive masses, but entry 6'),
        (with_entry('mass', 6, -1.0), r'mass: expected positive masses, but entry 6'),
        (with_entry('mass', 6, math.nan), r'mass: .*finite.*entry 6 is nan'),
        (with_entry('mass', 6, math.inf), r'mass: .*finite.*entry 6 is inf'),
        (with_entry('stiffness', 2, math.nan), r'stiffness: .*finite.*entry 2 is nan'),
        (with_entry('rest_position', [8, 0], math.nan), r'rest_position: .*finite.*entry 8'),
        (with_entry('stiffness', 2, None), r'stiffness: .*numbers.*entry 2 is None'),
        (with_entry('rest_position', [8, 1], None), r'rest_position: .*numbers.*entry 8'),
        (with_entry('mass', 6, 'heavy'), r'mass: .*numbers.*entry 6 is heavy'),
        (with_entry('mass', 6, 10**400), r'mass: .*numbers.*entry 6'),
        (with_key('mass', True), r'mass: '),
        (with_key('mass', None), r'mass: expected an array of numbers'),
        (with_key('mass', [1.0, 2.0]), r'mass: expected shape \(15,\).*got \(2,\)'),
        (with_key('stiffness', [50.0]), r'stiffness: expected shape .*got \(1,\)'),
        (with_key('stiffness', 50.0), r'stiffness: expected an array of numbers'),
        (with_key('rest_position', [0.0, 1.0]), r'rest_position: expected shape'),
        (with_key('rest_position', [[0.0, 1.0, 2.0]] * 15), r'rest_position: expected shape'),
        (with_key('rest_position', 1.0), r'rest_position: expected an array of numbers'),
        (with_key('background_stiffness', -0.2), r'background_stiffness: .*negative'),
        (with_key('background_stiffness', None), r'background_stiffness: expected a number'),
        (with_key('background_stiffness', True), r'background_stiffness: expected a number'),
        (with_key('background_stiffness', 10**400), r'background_stiffness: expected a'),
        (with_key('background_rest_fraction', math.nan), r'background_rest_fraction: .*finite'),
        (with_key('damping_kind', 'radial'), r"damping_kind: .*'isotropic', 'axial'.*'radial'"),
        (with_key('damping_kind', ['axial']), r'damping_kind: expected one of'),
        (with_key('damping_kind', None), r'damping_kind: expected one of'),
        (with_key('name', ''), r'name: expected one word'),
        (with_key('name', 'two words'), r'name: expected one word'),
        (with_key('name', None), r'name: expected one word'),
        (with_key('colour', 'red'), r"unknown keys \['colour'\]"),
        (lambda content: content.pop('damping'), r"expected the keys \['damping'\]"),
    ],
)
def test_bad_networks_are_refused(content, load, change, message):
    change(content)
    with pytest.raises(NetworkError, match=message) as caught:
        load(content)
    assert 'network.json' in str(caught.value)


@pytest.mark.parametrize('text', ['', '{"name": ', '[1, 2]', '3', 'null', 'name: grid'])
def test_files_that_hold_no_network_are_refused(load, text):
    with pytest.raises(NetworkError, match=r'network\.json: expected a'):
        load(text)


def test_binary_files_are_refused(tmp_path):
    path = tmp_path / 'network.json'
    path.write_bytes(bytes(range(256)))
    with pytest.raises(NetworkError, match='expected a network as JSON'):
        load_network(path)


@pytest.mark.parametrize('name', ['paper_9', './no/such/file.json', 'nothing.json'])
def test_missing_files_name_the_shipped_systems(name):
    with pytest.raises(FileNotFoundError, match=r'paper_1, paper_2, paper_3, paper_4, paper_5'):
        load_network(name)


def test_fractions_are_no_mass_numbers(small_network):
    with pytest.raises(NetworkError, match='fixed: expected whole numbers'):
        replace(small_network, fixed=np.array([0.5, 1.0]))


def test_positions_hold_the_fixed_masses_and_the_configuration(random_network, random_state):
    network = random_network(5)
    q, _ = random_state(5, network)
    positions = network.positions(q)
    np.testing.assert_array_equal(positions[network.mobile].ravel(), q)
    np.testing.assert_array_equal(positions[network.fixed], network.rest_position[network.fixed])
    many = np.stack([q, network.rest_configuration])
    np.testing.assert_array_equal(network.positions(many)[0], positions)
    assert network.positions(many[:0]).shape == (0, *network.rest_position.shape)
    with pytest.raises(NetworkError, match='finite numbers'):
        network.positions(q[:-1])
    with pytest.raises(NetworkError, match='finite numbers'):
        network.positions(np.full_like(q, np.nan))


def test_a_body_that_is_a_quarter_larger_is_strained_by_a_quarter(paper_2):
    rest = paper_2.rest_configuration
    np.testing.assert_allclose(paper_2.strains(rest), 0, atol=1e-9)
    larger = replace(paper_2, rest_position=1.25 * paper_2.rest_position)
    np.testing.assert_allclose(larger.strains(1.25 * rest), 0.25, atol=1e-9)


def test_a_spring_without_rest_length_is_strained_by_its_length(paper_2):
    network = replace(paper_2, rest_length=np.zeros(len(paper_2.springs)))
    lengths = np.linalg.norm(np.diff(paper_2.rest_position[paper_2.springs], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(network.strains(network.rest_configuration), lengths, atol=1e-14)


@pytest.mark.parametrize('name', ['damping_kind', 'background_stiffness'])
def test_a_whole_number_beyond_all_floats_is_refused(content, load, name):
    with pytest.raises(NetworkError, match=name):
        load(content | {name: 10**400})
