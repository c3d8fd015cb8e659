"""What a scene holds is where the body is, to the float32 that a browser draws with."""

import sys

import numpy as np
import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync import client

from dpc_ros.view import ViewerError, address, open_server, strain_colours
from dpc_ros.view.frame import Frame
from dpc_ros.view.scene import METRES_PER_NEWTON, BodyScene


@pytest.fixture
def server(small_network):
    server = open_server('127.0.0.1', 0, 'test', small_network)
    yield server
    server.stop()


@pytest.fixture
def scene(server, small_network):
    mass = int(small_network.mobile[-1])
    return BodyScene(server.scene, small_network, mass), mass


def handle(server, name):
    return server.scene.get_handle_by_name(name)


def test_springs_and_their_colours_are_those_of_the_frame(
    server, scene, small_network, random_state
):
    body, mass = scene
    q, other = random_state(1, small_network)[0], random_state(2, small_network)[0]
    force = np.array([1.0, -2.0])
    body.show(Frame(0.0, q, target=other, force=force))
    positions = small_network.positions(q)
    springs = handle(server, '/body')
    np.testing.assert_allclose(
        springs.points[..., :2], positions[small_network.springs], rtol=1e-6, atol=1e-6
    )
    expected = strain_colours(small_network.strains(q))
    np.testing.assert_array_equal(springs.colors[:, 0], expected)
    np.testing.assert_array_equal(springs.colors[:, 1], expected)
    ghost = handle(server, '/target')
    np.testing.assert_allclose(
        ghost.points[..., :2],
        small_network.positions(other)[small_network.springs],
        rtol=1e-6,
        atol=1e-6,
    )
    assert ghost.visible
    assert not handle(server, '/reconstruction').visible
    (arrow,) = handle(server, '/force').points
    np.testing.assert_allclose(arrow[0, :2], positions[mass], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose((arrow[1] - arrow[0])[:2], METRES_PER_NEWTON * force, atol=1e-5)


def test_what_is_not_known_or_not_wanted_is_not_seen(server, scene, small_network):
    body, _ = scene
    rest = small_network.rest_configuration
    body.show(Frame(0.0, rest, target=rest, force=np.ones(2)))
    body.hide('target', True)
    assert not handle(server, '/target').visible
    body.show(Frame(0.1, rest, target=rest))
    assert not handle(server, '/target').visible
    assert not handle(server, '/force').visible
    body.hide('target', False)
    assert handle(server, '/target').visible
    body.show(Frame(0.2, rest, target=rest, force=np.ones(2)))
    assert handle(server, '/target').visible
    assert handle(server, '/force').visible


def test_the_page_is_for_this_machine_alone_unless_told_otherwise(server):
    assert address(server) == f'http://localhost:{server.get_port()}'
    assert server.get_host() == '127.0.0.1'


def test_a_port_that_is_taken_gives_way_to_the_next(server, small_network):
    other = open_server('127.0.0.1', server.get_port(), 'test', small_network)
    try:
        assert other.get_port() != server.get_port()
    finally:
        other.stop()


def test_an_interface_that_is_not_there_is_refused(small_network):
    with pytest.raises(ViewerError, match=r"host '192\.0\.2\.1': expected the address"):
        open_server('192.0.2.1', 0, 'test', small_network)


def test_without_viser_it_is_said_how_to_get_it(small_network, monkeypatch):
    monkeypatch.setitem(sys.modules, 'viser', None)
    with pytest.raises(ViewerError, match=r'dpc_ros\[viewer\]'):
        open_server('127.0.0.1', 0, 'test', small_network)


@pytest.mark.parametrize('port', [-1, 70000])
def test_a_port_that_there_is_none_of_is_refused(small_network, port):
    with pytest.raises(ViewerError, match=f'expected 0 to 65535, got {port}'):
        open_server('127.0.0.1', port, 'test', small_network)


def connect(server, origin):
    return client.connect(
        f'ws://127.0.0.1:{server.get_port()}',
        subprotocols=[f'viser-v{viser.__version__}'],
        origin=origin,
    )


def test_no_page_of_another_site_is_let_in(server):
    with connect(server, f'http://localhost:{server.get_port()}'):
        pass
    for origin in ('http://example.org', f'http://example.org:{server.get_port()}', 'null'):
        with pytest.raises(InvalidStatus):
            connect(server, origin)


def test_nobody_can_have_it_reached_from_elsewhere(server):
    assert server.request_share_url() is None
