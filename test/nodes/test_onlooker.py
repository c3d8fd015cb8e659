"""Who looks on knows what has come and fits, for as long as it counts."""

from array import array

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from state_messages import state_message

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.nodes.messages import (
    MessageError,
    force_message,
    latent_names,
    to_stamp,
)
from dpc_ros.nodes.onlooker import load_onlooker
from dpc_ros.parameters import node_parameters

CHECKPOINT = load_checkpoint('paper_2_extended_m5')
NAMES = latent_names(5)
TIMEOUT = node_parameters('markers')['answer_timeout']  # s
LATENT = np.linspace(-1.0, 1.0, 5)


@pytest.fixture(scope='module')
def autoencoder():
    return CHECKPOINT.autoencoder()


def make_onlooker(**parameters):
    return load_onlooker(node_parameters('markers', parameters))


@pytest.fixture(scope='module')
def loaded():
    return make_onlooker()


@pytest.fixture
def onlooker(loaded):
    loaded.forget()
    return loaded


@pytest.fixture
def send(onlooker, paper_2):
    """Return a function that hands a sound message of a topic to the one who looks on."""
    rest, nothing = paper_2.rest_configuration, np.zeros(paper_2.configuration_size)
    sound = {
        'configuration': state_message(to_stamp(5), paper_2.identifier, rest + 0.01, nothing),
        'latent_state': state_message(
            to_stamp(4), CHECKPOINT.identifier, LATENT, np.zeros(5), NAMES
        ),
        'target_in_force': JointState(position=array('d', (rest - 0.01).tobytes())),
        'control_force': force_message(to_stamp(3), 162, np.array([1.0, -2.0]), 'first'),
    }

    def hand_over(topic, now=0.0, message=None):
        onlooker.read(topic, serialize_message(message or sound[topic]), now)

    return hand_over


def test_it_knows_what_the_messages_say(onlooker, send, autoencoder, paper_2):
    for topic in onlooker.topics:
        send(topic)
    rest = paper_2.rest_configuration
    np.testing.assert_array_equal(onlooker.body.configuration, rest + 0.01)
    np.testing.assert_array_equal(onlooker.reconstruction.configuration, autoencoder.decode(LATENT))
    np.testing.assert_array_equal(onlooker.target.configuration, rest - 0.01)
    assert (onlooker.push.mass, onlooker.push.force.tolist()) == (162, [1.0, -2.0])
    stamps = [each.stamp for each in (onlooker.body, onlooker.reconstruction, onlooker.push)]
    assert stamps == [5, 4, 3]
    onlooker.forget()
    assert onlooker.body is onlooker.reconstruction is onlooker.target is onlooker.push is None


def test_a_latent_target_is_decoded_where_there_is_a_checkpoint(onlooker, send, autoencoder):
    target = JointState(name=NAMES, position=array('d', LATENT.tobytes()))
    send('target_in_force', message=target)
    np.testing.assert_array_equal(onlooker.target.configuration, autoencoder.decode(LATENT))
    without = make_onlooker(checkpoint='')
    without.read('target_in_force', serialize_message(target), 0.0)
    assert without.target is None
    assert 'latent_state' not in without.topics


@pytest.mark.parametrize(
    ('topic', 'message', 'words'),
    [
        ('configuration', JointState(), "expected the frame 'paper_2@"),
        ('target_in_force', JointState(position=[0.0] * 7), 'expected 400 positions, got 7'),
        ('target_in_force', JointState(position=[1e3] * 400), 'displacement of at most 100 m'),
        (
            'target_in_force',
            JointState(name=NAMES, position=[1e300] * 5),
            'displacement of at most 100 m',
        ),
        ('control_force', force_message(to_stamp(0), 204, np.full(2, np.nan)), 'expected finite'),
        ('control_force', force_message(to_stamp(0), 204, np.full(2, 1e300)), 'force of at most'),
        ('control_force', force_message(to_stamp(0), 205, np.ones(2)), 'no mass 205'),
        ('control_force', force_message(to_stamp(0), 3, np.ones(2)), 'mass 3 of paper_2 is fixed'),
        ('control_force', force_message(to_stamp(0), 162, np.ones(2), 'second'), 'stop one'),
        ('control_force', force_message(to_stamp(-1), 162, np.ones(2)), 'expected a stamp'),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(onlooker, send, topic, message, words):
    for each in onlooker.topics:
        send(each)
    before = onlooker.body, onlooker.reconstruction, onlooker.target, onlooker.push
    with pytest.raises(MessageError, match=words):
        send(topic, message=message)
    with pytest.raises(MessageError, match='got other bytes'):
        onlooker.read(topic, b'\x00\x01' + 30 * b'\xff', 0.0)
    assert before == (onlooker.body, onlooker.reconstruction, onlooker.target, onlooker.push)


def test_a_force_counts_for_a_time_and_until_the_controller_lets_go(onlooker, send):
    send('control_force', 0.0)
    assert not onlooker.pass_time(TIMEOUT)
    assert onlooker.push is not None
    assert onlooker.pass_time(2 * TIMEOUT)
    assert onlooker.push is None
    assert not onlooker.pass_time(2 * TIMEOUT)
    send('control_force', 3 * TIMEOUT)
    release = force_message(to_stamp(3), 162, np.zeros(2), 'first', is_release=True)
    send('control_force', 3 * TIMEOUT, release)
    assert onlooker.push is None


def test_what_stands_still_stays_and_what_the_body_leaves_behind_goes(onlooker, send):
    send('configuration', 0.0)
    send('latent_state', 0.0)
    assert not onlooker.pass_time(100 * TIMEOUT)
    assert onlooker.reconstruction is not None
    send('configuration', 2 * TIMEOUT)
    assert onlooker.pass_time(2 * TIMEOUT)
    assert onlooker.reconstruction is None
    assert onlooker.body is not None


def test_a_checkpoint_of_another_network_is_refused():
    with pytest.raises(ValueError, match='was trained on paper_2'):
        make_onlooker(network='paper_1')
