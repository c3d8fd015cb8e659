"""The web server of a viewer, with the camera in front of the body."""

from __future__ import annotations

import contextlib
import functools
import io
import ipaddress
import re
import socket
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dpc_ros.network import MassSpringNetwork

if TYPE_CHECKING:
    from viser import ViserServer

_DISTANCE = 1.9  # of the camera, in extents of the body
_SHOWN = 8.0  # s for which a notification stays
_LARGEST_PORT = 65535
# Pages that may talk to a server on loopback: its own. Else any page that someone visits could.
_LOCAL_PAGES = re.compile(r'https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?')


class ViewerError(ValueError):
    """A viewer that can't be: what was expected, what came, what to do."""


def open_server(host: str, port: int, title: str, network: MassSpringNetwork) -> ViserServer:
    """Return a viser server, empty but for the camera.

    On loopback it refuses the connections of pages that are not its own.

    Args:
        host: address of the interface to listen on; 127.0.0.1 is this machine alone.
        port: to listen on, or the next one that is free; 0 lets the system choose.
        title: of the page.
        network: the body that is to be seen.

    Raises:
        ViewerError: viser is not installed, or there is no such interface or free port.
    """
    try:
        import viser
    except ImportError as error:
        raise ViewerError("the viewer needs viser: pip install 'dpc_ros[viewer]'") from error
    port = _free_port(host, port)

    class Server(viser.ViserServer):
        """One that no browser can ask to be reached over viser's public relay."""

        def request_share_url(self, verbose: bool = True) -> str | None:
            return None

    with quiet(), _own_pages_only(host):
        server = Server(host=host, port=port, label=title, verbose=False)
    server.gui.configure_theme(show_share_button=False, show_logo=False, brand_color=(0, 114, 178))
    server.scene.set_up_direction('+y')
    server.scene.world_axes.visible = False
    low, high = network.rest_position.min(axis=0), network.rest_position.max(axis=0)
    x, y = 0.5 * (low + high)
    camera = server.initial_camera
    camera.position = (x, y, _DISTANCE * extent(network))
    camera.look_at = (x, y, 0.0)
    camera.up = (0.0, 1.0, 0.0)
    return server


def is_loopback(host: str) -> bool:
    """Return whether an address is reached from this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == 'localhost'


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Let viser print nothing, as it does where it begins and ends to listen."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


def extent(network: MassSpringNetwork) -> float:
    """Return the longer side of the body at rest [m]."""
    return float(np.ptp(network.rest_position, axis=0).max())


def address(server: ViserServer) -> str:
    """Return where a browser on this machine finds the page."""
    host = server.get_host()
    shown = 'localhost' if host in ('0.0.0.0', '127.0.0.1') else host
    return f'http://{f"[{shown}]" if ":" in shown else shown}:{server.get_port()}'


def notify(server: ViserServer, text: str, problem: bool = False) -> None:
    """Show a line to all who look at the page now."""
    for client in server.get_clients().values():
        client.add_notification(
            'Refused' if problem else 'Done',
            text,
            auto_close_seconds=_SHOWN,
            color='red' if problem else 'green',
        )


def _free_port(host: str, port: int) -> int:
    """Return the port, or the next one that is free.

    Raises:
        ViewerError: there is none, or the host is no address of this machine.
    """
    if not 0 <= port <= _LARGEST_PORT:
        raise ViewerError(f'port: expected 0 to {_LARGEST_PORT}, got {port}')
    if not host:
        raise ViewerError('host: expected an address as 127.0.0.1, got none')
    family = socket.AF_INET6 if ':' in host else socket.AF_INET
    try:
        with socket.socket(family) as probe:
            probe.bind((host, 0))
    except OSError as error:
        raise ViewerError(
            f'host {host!r}: expected the address of an interface of this machine, as 127.0.0.1, '
            f'but {error}'
        ) from error
    for candidate in range(port, _LARGEST_PORT + 1 if port else 1):
        with socket.socket(family) as probe, contextlib.suppress(OSError):
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server does
            probe.bind((host, candidate))
            return candidate
    raise ViewerError(f'port: expected a free one from {port} on, got none')


@contextlib.contextmanager
def _own_pages_only(host: str) -> Iterator[None]:
    """Let a server that is opened meanwhile refuse other pages, where it is on loopback.

    viser has no option for it; the library that it listens with has.
    """
    import websockets.asyncio.server as listening

    serve = listening.serve
    if is_loopback(host):
        own = functools.partial(serve, origins=[None, _LOCAL_PAGES])
        listening.serve = own  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        listening.serve = serve  # type: ignore[misc]
