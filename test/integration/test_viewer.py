"""The viewer over DDS, in a browser: the body is seen, steered, pushed, paused, recorded."""

import re

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.bag import read_run
from dpc_ros.control import load_target
from dpc_ros.network import load_network
from dpc_ros.nodes.health import DIAGNOSTICS
from dpc_ros.nodes.messages import from_stamp, is_latent
from dpc_ros.nodes.topics import TOPICS
from dpc_ros.resources import config_path

NETWORK = load_network('paper_2')
AUTOENCODER = load_checkpoint('paper_2_extended_m5').autoencoder()
TARGET = load_target('simulation:4@100', NETWORK)  # of config/live.yaml
MASS, HELD_MASS = 162, 90  # the actuated one, and one in the middle
SIZE = {'width': 1200, 'height': 600}  # pixels
STEP = 5_000_000  # ns
RECORDED = 300_000  # bytes, some seconds of the run


class Topics:
    """What has come of some topics."""

    def __init__(self, observer):
        self.observer = observer
        self.messages = {'configuration': [], 'target_in_force': [], 'external_force': []}
        self.number = 0  # that the simulator has given to its newest state
        self.reports = {}  # of the nodes
        takes = {name: kept.append for name, kept in self.messages.items()}
        takes['configuration'] = self._take_state
        self.subscriptions = [
            observer.node.create_subscription(
                TOPICS[name].message_type, name, take, TOPICS[name].qos
            )
            for name, take in takes.items()
        ]
        self.subscriptions.append(
            observer.node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._hear, 10)
        )

    def _take_state(self, message, info):
        self.states.append(message)
        self.number = info['publication_sequence_number']

    def _hear(self, message):
        for status in message.status:
            self.reports[status.name] = {each.key: each.value for each in status.values}

    @property
    def states(self) -> list[JointState]:
        return self.messages['configuration']

    @property
    def pushes(self) -> list[WrenchStamped]:
        return self.messages['external_force']

    def wait(self, condition, what):
        self.observer.wait(condition, what)

    def catch_up(self):
        """Take all states that a paused simulator has published, by its next report."""
        self.reports.clear()

        def has_all():
            report = self.reports.get('simulator', {})
            return report.get('paused') == 'true' and int(report['published']) == self.number

        self.wait(has_all, 'all states')

    def has_recorded(self):
        """Return whether the viewer's log takes states, and has taken some seconds of the run."""
        readers = self.observer.node.get_subscriptions_info_by_topic('configuration')
        if 'viewer_recorder' not in {each.node_name for each in readers}:
            self.reports.pop('viewer_recorder', None)  # it counts from its next report on
        return int(self.reports.get('viewer_recorder', {}).get('recorded [bytes]', 0)) > RECORDED


@pytest.fixture
def live(domain, observer, tmp_path):
    """Return the run of `make live`, but for the port, and what comes of its topics."""
    topics = Topics(observer)
    run = domain.start(
        'launcher',
        '--config',
        str(config_path('live.yaml')),
        '--viewer',
        '--no-record',
        '--output',
        str(tmp_path / 'run'),
        '--set=viewer.port=0',
        f'--set=viewer.recordings={tmp_path / "recordings"}',
    )
    log = tmp_path / 'run' / 'log' / 'viewer.log'
    line = 'the page is at '
    topics.wait(lambda: log.exists() and line in log.read_text(), 'the address of the page')
    topics.address = log.read_text().partition(line)[2].split()[0]
    yield topics
    code, output = domain.stop(run)
    assert code == 130, output
    assert f'viewer      {topics.address}' in output


def force_of(message):
    return np.array([message.wrench.force.x, message.wrench.force.y])


