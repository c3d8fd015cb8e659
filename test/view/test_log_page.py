"""A log in a browser: its moments are those that were recorded, and it plays to its end."""

import threading
from pathlib import Path

import numpy as np
import pytest

from dpc_ros.bag.report import converge
from dpc_ros.view import LogPage, RecordedFrames, address, open_server

BAG = Path(__file__).parents[2] / 'bags' / 'demo_1s'
SIZE = {'width': 1200, 'height': 600}  # pixels


@pytest.fixture(scope='module')
def convergence():
    found, _ = converge(BAG)
    return found


@pytest.fixture
def log_page(convergence):
    server = open_server('127.0.0.1', 0, 'test', convergence.mechanics.network)
    page = LogPage(server, RecordedFrames(convergence))
    page.address = address(server)
    over = threading.Event()
    player = threading.Thread(target=page.run, args=[over.is_set])
    player.start()
    yield page
    over.set()
    player.join()
    page.close()


def test_a_frame_is_what_was_logged_at_its_time(convergence):
    frames, run = RecordedFrames(convergence), convergence.run
    for i in (0, 7, len(run.configuration) - 1):
        frame = frames.frame(frames.times[i])
        np.testing.assert_array_equal(frame.configuration, run.configuration[i])
        np.testing.assert_array_equal(frame.latent, run.latent[i])
        np.testing.assert_array_equal(frame.force, run.force[i])
        np.testing.assert_array_equal(
            frame.reconstruction, convergence.autoencoder.decode(run.latent[i])
        )
        assert frame.nmse == convergence.nmse[i]
        assert sum(frame.energies) == pytest.approx(convergence.energy.total[i])
    between = 0.5 * (frames.times[3] + frames.times[4])
    assert frames.frame(between).time == frames.times[3]
    assert frames.frame(-1.0).time == frames.times[0]
    assert frames.frame(1e9).time == frames.times[-1]


def test_the_curves_go_on_until_the_moment(convergence):
    frames = RecordedFrames(convergence)
    times = frames.history(frames.times[50]).curves().time
    assert times[0] == frames.times[0]
    assert frames.times[40] < times[-1] <= frames.times[50]


def test_a_log_scrubs_and_plays(log_page, convergence, open_page, set_field):
    page = open_page(log_page.address, viewport=SIZE)
    page.get_by_text('0.00 s').wait_for()
    set_field(page, 't [s]', 0.5)
    page.get_by_text('0.50 s').wait_for()
    nmse = convergence.nmse[np.searchsorted(convergence.time, 0.5)]
    page.get_by_text(f'nMSE {nmse:.3g}').wait_for()
    page.get_by_role('button', name='Play').click()
    page.get_by_text(f'{convergence.time[-1]:.2f} s').wait_for()
    page.get_by_role('button', name='Play').wait_for()
    assert page.errors == []
