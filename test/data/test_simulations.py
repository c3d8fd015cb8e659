"""Simulations follow on one another as their conditions say."""

from dataclasses import replace

import numpy as np
import pytest

from dpc_ros.data import Condition, simulate_condition, simulate_conditions
from dpc_ros.data.conditions import test_conditions as held_out_conditions
from dpc_ros.data.conditions import training_conditions
from dpc_ros.network import Gravity, Integrator, Mechanics, simulate

DURATION, STEP = 0.1, 0.005  # s


def conditions(*starts):
    return [
        Condition(i + 1, 'train', Gravity(9.81, -1.0 - 0.5 * i), start)
        for i, start in enumerate(starts)
    ]


def trajectories(network, *starts):
    return [
        trajectory
        for _, trajectory in simulate_conditions(network, conditions(*starts), DURATION, STEP)
    ]


def test_rest_starts_from_the_rest_position(small_network):
    for trajectory in trajectories(small_network, 'rest', 'rest'):
        np.testing.assert_array_equal(trajectory.configuration[0], small_network.rest_configuration)
        np.testing.assert_array_equal(trajectory.velocity[0], 0)
        assert len(trajectory.configuration) == round(DURATION / STEP) + 1


def test_continue_takes_position_and_velocity_on(small_network):
    before, after = trajectories(small_network, 'rest', 'continue')
    assert np.abs(before.velocity[-1]).max() > 0
    np.testing.assert_array_equal(after.configuration[0], before.configuration[-1])
    np.testing.assert_array_equal(after.velocity[0], before.velocity[-1])


def test_previous_end_takes_the_position_on_at_rest(small_network):
    before, after = trajectories(small_network, 'rest', 'previous_end')
    np.testing.assert_array_equal(after.configuration[0], before.configuration[-1])
    np.testing.assert_array_equal(after.velocity[0], 0)


def test_each_runs_under_its_own_gravity(small_network):
    for condition, trajectory in simulate_conditions(
        small_network, conditions('rest', 'continue', 'previous_end'), DURATION, STEP
    ):
        integrator = Integrator(Mechanics(small_network, condition.gravity), STEP)
        start = trajectory.configuration[0], trajectory.velocity[0]
        expected = simulate(integrator, *start, round(DURATION / STEP))
        np.testing.assert_array_equal(trajectory.configuration, expected.configuration)
        np.testing.assert_array_equal(trajectory.velocity, expected.velocity)


def test_series_side_by_side_come_in_order_and_as_alone(small_network):
    series = [('rest', 'continue', 'previous_end')[: 1 + k % 3] for k in range(20)]
    listed = conditions(*(start for each in series for start in each))
    together = list(simulate_conditions(small_network, listed, DURATION, STEP))
    assert [condition for condition, _ in together] == listed
    for each in series:
        alone = [listed.pop(0) for _ in each]
        for condition, expected in simulate_conditions(small_network, alone, DURATION, STEP):
            found, trajectory = together.pop(0)
            assert found == condition
            np.testing.assert_array_equal(trajectory.configuration, expected.configuration)
            np.testing.assert_array_equal(trajectory.velocity, expected.velocity)


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_a_body_too_stiff_for_the_step_is_reported(small_network):
    stiff = replace(small_network, stiffness=1e12 * small_network.stiffness)
    with pytest.raises(ValueError, match=r'simulation 1 of grid diverged .* step of 0\.005 s'):
        trajectories(stiff, 'rest')


@pytest.mark.parametrize('number', [1, 3, 8, 10, 18])
def test_a_condition_is_simulated_as_in_its_series(small_network, number):
    conditions = training_conditions() if number < 8 else held_out_conditions()
    condition, trajectory = simulate_condition(small_network, number)
    for expected, in_series in simulate_conditions(small_network, conditions):
        if expected.simulation == number:
            assert condition == expected
            np.testing.assert_array_equal(trajectory.configuration, in_series.configuration)
            np.testing.assert_array_equal(trajectory.velocity, in_series.velocity)
            return
    pytest.fail(f'simulation {number} is not in its series')


def test_a_condition_that_does_not_exist_is_refused(small_network):
    with pytest.raises(ValueError, match='simulation 99: expected one of 1 to 37'):
        simulate_condition(small_network, 99)
