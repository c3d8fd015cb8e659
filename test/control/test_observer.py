"""The filter on the compressed dynamics is consistent, bridges gaps and foresees delays."""

import numpy as np
import pytest

from dpc_ros.control import (
    LatentObserver,
    ObserverSettings,
)
from dpc_ros.reduction import simulate_compressed

STEP = 0.01  # s
NANOSECONDS = 10_000_000
START = np.array([0.8, -0.5, 0.3]), np.array([1.0, 0.5, -1.5])
NOISE = ObserverSettings(position_noise=0.02, velocity_noise=0.1, acceleration_noise=1.0)


def covariance_root(system, latent):
    """Return A with AAᵀ = (JᵀJ)⁻¹."""
    jacobian = system.autoencoder.decoder_jacobian(latent)
    return np.linalg.cholesky(np.linalg.inv(jacobian.T @ jacobian))


@pytest.fixture(scope='module')
def noisy_run(small_system):
    """A run that is what the filter takes for granted: its states, forces and measurements."""
    system, draw = small_system(3), np.random.default_rng(0)
    states, forces, measured = [START], [], []
    for _ in range(400):
        latent, velocity = states[-1]
        root = covariance_root(system, latent)
        measured.append(
            (
                latent + NOISE.position_noise * root @ draw.normal(size=3),
                velocity + NOISE.velocity_noise * root @ draw.normal(size=3),
            )
        )
        forces.append(draw.normal(size=2))
        run = simulate_compressed(system, latent, velocity, STEP, 1, forces[-1])
        kick = NOISE.acceleration_noise * np.sqrt(STEP) * root @ draw.normal(size=3)
        states.append((run.latent[-1] + 0.5 * STEP * kick, run.velocity[-1] + kick))
    return states[:-1], forces, measured


def filtered(system, settings, forces, measured):
    observer, estimates, scores = LatentObserver(system, settings), [], []
    for k, (state, force) in enumerate(zip(measured, forces, strict=True)):
        estimates.append(observer.update(*state, k * NANOSECONDS))
        observer.acted(k * NANOSECONDS, force)
        if k:
            innovation = observer.innovation
            scores.append(innovation @ np.linalg.solve(observer.innovation_covariance, innovation))
    return estimates, scores


def deviation(system, states, others):
    """Return the root mean square distance of decoded velocities and configurations."""
    errors = []
    for (latent, velocity), (xi, xi_dot) in zip(states, others, strict=True):
        jacobian = system.autoencoder.decoder_jacobian(latent)
        errors.append([jacobian @ (xi - latent), jacobian @ (xi_dot - velocity)])
    return np.sqrt(np.mean(np.square(errors), axis=(0, 2)))


def test_innovations_are_as_large_as_the_filter_says(small_system, noisy_run):
    """Normalised, their squares have the mean 2m, within five deviations of that mean."""
    _, scores = filtered(small_system(3), NOISE, *noisy_run[1:])
    spread = np.sqrt(2 * 6 / len(scores))
    assert np.mean(scores) == pytest.approx(6.0, abs=5 * spread)


def test_estimates_are_better_than_measurements(small_system, noisy_run):
    states, forces, measured = noisy_run
    estimates, _ = filtered(small_system(3), NOISE, forces, measured)
    raw = deviation(small_system(3), states, measured)
    better = deviation(small_system(3), states, estimates)
    assert (better < 0.8 * raw).all()


def test_gaps_are_bridged_by_the_dynamics(small_system):
    system, force = small_system(3), np.array([1.0, -0.5])
    observer = LatentObserver(system, NOISE)
    observer.update(*START, 0)
    observer.acted(0, force)
    run = simulate_compressed(system, *START, STEP, 30, force)
    state = observer.update(run.latent[-1], run.velocity[-1], 30 * NANOSECONDS)
    np.testing.assert_allclose(observer.innovation, 0, atol=1e-6)
    np.testing.assert_allclose(state, (run.latent[-1], run.velocity[-1]), atol=1e-6)


def test_the_answer_is_for_the_moment_when_it_acts(small_system):
    """Forces that are on their way are known, and what they will do meanwhile."""
    system = small_system(3)
    delayed = ObserverSettings(0.02, 0.1, 1.0, delay=3 * STEP)
    observer, forces = LatentObserver(system, delayed), np.random.default_rng(2).normal(size=(9, 2))
    acting = np.vstack([np.zeros((3, 2)), forces])
    run = simulate_compressed(system, *START, STEP, 9, acting[:9])
    for k in range(6):
        observer.update(run.latent[k], run.velocity[k], k * NANOSECONDS)
        ahead = observer.ahead()
        expected = run.latent[k + 3], run.velocity[k + 3]
        np.testing.assert_allclose(ahead, expected, atol=1e-5)
        observer.acted(k * NANOSECONDS, forces[k])


@pytest.mark.parametrize('stamp', [-5 * NANOSECONDS, 200 * NANOSECONDS])
def test_a_time_before_or_a_long_gap_begins_anew(small_system, stamp):
    observer = LatentObserver(small_system(3), NOISE)
    observer.update(*START, 0)
    other = np.ones(3), np.zeros(3)
    np.testing.assert_array_equal(observer.update(*other, stamp), other)


