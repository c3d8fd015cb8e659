"""Markers over DDS: what is published is drawn, and nothing is done where nobody watches."""

from array import array

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from state_messages import state_message
from visualization_msgs.msg import Marker, MarkerArray

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.network import load_network
from dpc_ros.nodes.marker_scene import BODY, FIXED, FORCE, NAMESPACES, RECONSTRUCTION, TARGET
from dpc_ros.nodes.markers_node import MARKERS, MarkersNode
from dpc_ros.nodes.messages import force_message, from_stamp, to_stamp
from dpc_ros.nodes.topics import IN_FORCE_QOS, LOOP_QOS

NETWORK = load_network('paper_2')
CHECKPOINT = load_checkpoint('paper_2_extended_m5')
NAMES = [f'xi_{i}' for i in range(5)]
MASS = 162
SPRINGS = (BODY, RECONSTRUCTION, TARGET)


def configuration(step):
    """Return the state of a step, whose number is its stamp; each is another one."""
    q = NETWORK.rest_configuration + 0.01 * np.sin(step + np.arange(400))
    return state_message(to_stamp(step), NETWORK.identifier, q, np.zeros(400))


def latent_state(stamp, latent):
    return state_message(to_stamp(stamp), CHECKPOINT.identifier, latent, np.zeros(5), NAMES)


@pytest.fixture
def start_markers(observer, run_here):
    """Return a function that starts the node in the process of the test."""

    def start():
        node = run_here(MarkersNode(observer.node.context))
        assert node.start(), node.failure
        return node

    return start


class Picture:
    """The newest markers that have come, and a loop that goes on until they are as expected."""

    def __init__(self, observer):
        self.observer = observer
        self.markers = {}
        self.step = 0
        node = observer.node
        self.publishers = {
            topic: node.create_publisher(message_type, topic, qos)
            for topic, message_type, qos in (
                ('configuration', JointState, LOOP_QOS),
                ('latent_state', JointState, LOOP_QOS),
                ('target_in_force', JointState, IN_FORCE_QOS),
                ('control_force', WrenchStamped, LOOP_QOS),
            )
        }

    def watch(self):
        self.subscription = self.observer.node.create_subscription(
            MarkerArray, 'markers', self._take, MARKERS.qos
        )

    def watch_no_more(self):
        self.observer.node.destroy_subscription(self.subscription)

    def _take(self, message):
        self.markers = {marker.ns: marker for marker in message.markers}
        assert tuple(self.markers) == NAMESPACES

    def wait(self, condition, what, **messages):
        """Publish a new configuration, and some messages again and again, until something is."""

        def publish_and_look():
            self.step += 1
            self.publishers['configuration'].publish(configuration(self.step))
            for topic, message in messages.items():
                self.publishers[topic].publish(message)
            return bool(self.markers) and condition()

        self.observer.wait(publish_and_look, what)

    def shows(self, *namespaces):
        return {n for n, m in self.markers.items() if m.action == Marker.ADD} == {*namespaces}

    def points(self, namespace):
        return np.array([(point.x, point.y) for point in self.markers[namespace].points])

    def assert_draws(self, namespace, q):
        ends = NETWORK.positions(q)[NETWORK.springs].reshape(-1, 2)
        np.testing.assert_array_equal(self.points(namespace), ends)


def listeners(observer):
    return [observer.node.count_subscribers(topic) for topic in ('configuration', 'control_force')]


def test_markers_are_what_is_published_and_nobody_listens_where_nobody_watches(
    observer, start_markers
):
    markers = start_markers()
    picture = Picture(observer)
    picture.watch()
    picture.wait(lambda: picture.shows(BODY, FIXED), 'the body')  # without encoder or controller
    latent, force = np.linspace(-1.0, 1.0, 5), np.array([3.0, -4.0])
    target = NETWORK.rest_configuration - 0.02
    picture.wait(
        lambda: picture.shows(*NAMESPACES),
        'all there is to see',
        latent_state=latent_state(7, latent),
        target_in_force=JointState(position=array('d', target.tobytes())),
        control_force=force_message(to_stamp(8), MASS, force),
    )
    step = from_stamp(picture.markers[BODY].header.stamp)
    q = np.array(configuration(step).position)
    picture.assert_draws(BODY, q)
    picture.assert_draws(RECONSTRUCTION, CHECKPOINT.autoencoder().decode(latent))
    picture.assert_draws(TARGET, target)
    place, scale = NETWORK.positions(q)[MASS], markers.settings['force_scale']
    np.testing.assert_array_equal(picture.points(FORCE), [place, place + scale * force])
    assert from_stamp(picture.markers[FORCE].header.stamp) == 8

    # A target as the latent state that the encoder sees it as; no force, and no latent state.
    picture.wait(
        lambda: picture.shows(BODY, FIXED, TARGET),
        'what is stale to go',
        target_in_force=JointState(name=NAMES, position=array('d', latent.tobytes())),
    )
    picture.assert_draws(TARGET, CHECKPOINT.autoencoder().decode(latent))

    picture.watch_no_more()
    observer.wait(lambda: not any(listeners(observer)), 'the node to listen no more')
    picture.markers.clear()
    picture.watch()
    picture.wait(lambda: picture.shows(BODY, FIXED, TARGET), 'the body again')  # target is latched


def test_bad_messages_are_reported_and_the_next_good_ones_drawn(observer, start_markers):
    markers = start_markers()
    picture = Picture(observer)
    picture.watch()
    picture.wait(lambda: picture.shows(BODY, FIXED), 'the body')
    bad = {
        'latent_state': latent_state(1, np.full(5, np.nan)),
        'target_in_force': JointState(position=[0.0] * 7),
        'control_force': force_message(to_stamp(1), 3, np.ones(2)),
    }

    def rejected(*topics):
        reasons = [reason for reason, _ in markers.health.rejected.items()]
        return all(any(each.startswith(topic) for each in reasons) for topic in topics)

    picture.wait(lambda: rejected(*bad), 'a report of each', **bad)
    assert picture.shows(BODY, FIXED)
    for message in (b'\x00\x01' + 30 * b'\xff', JointState(position=[0.0] * 400)):
        before = markers.health.rejected.total()
        observer.wait(
            lambda: (
                picture.publishers['configuration'].publish(message)  # noqa: B023
                or markers.health.rejected.total() > before  # noqa: B023
            ),
            'a bad configuration to be rejected',
        )
    last = picture.step
    picture.wait(
        lambda: (
            picture.shows(BODY, FIXED, FORCE)
            and from_stamp(picture.markers[BODY].header.stamp) > last
        ),
        'good ones to be drawn',
        control_force=force_message(to_stamp(2), MASS, np.ones(2)),
    )
    step = from_stamp(picture.markers[BODY].header.stamp)
    picture.assert_draws(BODY, np.array(configuration(step).position))
