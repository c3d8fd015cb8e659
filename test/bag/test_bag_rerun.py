"""Logs of the in-process loop, run again: epochs, repeats, targets, parameters, machines."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from dpc_ros import cli
from dpc_ros.autoencoder import load_checkpoint, with_encoder
from dpc_ros.bag import (
    MACHINE_RECORD,
    NODE_PARAMETERS_RECORD,
    PARAMETERS_RECORD,
    BagError,
    BagWriter,
)
from dpc_ros.bag.rerun import rerun
from dpc_ros.bag.signals import deviation
from dpc_ros.control import LawSettings, load_target, make_law, run_closed_loop
from dpc_ros.machine import describe_machine
from dpc_ros.network import Body, Integrator, Mechanics, load_network
from dpc_ros.parameters import ParameterError
from dpc_ros.reduction import CompressedSystem
from dpc_ros.threads import single_threaded_algebra

JOINT_STATE = 'sensor_msgs/msg/JointState'
WRENCH = 'geometry_msgs/msg/WrenchStamped'
STEP = 5_000_000  # ns
STEPS = 30
CHECKPOINT = 'paper_2_extended_m5'
GAINS = {'integral_gain': 2.0, 'integral_delay': 0.0525}
PARAMETERS = {
    '/**/simulator': {'ros__parameters': {'time_mode': 'lockstep'}},
    '/**': {'ros__parameters': {'checkpoint': CHECKPOINT, 'encoder': 'projection'}},
    'controller': {'ros__parameters': {'law': 'lqr', **GAINS}},
}


@pytest.fixture(scope='module')
def epoch():
    """The loop from rest, with an encoder and a law that remember the step before."""
    network = load_network('paper_2')
    mechanics = Mechanics(network)
    autoencoder = with_encoder(load_checkpoint(CHECKPOINT).autoencoder(), 'projection')
    system = CompressedSystem(mechanics, autoencoder, 162)
    law = make_law('lqr', system, LawSettings(largest_force=20.0, **GAINS))
    moved = network.rest_configuration + 0.05
    body = Body(Integrator(mechanics, STEP * 1e-9), 162, moved)
    with single_threaded_algebra():  # as in a node
        law.regulate(load_target('rest', network))
        return run_closed_loop(body, autoencoder, law, STEPS)


@pytest.fixture
def write_log(messages, tmp_path, epoch):
    """Return a function that writes two epochs of the loop, with all that can happen to a log."""
    network = load_network('paper_2')
    identifier = load_checkpoint(CHECKPOINT).identifier
    names = [f'xi_{i}' for i in range(5)]

    def write(target_topic='target_in_force', network_name=network.identifier, **metadata):
        records = {
            PARAMETERS_RECORD: {'yaml': yaml.safe_dump(PARAMETERS)},
            MACHINE_RECORD: describe_machine(),
            **metadata,
        }
        now = 10**18
        with BagWriter(tmp_path / 'log') as bag:
            for name, content in records.items():
                bag.add_metadata(name, content)
            for name in ('configuration', 'latent_state', target_topic):
                bag.add_topic(messages.topic(f'/{name}', JOINT_STATE))
            bag.add_topic(messages.topic('/control_force', WRENCH))

            def publish(name, cdr):
                nonlocal now
                now += 1000
                bag.write(f'/{name}', cdr, now, now)

            rest = network.rest_configuration
            for number in range(2):
                for k in range(STEPS + 1):
                    stamp = k * STEP
                    state = messages.joint_state(
                        stamp, epoch.configuration[k], epoch.velocity[k], network_name
                    )
                    latent = messages.joint_state(
                        stamp, epoch.latent[k], epoch.latent_velocity[k], identifier, names
                    )
                    # A state that was answered late is there twice, and so may its answers be.
                    for _ in range(1 + (k == 3)):
                        publish('configuration', state)
                        publish('latent_state', latent)
                    if number == k == 0:
                        publish(target_topic, messages.joint_state(stamp, rest))
                    publish('control_force', messages.wrench(stamp, epoch.force[k]))
            # The end of the run: encoded, but not answered any more; then not even encoded.
            publish('configuration', messages.joint_state(stamp + STEP, rest, 0 * rest))
        return tmp_path / 'log'

    return write


def test_every_epoch_is_run_again_bit_for_bit(write_log):
    result = rerun(write_log())
    assert result.is_exact
    assert result.passed
    assert [(each.stamps, each.missing, each.differing) for each in result.deviations] == [
        (2 * (STEPS + 1), 0, 0)
    ] * 3
    assert not result.notes


def test_a_log_without_announcements_counts_its_target_from_the_beginning(write_log):
    result = rerun(write_log('target'))
    assert result.is_identical
    assert any('target_in_force' in note for note in result.notes)


def test_a_changed_parameter_is_found_at_the_stamp_where_it_first_acts(write_log):
    log = write_log()
    latent, velocity, force = rerun(log, {'controller': {'integral_gain': 3.0}}).deviations
    assert latent.is_identical
    assert velocity.is_identical
    # It begins at the first state after the delay, and so acts on the one behind that.
    first = (round(GAINS['integral_delay'] * 1e9) // STEP + 2) * STEP
    assert force.first_stamp_ns == first
    assert 0 < force.relative < 1
    assert not force.missing


def answers(**changes):
    """Return what the nodes of the log answer when asked for their parameters."""
    common = {'checkpoint': CHECKPOINT, 'encoder': 'projection', 'use_sim_time': False}
    values = {
        'simulator': {'time_mode': 'lockstep'},
        'encoder': common,
        'controller': {**common, 'law': 'lqr', **GAINS, **changes},
    }
    texts = {
        f'/{node}': yaml.safe_dump({f'/{node}': {'ros__parameters': content}})
        for node, content in values.items()
    }
    another = yaml.safe_dump({'/lab/encoder': {'ros__parameters': {'encoder': 'network'}}})
    return {'/lab/encoder': another, **texts}


def test_a_log_without_a_parameter_file_has_the_parameters_that_its_nodes_answered(write_log):
    records = {PARAMETERS_RECORD: {'none': ''}, NODE_PARAMETERS_RECORD: answers()}
    result = rerun(write_log(**records))
    assert result.is_exact
    assert result.is_identical
    assert any('no parameter file' in note for note in result.notes)


def test_what_the_nodes_answered_wins_over_the_parameter_file(write_log):
    log = write_log(**{NODE_PARAMETERS_RECORD: answers(integral_gain=3.0)})
    result = rerun(log)
    assert not result.passed
    (note,) = result.notes
    assert 'controller.integral_gain is 3.0, as the node said, not 2.0' in note
    assert rerun(log, {'controller': GAINS}).is_identical


def test_another_machine_is_asked_for_less(write_log):
    log = write_log(**{MACHINE_RECORD: {**describe_machine(), 'processor': 'Z80'}})
    gain = LawSettings().force_weight * (1 + 1e-14)
    result = rerun(log, {'controller': {'force_weight': gain}})
    assert not result.is_exact
    assert 'Z80' in result.reason
    assert not result.is_identical
    assert result.passed
    assert not rerun(log, {'controller': {'force_weight': 2 * gain}}).passed


def test_another_checkpoint_is_compared_where_it_can_be(write_log):
    other = {node: {'checkpoint': 'paper_2_extended_m3'} for node in ('encoder', 'controller')}
    result = rerun(write_log(), other)
    latent, _, force = result.deviations
    assert latent.missing == latent.stamps
    assert force.differing == force.stamps
    assert not result.passed
    assert any('paper_2_extended_m3' in note for note in result.notes)


@pytest.mark.parametrize(
    ('changes', 'overrides', 'error', 'words'),
    [
        ({PARAMETERS_RECORD: {'none': ''}}, {}, BagError, 'holds its parameters'),
        (
            {
                PARAMETERS_RECORD: {'none': ''},
                NODE_PARAMETERS_RECORD: {'/encoder': answers()['/encoder']},
            },
            {},
            BagError,
            'none of simulator, controller in /',
        ),
        ({'network_name': 'paper_2@000000000000'}, {}, BagError, 'paper_2@000000000000'),
        ({}, {'controller': {'gain': 1.0}}, ParameterError, 'controller.gain'),
        ({}, {'simulator': {'rate': 1.0}}, ParameterError, 'simulator.rate'),
        (
            {PARAMETERS_RECORD: {'yaml': '/**: {ros__parameters: {checkpoint: paper_2_pod_m5}}'}},
            {},
            BagError,
            'paper_2_pod_m5.*--checkpoint',
        ),
        (
            {},
            {'encoder': {'checkpoint': 'paper_2_pod_m5'}},
            BagError,
            'expected one checkpoint',
        ),
    ],
)
def test_what_can_not_be_run_again_is_said(write_log, changes, overrides, error, words):
    with pytest.raises(error, match=words):
        rerun(write_log(**changes), overrides)


@pytest.mark.parametrize(
    ('silent', 'words'), [(('latent', 'force'), 'no latent states'), (('force',), 'no forces')]
)
@pytest.mark.parametrize('flags', [[], ['--over-dds']], ids=['in process', 'over DDS'])
def test_a_log_without_answers_is_refused(small_log, record, capsys, silent, words, flags):
    log = record(replace(small_log, **{name: [] for name in silent}))
    with pytest.raises(SystemExit) as caught:
        cli.main(['bag', 'rerun', str(log), *flags])
    assert caught.value.code == 2
    assert f'holds {words}: nothing to compare' in capsys.readouterr().err


def test_deviations_count_what_is_not_finite():
    recorded = {(0, k): np.array([float(k), 0.0]) for k in range(4)}
    repeated = {**recorded, (0, 2): np.array([np.nan, 0.0])}
    del repeated[0, 3]
    found = deviation('force', recorded, repeated)
    assert (found.missing, found.differing, found.first_stamp_ns) == (1, 1, 2)
    assert found.absolute == found.relative == np.inf
    assert not found.is_within(1e-9)
