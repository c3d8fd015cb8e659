"""Look at the page of a viewer until told to stop, as a browser would, and draw nothing."""

import contextlib
import signal
import sys
import time

import msgspec
import viser
from websockets.exceptions import WebSocketException
from websockets.sync import client
from websockets.typing import Subprotocol

ADDRESS = 'ws://127.0.0.1:8080'
# What a browser says first: without a camera it is not one that looks.
CAMERA = {
    'type': 'ViewerCameraMessage',
    'wxyz': (1.0, 0.0, 0.0, 0.0),
    'position': (0.0, 0.0, 10.0),
    'fov': 1.0,
    'near': 0.1,
    'far': 100.0,
    'image_height': 600,
    'image_width': 900,
    'look_at': (0.0, 0.0, 0.0),
    'up_direction': (0.0, 1.0, 0.0),
}
PERIOD = 0.1  # s between two tries


def connect(address=ADDRESS):
    """Return a connection to a page, which takes the other end for a browser."""
    protocol = Subprotocol(f'viser-v{viser.__version__}')
    connection = client.connect(address, subprotocols=[protocol], max_size=None)
    connection.send(msgspec.msgpack.encode(CAMERA))
    return connection


def look(address=ADDRESS):
    """Take what a page is sent until the connection ends."""
    with connect(address) as connection:
        for _ in connection:
            pass


def main():
    signal.signal(signal.SIGINT, lambda number, frame: sys.exit())
    while True:
        with contextlib.suppress(OSError, WebSocketException):
            look()
        time.sleep(PERIOD)


if __name__ == '__main__':
    main()
