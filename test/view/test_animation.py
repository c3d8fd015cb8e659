"""Few frames, small numbers: what a page shows of the motion is near to what was logged."""

import base64
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.bag import analyse, read_run
from dpc_ros.bag.report import converge
from dpc_ros.network import Mechanics
from dpc_ros.view import NothingToShowError, animate
from dpc_ros.view.animation import FRAMES_PER_SECOND, LARGEST_FRAMES, select_frames

SAMPLE = Path(__file__).parents[2] / 'bags' / 'demo_1s'
STEP = 5_000_000  # ns
TIMES = st.lists(st.floats(0, 1e5), min_size=1, max_size=200, unique=True).map(
    lambda times: np.array(sorted(times)) - min(times)
)


def unpack(content):
    return np.frombuffer(base64.b64decode(content['bdata']), f'<{content["dtype"]}')


def positions(content, masses):
    level = unpack(content['level']).reshape(-1, masses, 2)
    return np.array(content['low']) + np.array(content['step']) * level


@given(TIMES, st.floats(0.1, 100), st.integers(2, 50))
def test_frames_begin_and_end_with_the_run_and_are_not_too_many(time, per_second, largest):
    chosen = select_frames(time, per_second, largest)
    assert chosen[0] == 0
    assert chosen[-1] == len(time) - 1
    assert (np.diff(chosen) > 0).all()
    assert len(chosen) <= min(largest, time[-1] * per_second + 2)


@given(st.integers(2, 3000), st.floats(1e-3, 1.0))
def test_frames_are_spread_over_the_run(samples, step):
    time = step * np.arange(samples)
    chosen = select_frames(time)
    rate = min(FRAMES_PER_SECOND, (LARGEST_FRAMES - 1) / time[-1])
    assert np.diff(time[chosen]).max() <= 1 / rate + 2 * step


def test_the_motion_of_the_sample_log_is_shown():
    convergence, _ = converge(SAMPLE)
    network = convergence.mechanics.network
    content = json.loads(json.dumps(animate(convergence), allow_nan=False))
    time, run = unpack(content['time']), convergence.run
    frame = np.searchsorted(convergence.time, time)
    assert np.array_equal(convergence.time[frame], time)
    shown = positions(content['body'], len(network.mass))
    expected = network.positions(run.configuration[frame])
    tolerance = np.array(content['body']['step']) / 2 + 1e-12
    assert (np.abs(shown - expected) <= tolerance).all()
    (target,) = positions(content['targets'], len(network.mass))
    assert np.allclose(target, network.positions(run.targets[0].configuration), atol=1e-3)
    assert (unpack(content['target']) == 0).all()
    decoded = convergence.autoencoder.decode(run.latent[frame])
    shown = positions(content['reconstruction'], len(network.mass))
    assert np.allclose(shown, network.positions(decoded), atol=1e-3)
    assert content['mass'] == 162
    assert np.allclose(unpack(content['force']).reshape(-1, 2), run.force[frame])


def test_all_that_moves_is_within_the_picture():
    convergence, _ = converge(SAMPLE)
    content = animate(convergence)
    low, high = np.array(content['limits']).reshape(2, 2)
    masses = len(convergence.mechanics.network.mass)
    for each in ('body', 'targets'):
        shown = positions(content[each], masses)
        assert (shown >= low).all()
        assert (shown <= high).all()


@pytest.fixture
def square_run(log_type, record, square_network):
    """Return a function: configurations, one each step → the run of the square."""

    def run(*configurations, **others):
        states = [(STEP * k, q, np.zeros(4)) for k, q in enumerate(configurations)]
        log = log_type(configuration=states, network=square_network.identifier, **others)
        return read_run(record(log))

    return run


@pytest.mark.parametrize('value', [np.nan, np.inf, 1e300, 1e3])
def test_a_body_that_explodes_is_shown_until_then(square_run, square_network, value):
    rest = square_network.rest_configuration
    gone = np.array([value, *rest[1:]])
    run = square_run(*[rest] * 20, *[gone] * 20)
    content = animate(analyse(run, Mechanics(square_network)))
    level = unpack(content['body']['level']).reshape(-1, 8)
    is_missing = (level == 2**16 - 1).all(axis=1)
    assert is_missing.tolist() == (unpack(content['time']) >= 0.1).tolist()
    assert np.ptp(content['limits']) < 10


def test_a_body_that_was_never_finite_can_not_be_shown(square_run, square_network):
    run = square_run(np.full(4, np.nan))
    with pytest.raises(NothingToShowError, match='no configuration'):
        animate(analyse(run, Mechanics(square_network)))


def test_an_unknown_body_can_not_be_shown(square_run, square_network):
    run = square_run(square_network.rest_configuration)
    with pytest.raises(NothingToShowError, match=f'{square_network.identifier}.* --network'):
        animate(analyse(run))


def test_targets_are_shown_when_they_are_in_force(square_run, square_network):
    rest = square_network.rest_configuration
    goals = [rest + 0.1 * k for k in range(4)]  # the third one for no time, the last one not yet
    stamps = [30 * STEP, 60 * STEP, 60 * STEP, 999 * STEP]
    targets = [(*each, False) for each in zip(stamps, goals, strict=True)]
    run = square_run(*[rest] * 100, targets=targets)
    content = animate(analyse(run, Mechanics(square_network)))
    shown = positions(content['targets'], 4)[:, square_network.mobile].reshape(-1, 4)
    assert np.allclose(shown, [goals[0], goals[2]], atol=1e-4)
    time, target = unpack(content['time']), unpack(content['target'])
    assert target.tolist() == np.select([time < 0.15, time < 0.3], [-1, 0], 1).tolist()


def test_without_latent_states_the_configurations_themselves_are_encoded(
    square_run, square_network, linear_autoencoder
):
    rest = square_network.rest_configuration
    autoencoder = linear_autoencoder(np.eye(4)[:, :2])  # keeps the first mass only
    content = animate(analyse(square_run(rest), Mechanics(square_network), autoencoder))
    shown = positions(content['reconstruction'], 4)[0]
    assert np.allclose(shown[square_network.mobile].ravel(), [*rest[:2], 0, 0], atol=1e-4)
    off = unpack(content['reconstruction_error'])
    assert off == pytest.approx(np.sqrt(np.sum(rest[2:] ** 2) / 2))


def test_a_large_body_has_fewer_frames(square_run, square_network, monkeypatch):
    size = 50 * 3 * 2 * 2 * len(square_network.mass)  # bytes of body, reconstruction and target
    monkeypatch.setattr('dpc_ros.view.animation.LARGEST_SIZE', size)
    rest = square_network.rest_configuration
    content = animate(analyse(square_run(*[rest] * 500), Mechanics(square_network)))
    assert 40 < len(unpack(content['time'])) <= 50
    assert content['samples'] == 500
