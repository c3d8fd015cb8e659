"""The page of a running loop in a browser: it shows what it is given, hands on what is wanted."""

from queue import SimpleQueue

import numpy as np
import pytest
from watch_viewer import connect

from dpc_ros.control import Target
from dpc_ros.view import Frame, LivePage, address, open_server

LONGEST_WAIT = 60  # s for what people do in a browser to arrive
SIZE = {'width': 1200, 'height': 600}  # pixels


class Wishes:
    """Actions that are kept, in the order in which they came."""

    def __init__(self):
        self._queue = SimpleQueue()

    def __getattr__(self, name):
        return lambda *values: self._queue.put((name, *values))

    def next(self, name):
        """Return the next wish of a kind; others that came before are passed over."""
        while True:
            kind, *values = self._queue.get(timeout=LONGEST_WAIT)
            if kind == name:
                return values

    def before(self, name):
        """Return what came before the next wish of a kind."""
        wishes = []
        while not wishes or wishes[-1][0] != name:
            wishes.append(self._queue.get(timeout=LONGEST_WAIT))
        return wishes[:-1]


@pytest.fixture
def wishes():
    return Wishes()


@pytest.fixture
def live(small_system, wishes):
    system = small_system(2)
    server = open_server('127.0.0.1', 0, 'test', system.mechanics.network)
    page = LivePage(server, system, 2.0, 3.0, wishes)
    page.system, page.address = system, address(server)
    yield page
    page.close()


def frame(live, time, **known):
    return Frame(time, live.system.mechanics.network.rest_configuration, **known)


def test_what_is_wanted_in_the_browser_arrives(live, wishes, open_page, set_field):
    live.show(frame(live, 0.5, force=np.array([3.0, 4.0]), nmse=0.25))
    page = open_page(live.address, viewport=SIZE)
    page.get_by_text('0.50 s').wait_for()
    page.get_by_text('|u| 5.00 N').wait_for()

    page.get_by_role('button', name='Pause').click()
    assert wishes.next('pause') == [True]
    live.show_paused(True)
    page.get_by_role('button', name='Step').click()
    assert wishes.next('step') == []
    page.get_by_role('button', name='Go on').click()
    assert wishes.next('pause') == [False]
    page.get_by_role('button', name='Reset').click()
    assert wishes.next('reset') == []
    page.get_by_role('button', name='Record').click()
    assert wishes.next('record') == [True]
    live.show_recording(True)
    page.get_by_role('button', name='End recording').click()
    assert wishes.next('record') == [False]

    page.get_by_role('tab', name='Law').click()
    set_field(page, 'proportional gain', 3.5)
    page.get_by_role('button', name='Apply').click()
    assert wishes.next('tune') == [{'proportional_gain': 3.5}]
    set_field(page, 'integral gain [1/s]', 0.25)
    shown = {'largest_force': 20.123456, 'force_weight': 1.25e-9, 'integral_gain': 0.5}
    live.show_parameters(shown)
    for value in ('20.123456', '0.00000000125'):
        page.locator(f'input[value="{value}"]').wait_for()
    page.get_by_role('button', name='Apply').click()  # what is not in force yet is asked for again
    assert wishes.next('tune') == [{'proportional_gain': 3.5, 'integral_gain': 0.25}]
    live.tell('expected 0 to 1000000, got -1', problem=True)
    page.get_by_text('expected 0 to 1000000, got -1').wait_for()
    assert page.errors == []


def test_a_target_is_sent_as_it_was_previewed(live, wishes, open_page, set_field):
    live.show(frame(live, 0.0))
    page = open_page(live.address, viewport=SIZE)
    page.get_by_role('tab', name='Target').click()
    send = page.get_by_role('button', name='Send')
    set_field(page, 'ξ₁', 0.5)
    send.click()
    (target,) = wishes.next('aim')
    assert isinstance(target, Target)
    assert target.latent[1] == 0.5

    set_field(page, 'By name', 'rest')
    page.get_by_role('button', name='Preview').click()
    send.click()
    (target,) = wishes.next('aim')
    rest = live.system.mechanics.network.rest_configuration
    np.testing.assert_array_equal(target.configuration, rest)

    set_field(page, 'By name', 'nowhere')
    page.get_by_role('button', name='Preview').click()
    page.get_by_text('expected rest, or a state').wait_for()
    assert page.errors == []


def test_two_browsers_see_the_same_and_one_that_hangs_holds_nobody_up(live, open_page):
    with connect(live.address.replace('http', 'ws')):  # of what it is sent it reads next to nothing
        pages = [open_page(live.address, viewport=SIZE) for _ in range(2)]
        for k in range(300):
            live.show(frame(live, 0.01 * k))
        for page in pages:
            page.get_by_text('2.99 s').wait_for()
            assert page.errors == []


def test_who_drags_first_holds_it_until_the_browser_goes(live, wishes, open_page, drag):
    network = live.system.mechanics.network
    positions = network.rest_position
    middle, corner = positions.mean(axis=0), positions[live.system.actuated_mass]
    right = np.array([0.3, 0.0])
    live.show(frame(live, 0.5))
    first, second = (open_page(live.address, viewport=SIZE) for _ in range(2))
    for page in (first, second):
        page.get_by_text('0.50 s').wait_for()

    def wait_for_push(condition):
        while not condition(wishes.next('push')[1]):
            pass

    def drag_in_vain(begin):
        """Drag to the left, let go, and ask for something else; return what came before that."""
        drag(second, network, begin, begin - right)
        second.mouse.up()
        second.get_by_role('button', name='Reset').click()
        return wishes.before('reset')

    # The body.
    drag(first, network, middle, middle + right)
    wait_for_push(lambda force: force[0] > 0)
    pushes = [values for kind, *values in drag_in_vain(middle) if kind == 'push']
    assert all(force[0] >= 0 for _, force in pushes)
    first.mouse.up()
    wait_for_push(lambda force: not force.any())

    # The ball of the target: what was only previewed goes with the browser.
    second.get_by_role('tab', name='Target').click()
    drag(first, network, corner, corner - right)
    second.get_by_role('button', name='Send', disabled=False).wait_for()
    second.get_by_role('tab', name='Run').click()
    assert 'aim' not in {kind for kind, *_ in drag_in_vain(corner)}
    first.close()
    second.get_by_role('tab', name='Target').click()
    second.get_by_role('button', name='Send', disabled=True).wait_for()
    live.show(frame(live, 1.5))
    second.get_by_role('tab', name='Run').click()
    second.get_by_text('1.50 s').wait_for()
    drag(second, network, corner, corner + right)
    second.mouse.up()
    (target,) = wishes.next('aim')
    aimed = network.positions(live.system.autoencoder.decode(target.latent))
    assert aimed[live.system.actuated_mass][0] > corner[0]