def test_people_steer_the_body(live, open_page, set_field, drag, tmp_path):
    page = open_page(live.address, viewport=SIZE)
    page.get_by_text(re.compile(r'nMSE \d')).wait_for()  # the ball is where the target has the mass

    def latent_targets():
        return [each for each in live.messages['target_in_force'] if is_latent(each)]

    def assert_followed(before):
        """The body has left what the target was before for what it is now, which is returned."""
        target = latent_targets()[-1]
        goal = AUTOENCODER.decode(np.array(target.position))

        def has_followed():
            state = live.states[-1]
            way = np.sum((np.array(state.position) - goal) ** 2)
            return from_stamp(state.header.stamp) > from_stamp(
                target.header.stamp
            ) and way < 0.5 * np.sum((before - goal) ** 2)

        live.wait(has_followed, 'the body at the target')
        return goal

    # The ball is dragged to where the mass is to be, and the body follows.
    begin = NETWORK.positions(TARGET.configuration)[MASS]
    end = begin + 0.3 * (NETWORK.rest_position[MASS] - begin)
    drag(page, NETWORK, begin, end)
    page.mouse.up()
    live.wait(latent_targets, 'the target of the ball')
    goal = assert_followed(TARGET.configuration)
    place = NETWORK.positions(goal)[MASS]
    assert np.linalg.norm(place - end) < 0.5 * np.linalg.norm(place - begin)

    # A slider changes the target, too.
    page.get_by_role('tab', name='Target').click()
    set_field(page, 'ξ₁', 1.25)
    page.get_by_role('button', name='Send').click()
    live.wait(lambda: latent_targets()[-1].position[1] == 1.25, 'the target of the sliders')
    assert_followed(goal)

    # A log is begun and ended.
    page.get_by_role('tab', name='Run').click()
    page.get_by_role('button', name='Record').click()
    page.get_by_role('button', name='End recording').wait_for()
    recordings = tmp_path / 'recordings'
    live.wait(lambda: [*recordings.glob('*/*.mcap')], 'the log')
    bag = next(recordings.glob('*/*.mcap')).parent
    live.wait(live.has_recorded, 'messages in it')
    page.get_by_role('button', name='End recording').click()
    page.get_by_text(f'recorded in {bag}').wait_for()
    assert len(read_run(bag).configuration) > 0

    # Whoever pauses it, the page shows so.
    page.get_by_role('button', name='Pause').click()
    page.get_by_role('button', name='Go on').wait_for()
    node = live.observer.node
    client = node.create_client(SetBool, 'simulator/pause')
    live.wait(client.service_is_ready, 'the service')
    answer = client.call_async(SetBool.Request(data=False))
    live.wait(answer.done, 'an answer')
    page.get_by_role('button', name='Pause').click()
    page.get_by_role('button', name='Go on').wait_for()

    # Paused, the body stands still, and goes on by single steps.
    live.catch_up()
    stamp = from_stamp(live.states[-1].header.stamp)
    page.get_by_role('button', name='Step').click()
    live.wait(lambda: from_stamp(live.states[-1].header.stamp) > stamp, 'a step')
    live.catch_up()
    assert from_stamp(live.states[-1].header.stamp) == stamp + STEP

    # A reset puts it at rest.
    page.get_by_role('button', name='Reset').click()
    live.wait(
        lambda: np.array_equal(live.states[-1].position, NETWORK.rest_configuration),
        'the body at rest',
    )

    # A target that the controller refuses is told, whoever gave it.
    targets = node.create_publisher(JointState, 'target', TOPICS['target'].qos)
    live.wait(targets.get_subscription_count, 'the controller')
    targets.publish(JointState(position=[0.0] * 7))
    page.get_by_text('controller: target: expected 400 positions, got 7').wait_for()

    # A hand that drags the body pushes it, by no more than it may, and lets go.
    def is_pushed():
        return bool(live.pushes) and force_of(live.pushes[-1]).any()

    held = NETWORK.rest_position[HELD_MASS]
    drag(page, NETWORK, held, held + np.array([1.0, 0.0]))
    live.wait(is_pushed, 'a push')
    page.mouse.up()
    live.wait(lambda: not is_pushed(), 'the hand to let go')
    assert max(np.linalg.norm(force_of(push)) for push in live.pushes) <= 20.0 * (1 + 1e-12)

    # That is of viser's camera, where the mouse is moved by a program.
    assert [each for each in page.errors if 'preventDefault inside passive' not in each] == []

    # The hand of a browser that goes lets go, too.
    drag(page, NETWORK, held, held + np.array([1.0, 0.0]))
    live.wait(is_pushed, 'another push')
    page.close()
    live.wait(lambda: not is_pushed(), 'that hand to let go')
