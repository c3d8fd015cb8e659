"""The viewer's lifecycle and what it tells on its page, in the process of the test: no browser."""

import os
import signal
import socket
import threading

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue
from rclpy.lifecycle import TransitionCallbackReturn
from watch_viewer import connect

from dpc_ros.nodes import viewer_node
from dpc_ros.nodes.messages import parameters_message, to_stamp
from dpc_ros.nodes.topics import IN_FORCE_QOS
from dpc_ros.nodes.viewer_node import ViewerNode
from dpc_ros.view import LivePage

DONE, REFUSED = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
LAST_PORT = 65535


class Page(LivePage):
    """Remembers what it was told to show, and offers what people may want."""

    def __init__(self, server, system, largest_force, largest_push, actions):
        super().__init__(server, system, largest_force, largest_push, actions)
        self.actions = actions
        self.told, self.recording, self.parameters = [], [], []

    def tell(self, text, problem=False):
        self.told.append((text, problem))

    def show_recording(self, recording):
        self.recording.append(recording)

    def show_parameters(self, parameters):
        self.parameters.append(parameters)


@pytest.fixture
def make_viewer(observer, run_here, tmp_path):
    """Return a function that makes the node in the process of the test, not configured yet."""

    def make(**settings):
        node = run_here(ViewerNode(observer.node.context))
        node.settings = {**node.settings, 'port': 0, 'recordings': str(tmp_path), **settings}
        return node

    return make


@pytest.fixture
def pages(monkeypatch):
    """The pages that viewers have made."""
    pages = []

    def make(*arguments):
        pages.append(Page(*arguments))
        return pages[-1]

    monkeypatch.setattr(viewer_node, 'LivePage', make)
    yield pages
    pages.clear()


def held(viewer):
    """Return what a node holds: how much of ROS, and which threads there are."""
    kinds = viewer.publishers, viewer.subscriptions, viewer.clients, viewer.timers
    return [len(list(kind)) for kind in kinds], {*threading.enumerate()}


@pytest.fixture
def wait_until_holds(observer):
    """Return a function: wait until a viewer holds what it did; threads take a moment to end."""
    return lambda viewer, before: observer.wait(lambda: held(viewer) == before, 'all to be let go')


def open_browser(viewer):
    return connect(viewer.health.readings['address'].replace('http', 'ws'))


def listens(observer):
    return observer.node.count_subscribers('configuration') > 0


def test_a_configuration_that_fails_leaves_nothing_behind_and_can_be_tried_again(
    make_viewer, wait_until_holds, monkeypatch, capfd
):
    viewer = make_viewer(port=LAST_PORT)
    before = held(viewer)
    with socket.create_server(('127.0.0.1', LAST_PORT)):
        assert viewer.trigger_configure() == REFUSED
    assert f'port: expected a free one from {LAST_PORT} on, got none' in capfd.readouterr().err
    wait_until_holds(viewer, before)
    assert viewer.health.readings == {}

    def refuse(*arguments):
        raise ValueError('no page today')

    with monkeypatch.context() as patch:
        patch.setattr(viewer_node, 'LivePage', refuse)  # the server listens by then
        assert viewer.trigger_configure() == REFUSED
    assert 'no page today' in capfd.readouterr().err
    wait_until_holds(viewer, before)

    assert viewer.trigger_configure() == DONE
    assert viewer.health.readings['address'].endswith(f':{LAST_PORT}')


def test_it_can_be_held_and_go_on_and_be_configured_anew(
    make_viewer, pages, observer, wait_until_holds
):
    viewer = make_viewer()
    before = held(viewer)
    assert viewer.trigger_configure() == DONE
    pages[-1].actions.reset()
    assert pages[-1].told == [('viewer is not active', True)]
    with open_browser(viewer):
        assert viewer.trigger_activate() == DONE
        observer.wait(lambda: listens(observer), 'the viewer to listen')
        assert viewer.trigger_deactivate() == DONE
        observer.wait(lambda: not listens(observer), 'the viewer to listen no more')
        assert viewer.trigger_activate() == DONE
        observer.wait(lambda: listens(observer), 'the viewer to listen again')
    observer.wait(lambda: not listens(observer), 'the viewer to see that nobody looks')
    assert viewer.trigger_deactivate() == DONE
    assert viewer.trigger_cleanup() == DONE
    wait_until_holds(viewer, before)

    assert viewer.trigger_configure() == DONE
    assert viewer.trigger_activate() == DONE
    with open_browser(viewer):
        observer.wait(lambda: listens(observer), 'the viewer to listen on its new page')


def test_parameters_that_do_not_fit_are_rejected_and_the_next_ones_shown(
    observer, make_viewer, pages
):
    viewer = make_viewer()
    assert viewer.start(), viewer.failure
    (page,) = pages
    publisher = observer.node.create_publisher(ParameterEvent, 'parameters_in_force', IN_FORCE_QOS)
    good = parameters_message('/controller', to_stamp(1), {}, {'proportional_gain': 0.123})
    no_type = Parameter(name='proportional_gain', value=ParameterValue(type=99))
    bad = {
        'proportional_gain: expected': parameters_message(
            '/controller', to_stamp(0), {}, {'proportional_gain': 'much'}
        ),
        '99': ParameterEvent(node='/controller', changed_parameters=[no_type]),
        'expected the node /controller, got /other': ParameterEvent(node='/other'),
    }
    for message in bad.values():
        publisher.publish(message)
    publisher.publish(good)
    observer.wait(lambda: page.parameters, 'the good ones')
    assert page.parameters == [{'proportional_gain': 0.123}]
    reasons = [reason for reason, _ in viewer.health.rejected.items()]
    assert len(reasons) == len(bad)
    for words, reason in zip(bad, reasons, strict=True):
        assert reason.startswith('parameters_in_force: ')
        assert words in reason


def test_a_recorder_that_fails_is_told(domain, observer, make_viewer, pages, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain.number))  # of what the node starts
    viewer = make_viewer()
    assert viewer.start(), viewer.failure
    (page,) = pages
    processes = {}

    def hear(message):
        for status in message.status:
            values = {each.key: each.value for each in status.values}
            processes[status.name] = int(values['process id'])

    observer.node.create_subscription(DiagnosticArray, '/diagnostics', hear, 10)
    page.actions.record(True)
    observer.wait(lambda: 'viewer_recorder' in processes, 'the recorder')
    os.kill(processes['viewer_recorder'], signal.SIGKILL)
    observer.wait(lambda: page.recording == [True, False], 'the end of the log')
    assert page.told == [('ended by SIGKILL', True)]
