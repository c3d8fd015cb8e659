"""A bag is measured with its own models only, and by what its records really say."""

from dataclasses import replace

import numpy as np
import pytest

from dpc_ros import cli
from dpc_ros.autoencoder import Checkpoint, load_checkpoint, save_checkpoint
from dpc_ros.bag import NODE_PARAMETERS_RECORD, PARAMETERS_RECORD, read_run
from dpc_ros.bag.report import converge, run_parameters
from dpc_ros.network import Gravity, Mechanics, save_network

STEP = 5_000_000  # ns
WITHOUT_GRAVITY = 'the log does not say the gravity: energies are without it'


@pytest.fixture
def checkpoint_path(make_module, small_network, tmp_path):
    """Return a function: seed → path of a checkpoint of the small network."""

    def write(seed):
        module = make_module(3, seed=seed)
        network = {'name': small_network.name, 'digest': small_network.digest}
        name = f'grid_{seed}'
        checkpoint = Checkpoint(name, module.architecture, module.tensors(), network)
        return save_checkpoint(checkpoint, tmp_path)

    return write


@pytest.fixture
def network_path(small_network, tmp_path):
    save_network(small_network, tmp_path / 'grid.json')
    return tmp_path / 'grid.json'


@pytest.fixture
def small_bag(log_type, record, small_network):
    """Return a function: checkpoint, parameters → bag of the small network that goes to rest."""

    def write(checkpoint='flat@ba9876543210', parameters=None):
        rest = small_network.rest_configuration
        stamps = [STEP * k for k in range(1, 60)]
        return record(
            log_type(
                configuration=[(t, rest + 1 / t, np.zeros_like(rest)) for t in stamps],
                latent=[(t, np.zeros(3), np.zeros(3)) for t in stamps],
                targets=[(0, rest, False)],
                network=small_network.identifier,
                checkpoint=checkpoint,
                metadata={} if parameters is None else {PARAMETERS_RECORD: {'yaml': parameters}},
            )
        )

    return write


def test_the_models_of_the_log_measure_it(small_bag, network_path, checkpoint_path):
    path = checkpoint_path(0)
    bag = small_bag(load_checkpoint(path).identifier)
    convergence, notes = converge(bag, network_path, path)
    assert convergence.latent_error is not None
    assert notes == [WITHOUT_GRAVITY]


def test_another_checkpoint_than_that_of_the_log_is_refused(
    small_bag, network_path, checkpoint_path
):
    logged = load_checkpoint(checkpoint_path(0)).identifier
    other = checkpoint_path(1)
    with pytest.raises(ValueError, match='expected that of the log') as caught:
        converge(small_bag(logged), network_path, other)
    assert logged in str(caught.value)
    assert load_checkpoint(other).identifier in str(caught.value)


def test_another_network_than_that_of_the_log_is_refused(small_bag, small_network, tmp_path):
    other = replace(small_network, mass=2 * small_network.mass)
    save_network(other, tmp_path / 'other.json')
    with pytest.raises(ValueError, match='load the network of the run') as caught:
        converge(small_bag(), tmp_path / 'other.json')
    assert small_network.identifier in str(caught.value)
    assert other.identifier in str(caught.value)


def test_the_gravity_is_that_of_the_logged_parameters(small_bag, small_network, network_path):
    parameters = '/**: {ros__parameters: {gravity_magnitude: 9.81, gravity_angle: 0.5}}'
    convergence, notes = converge(small_bag(parameters=parameters), network_path)
    assert not any('gravity' in note for note in notes)
    mechanics = Mechanics(small_network, Gravity(9.81, 0.5))
    expected = mechanics.gravitational_energy(convergence.run.configuration[0])
    assert convergence.energy.gravitational[0] == pytest.approx(expected)


@pytest.mark.parametrize(
    'parameters',
    [
        '',
        '{',
        'just a text',
        '[1, 2]',
        '[' * 10_000,
        'simulator: 3',
        'simulator: {ros__parameters: [gravity]}',
        'simulator: {ros__parameters: {gravity_magnitude: strong}}',
        'simulator: {ros__parameters: {gravity_magnitude: -1.0}}',
        'simulator: {ros__parameters: {gravity_magnitude: 9.81, gravity_angle: null}}',
    ],
    ids=lambda text: text[:40],
)
def test_parameters_that_say_no_gravity_are_noted(small_bag, network_path, parameters):
    convergence, notes = converge(small_bag(parameters=parameters), network_path)
    assert WITHOUT_GRAVITY in notes
    assert (convergence.energy.gravitational == 0).all()


def test_what_a_node_answered_wins_over_the_file_of_the_run(log_type, record):
    texts = {'/body_2/controller': '/body_2/controller: {ros__parameters: {law: paper}}'}
    log = log_type(
        configuration=[(0, [0.0], [0.0])],
        namespace='/body_2',
        metadata={
            PARAMETERS_RECORD: {'yaml': '/**: {ros__parameters: {law: lqr, rate: 200.0}}'},
            NODE_PARAMETERS_RECORD: texts,
        },
    )
    run = read_run(record(log))
    assert run_parameters(run, 'controller') == {'law': 'paper', 'rate': 200.0}
    assert run_parameters(run, 'encoder') == {'law': 'lqr', 'rate': 200.0}


def test_a_latent_target_without_its_checkpoint_is_left_out_and_said(
    log_type, record, small_network, network_path
):
    rest = small_network.rest_configuration
    log = log_type(
        configuration=[(STEP * k, rest, np.zeros_like(rest)) for k in range(3)],
        targets=[(0, np.zeros(3), True)],
        network=small_network.identifier,
    )
    convergence, notes = converge(record(log), network_path)
    assert convergence.target is None
    assert any('no nMSE of latent targets' in note for note in notes)


def test_a_figure_that_cannot_be_written_is_said_after_the_table(
    small_bag, network_path, tmp_path, capsys
):
    (tmp_path / 'file').touch()
    arguments = ['--network', str(network_path), '--figure', str(tmp_path / 'file' / 'run.png')]
    with pytest.raises(SystemExit) as caught:
        cli.main(['bag', 'converge', str(small_bag()), *arguments])
    assert caught.value.code == 2
    shown = capsys.readouterr()
    assert 'final nMSE' in shown.out
    assert WITHOUT_GRAVITY in shown.out
    assert 'figure ' not in shown.out
    (line,) = shown.err.splitlines()
    assert line.startswith(f"error: {tmp_path / 'file' / 'run.png'} can't be written")
