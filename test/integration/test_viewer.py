"""The viewer over DDS, in a browser: the body is seen, steered, pushed, paused, recorded."""

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.bag import read_run
from dpc_ros.network import load_network
from dpc_ros.nodes.messages import from_stamp, is_latent
from dpc_ros.nodes.topics import TOPICS
from dpc_ros.resources import config_path

NETWORK = load_network('paper_2')
AUTOENCODER = load_checkpoint('paper_2_extended_m5').autoencoder()
SIZE = {'width': 1200, 'height': 600}  # pixels
STEP = 5_000_000  # ns


class Topics:
    """What has come of some topics."""

    def __init__(self, observer):
        self.observer = observer
        self.messages = {'configuration': [], 'target': [], 'external_force': []}
        self.subscriptions = [
            observer.node.create_subscription(
                TOPICS[name].message_type, name, kept.append, TOPICS[name].qos
            )
            for name, kept in self.messages.items()
        ]

    @property
    def states(self) -> list[JointState]:
        return self.messages['configuration']

    @property
    def pushes(self) -> list[WrenchStamped]:
        return self.messages['external_force']

    def wait(self, condition, what):
        self.observer.wait(condition, what)

    def catch_up(self):
        """Take all states that are on their way, where no more are to come."""
        quiet = 0
        while quiet < 2:
            count = len(self.states)
            self.observer.executor.spin_once(timeout_sec=0.5)
            quiet = quiet + 1 if len(self.states) == count else 0

    def wait_for_states(self, count):
        """Wait until so many more states have come."""
        wanted = len(self.states) + count
        self.wait(lambda: len(self.states) >= wanted, 'states')


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


def test_people_steer_the_body(live, open_page, set_field, tmp_path):
    page = open_page(live.address, viewport=SIZE)
    page.get_by_text('|u|').wait_for()

    # A slider changes the target, and the body follows.
    page.get_by_role('tab', name='Target').click()
    set_field(page, 'ξ₁', 1.25)
    page.get_by_role('button', name='Send').click()
    live.wait(lambda: any(map(is_latent, live.messages['target'])), 'the target of the sliders')
    target = np.array(live.messages['target'][-1].position)
    assert target[1] == 1.25
    goal = AUTOENCODER.decode(target)
    live.wait_for_states(1)

    def distance():
        return np.sum((np.array(live.states[-1].position) - goal) ** 2)

    begin = distance()
    live.wait(lambda: distance() < 0.5 * begin, 'the body at the target')

    # A hand that drags the body pushes it, by no more than it may, and lets go.
    canvas = page.locator('canvas').first.bounding_box()
    x, y = canvas['x'] + 0.5 * canvas['width'], canvas['y'] + 0.5 * canvas['height']
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y, steps=5)
    live.wait(lambda: any(force_of(push).any() for push in live.pushes), 'a push')
    page.mouse.up()
    live.wait(lambda: not force_of(live.pushes[-1]).any(), 'the hand to let go')
    assert max(np.linalg.norm(force_of(push)) for push in live.pushes) <= 20.0 * (1 + 1e-12)

    # A log is begun and ended.
    page.get_by_role('tab', name='Run').click()
    page.get_by_role('button', name='Record').click()
    page.get_by_role('button', name='End recording').wait_for()
    recordings = tmp_path / 'recordings'
    live.wait(lambda: [*recordings.glob('*/*.mcap')], 'the log')
    bag = next(recordings.glob('*/*.mcap')).parent
    live.wait_for_states(100)
    page.get_by_role('button', name='End recording').click()
    page.get_by_text(f'recorded in {bag}').wait_for()
    assert len(read_run(bag).configuration) > 0

    # Paused, the body stands still, and goes on by single steps.
    page.get_by_role('button', name='Pause').click()
    page.get_by_role('button', name='Go on').wait_for()
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
    # That is of viser's camera, where the mouse is moved by a program.
    assert [each for each in page.errors if 'preventDefault inside passive' not in each] == []
