"""An independent simulator, MuJoCo, gives the same accelerations for the same body."""

from dataclasses import replace

import numpy as np
import pytest

from dpc_ros.network import Gravity, Mechanics

mujoco = pytest.importorskip('mujoco', reason='MuJoCo is not installed (extra `test`)')

from mujoco_body import mujoco_acceleration, mujoco_model  # noqa: E402

GRAVITY = Gravity(9.81, -1.2)
STEP = 0.005  # s


@pytest.mark.parametrize('body', ['random', 'small', 'paper'])
def test_accelerations_are_equal(random_network, small_network, paper_2, random_state, body):
    network = {'random': random_network(3), 'small': small_network, 'paper': paper_2}[body]
    network = replace(network, damping_kind='axial', background_stiffness=0.0)
    mechanics = Mechanics(network, GRAVITY)
    model = mujoco_model(network, GRAVITY, STEP)
    data = mujoco.MjData(model)
    for seed in range(5):
        q, velocity = random_state(seed, network)
        force = np.random.default_rng(seed).normal(size=q.shape)
        expected = mechanics.acceleration(q, velocity, force)
        found = mujoco_acceleration(model, data, q, velocity, force)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(
    'change',
    [
        {'damping_kind': 'isotropic', 'background_stiffness': 0.0},
        {'damping_kind': 'axial', 'background_stiffness': 0.2},
    ],
)
def test_what_mujoco_cannot_be_is_refused(small_network, change):
    with pytest.raises(ValueError, match='axial damping'):
        mujoco_model(replace(small_network, **change), GRAVITY, STEP)
