"""Targets mean what they say, and a bad one says what was expected."""

import json

import numpy as np
import pytest

from dpc_ros.control import Target, TargetError, load_target
from dpc_ros.data import simulate_conditions
from dpc_ros.data.conditions import training_conditions


@pytest.mark.parametrize('step', [0, 1, 400, 1000])
def test_a_simulated_target_is_a_state_of_the_simulation(paper_2, step):
    # Simulation 2 continues from the end of simulation 1.
    (_, _), (_, second) = simulate_conditions(paper_2, training_conditions()[:2])
    target = load_target(f'simulation:2@{step}', paper_2)
    np.testing.assert_array_equal(target.configuration, second.configuration[step])
    assert target.latent is None


def test_every_simulation_can_be_named(paper_2, paper_trajectories):
    for condition, trajectory in paper_trajectories(paper_2):
        target = load_target(f'simulation:{condition.simulation}@250', paper_2)
        np.testing.assert_array_equal(target.configuration, trajectory.configuration[250])


def test_rest_is_the_rest_configuration(small_network):
    target = load_target('rest', small_network)
    np.testing.assert_array_equal(target.configuration, small_network.rest_configuration)


@pytest.mark.parametrize('key', ['configuration', 'latent'])
def test_a_file_holds_a_configuration_or_a_latent(small_network, tmp_path, key):
    path = tmp_path / 'target.json'
    path.write_text(json.dumps({key: [0.5, 1, -2.0], 'comment': 'anything'}))
    target = load_target(str(path), small_network)
    np.testing.assert_array_equal(getattr(target, key), [0.5, 1.0, -2.0])


@pytest.mark.parametrize(
    ('specification', 'message'),
    [
        ('simulation:', r'expected `simulation:<number>@<step>`'),
        ('simulation:2', r'expected `simulation:<number>@<step>`'),
        ('simulation:2@', r'expected `simulation:<number>@<step>`'),
        ('simulation:two@3', r'expected `simulation:<number>@<step>`'),
        ('simulation:2@3.5', r'expected `simulation:<number>@<step>`'),
        ('simulation:2@3@4', r'expected `simulation:<number>@<step>`'),
        ('simulation:9@3', r'one of the simulations \[1, 2, 3, 4, 5, 6, 7\]'),
        ('simulation:-1@3', r'one of the simulations'),
        ('simulation:2@1001', r'a step of 0 to 1000 \(0\.005 s each\)'),
        ('simulation:2@-1', r'a step of 0 to 1000'),
        ('', r'no such file; expected `simulation'),
        ('~nouser/x.json', r'no such file; expected `simulation'),
        ('nowhere.json', r'no such file; expected `simulation'),
    ],
)
def test_bad_specifications_are_refused(small_network, specification, message):
    with pytest.raises(TargetError, match=message) as caught:
        load_target(specification, small_network)
    assert repr(specification) in str(caught.value)


@pytest.mark.parametrize(
    'text',
    [
        '',
        '{"configuration": [1.0, ',
        '[1.0, 2.0]',
        '3',
        'null',
        '{}',
        '{"position": [1.0]}',
        '{"configuration": [1.0], "latent": [1.0]}',
        '{"configuration": null}',
        '{"configuration": 1.0}',
        '{"configuration": [[1.0], [2.0]]}',
        '{"configuration": [[1.0], 2.0]}',
        '{"configuration": ["one"]}',
        '{"configuration": {"x": 1.0}}',
        '{"configuration": [1' + '0' * 400 + ']}',
        '{"latent": [true]}',
        '{"latent": [1.0, false]}',
        '{"latent": ["1"]}',
        '{"latent": "12"}',
        '{"latent": ' + '[' * 100_000 + ']' * 100_000 + '}',
    ],
    ids=lambda text: text[:40],
)
def test_bad_files_are_refused(small_network, tmp_path, text):
    path = tmp_path / 'target.json'
    path.write_text(text)
    with pytest.raises(TargetError, match=r'target\.json.*"configuration" or "latent"'):
        load_target(str(path), small_network)


@pytest.mark.parametrize('value', ['NaN', 'Infinity', 'null'])
def test_values_in_a_file_have_to_be_finite(small_network, tmp_path, value):
    path = tmp_path / 'target.json'
    path.write_text(f'{{"latent": [1.0, {value}]}}')
    with pytest.raises(TargetError, match='finite numbers, but number 1 is'):
        load_target(str(path), small_network)


def test_binary_files_are_refused(small_network, tmp_path):
    path = tmp_path / 'target.json'
    path.write_bytes(bytes(range(256)))
    with pytest.raises(TargetError, match='expected `simulation'):
        load_target(str(path), small_network)


def test_exactly_one_of_configuration_and_latent():
    with pytest.raises(TargetError, match='either a configuration or a latent state'):
        Target()
    with pytest.raises(TargetError, match='either a configuration or a latent state'):
        Target(configuration=np.zeros(4), latent=np.zeros(2))


def test_sizes_are_checked_against_body_and_autoencoder():
    Target(configuration=np.zeros(4)).check_sizes(4, 2)
    Target(latent=np.zeros(2)).check_sizes(4, 2)
    with pytest.raises(TargetError, match='configuration: expected 4 values, got 3'):
        Target(configuration=np.zeros(3)).check_sizes(4, 2)
    with pytest.raises(TargetError, match='latent: expected 2 values, got 4'):
        Target(latent=np.zeros(4)).check_sizes(4, 2)