def test_no_prediction_without_a_measurement(small_system):
    with pytest.raises(ValueError, match='expected a measurement before a prediction'):
        LatentObserver(small_system(3), NOISE).ahead()


def test_an_estimate_is_for_the_moment_when_its_answer_acts(small_system):
    system = small_system(3)
    plain, delayed = (LatentObserver(system, NOISE) for _ in range(2))
    delayed.delay = 3 * STEP  # may be measured, and change
    for k in range(4):
        expected = plain.update(*START, k * NANOSECONDS)
        np.testing.assert_array_equal(plain.estimate(*START, k * NANOSECONDS + 1), plain.ahead())
        estimate = delayed.estimate(*START, k * NANOSECONDS)
        if k == 0:
            run = simulate_compressed(system, *expected, STEP, 3)
            np.testing.assert_array_equal(estimate, (run.latent[-1], run.velocity[-1]))


def test_forces_that_change_within_a_step_of_the_prediction_count_by_their_mean(small_system):
    system, half, delay = small_system(3), STEP / 2, 14
    forces = np.column_stack([np.sin(np.arange(40) / 5), np.cos(np.arange(40) / 7)])
    acting = np.vstack([np.zeros((delay, 2)), forces])
    run = simulate_compressed(system, *START, half, 40, acting[:40])
    observer = LatentObserver(system, ObserverSettings(delay=delay * half))
    for k in range(40 - delay):
        observer.update(run.latent[k], run.velocity[k], k * NANOSECONDS // 2)
        error = np.subtract(observer.ahead(), (run.latent[k + delay], run.velocity[k + delay]))
        jacobian = system.autoencoder.decoder_jacobian(run.latent[k + delay])
        assert np.abs(jacobian @ error[0]).max() < 0.2 * observer.settings.position_noise
        observer.acted(k * NANOSECONDS // 2, forces[k])


def test_a_prediction_has_the_mean_force_of_each_of_its_steps(small_system):
    observer = LatentObserver(small_system(3), ObserverSettings(delay=3 * STEP))
    observer.update(*START, 0)
    forces = np.array([[1.0, -2.0], [3.0, 0.5]])
    for k, force in enumerate(forces):
        observer.acted(k * NANOSECONDS, force)
    begin = 5 * NANOSECONDS // 2  # half a step before the first force acts
    expected = [0.5 * forces[0], 0.5 * (forces[0] + forces[1]), forces[1]]
    steps = [*observer._steps(begin, begin + 3 * NANOSECONDS)]
    for (duration, force), mean in zip(steps, expected, strict=True):
        assert duration == pytest.approx(STEP)
        np.testing.assert_allclose(force, mean, rtol=1e-12)
    assert not [*observer._steps(begin, begin)]


def test_a_force_counts_once(small_system):
    once, twice = (LatentObserver(small_system(3), NOISE) for _ in range(2))
    for observer, forces in ((once, 1), (twice, 2)):
        observer.update(*START, 0)
        for other in range(forces):
            observer.acted(0, np.array([1.0, other]))
    np.testing.assert_array_equal(
        once.update(*START, NANOSECONDS), twice.update(*START, NANOSECONDS)
    )


def test_forces_of_another_motion_are_forgotten(small_system):
    """After a leap of the stamps no force acts until a new one is known."""
    system, leap = small_system(3), 100 * NANOSECONDS
    observer, fresh = (LatentObserver(system, ObserverSettings(delay=STEP)) for _ in range(2))
    observer.update(*START, 0)
    observer.acted(0, np.array([1.0, -1.0]))
    for k in (0, 1):
        estimates = [each.estimate(*START, leap + k * NANOSECONDS) for each in (observer, fresh)]
        observer.acted(3 * NANOSECONDS, np.ones(2))  # late
        np.testing.assert_array_equal(*estimates)


@pytest.mark.parametrize('value', [-1.0, np.nan, np.inf])
@pytest.mark.parametrize('name', ['position_noise', 'velocity_noise', 'delay', 'longest_gap'])
def test_bad_settings_are_refused(name, value):
    with pytest.raises(ValueError, match=f'{name.replace("_", " ")}: expected a finite number'):
        ObserverSettings(**{name: value})


def test_a_gap_longer_than_a_reset_leaps_is_refused():
    with pytest.raises(ValueError, match=r'longest gap: expected at most 0\.5 s'):
        ObserverSettings(longest_gap=0.6)


def test_measurements_without_noise_are_refused():
    with pytest.raises(ValueError, match='noise of measurements: expected numbers > 0'):
        ObserverSettings(position_noise=0.0)


def test_what_is_no_number_passes_through_and_leaves_the_filter(small_system):
    observer = LatentObserver(small_system(3), NOISE)
    before = observer.update(*START, 0)
    nothing = np.full(3, np.nan)
    np.testing.assert_array_equal(observer.update(nothing, nothing, NANOSECONDS), [nothing] * 2)
    np.testing.assert_array_equal(observer.ahead(), before)
