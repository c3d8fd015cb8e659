"""Time of a picture of the viewer, with a browser that takes it, beside a thirtieth of a second."""

import statistics
import threading
import time

import numpy as np
from body_scaling import grid
from side_by_side import row
from watch_viewer import look

from dpc_ros.network import load_network
from dpc_ros.view import Frame, open_server
from dpc_ros.view.scene import BodyScene

PERIOD = 1 / 30  # s
PICTURES = 100
SIDE = 71  # masses, of a grid of about 5000


def measure():
    """Return the rows: the paper's system 2, and a grid of about 5000 masses."""
    return [
        row(
            f'viewer_picture_{len(network.mass)}_masses',
            '30 pictures a second',
            statistics.median(_times(network)),
            PERIOD,
            goal=1.0 if len(network.mass) < 1000 else None,
        )
        for network in (load_network('paper_2'), grid(SIDE))
    ]


def _times(network):
    """Return how long each picture took [s], until it was on its way."""
    server = open_server('127.0.0.1', 0, 'benchmark', network)
    watcher = threading.Thread(
        target=look, args=[f'ws://127.0.0.1:{server.get_port()}'], daemon=True
    )
    scene = BodyScene(server.scene, network, int(network.mobile[-1]))
    watcher.start()
    while not server.get_clients():
        time.sleep(PERIOD)
    rest, times = network.rest_configuration, []
    random = np.random.default_rng(0)
    for _ in range(PICTURES):
        q = rest + 0.01 * random.standard_normal(len(rest))
        begin = time.perf_counter()
        with server.atomic():
            scene.show(Frame(0.0, q, target=rest, reconstruction=rest, force=np.ones(2)))
        server.flush()
        times.append(time.perf_counter() - begin)
        time.sleep(PERIOD)
    server.stop()
    watcher.join()
    return times
