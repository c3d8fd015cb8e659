"""The closed loop encodes, answers and integrates in turn, and repeats itself bit for bit."""

from dataclasses import fields

import numpy as np
import pytest

from dpc_ros.control import (
    LAWS,
    Imperfections,
    LatentObserver,
    LawSettings,
    ObserverSettings,
    Target,
    load_target,
    make_law,
    run_closed_loop,
)
from dpc_ros.network import Body, Integrator
from dpc_ros.threads import single_threaded_algebra

STEPS = 60


@pytest.fixture(scope='module')
def run_small(small_system, small_configurations):
    """Return a function: run the small body in closed loop under a law."""

    def run(name='reduced_equilibrium', **options):
        system = small_system(3)
        law = make_law(name, system, LawSettings(1.0, 0.5, 0.5))
        law.regulate(Target(configuration=small_configurations[20]))
        body = Body(Integrator(system.mechanics, 0.005), system.actuated_mass)
        return law, run_closed_loop(body, system.autoencoder, law, STEPS, **options)

    return run


@pytest.mark.parametrize('name', LAWS)
def test_every_state_is_encoded_and_answered(run_small, small_system, name):
    law, run = run_small(name)
    assert run.configuration.shape == run.velocity.shape == (STEPS + 1, 24)
    assert run.latent.shape == run.latent_velocity.shape == (STEPS + 1, 3)
    assert run.force.shape == (STEPS + 1, 2)
    autoencoder = small_system(3).autoencoder
    with single_threaded_algebra():
        for k in range(STEPS + 1):
            encoded = autoencoder.encoder_jacobian_vector_product(
                run.configuration[k], run.velocity[k]
            )
            np.testing.assert_array_equal([run.latent[k], run.latent_velocity[k]], encoded)
            np.testing.assert_array_equal(run.force[k], law.force(*encoded))


def test_force_k_is_held_from_state_k_to_the_next(run_small, small_system):
    _, run = run_small()
    mechanics = small_system(3).mechanics
    integrator = Integrator(mechanics, run.step)
    field = mechanics.input_field(14)
    assert np.abs(np.diff(run.force, axis=0)).min(axis=1).max() > 0
    for k in range(STEPS):
        state = integrator.advance(run.configuration[k], run.velocity[k], field @ run.force[k])
        np.testing.assert_array_equal([run.configuration[k + 1], run.velocity[k + 1]], state)


def test_it_starts_from_the_body_where_it_stands(run_small, small_network):
    _, run = run_small()
    np.testing.assert_array_equal(run.configuration[0], small_network.rest_configuration)
    np.testing.assert_array_equal(run.velocity[0], 0)
    assert run.step == 0.005


def test_it_repeats_itself_bit_for_bit(run_small):
    (_, first), (_, second) = run_small(), run_small()
    for field in fields(first):
        np.testing.assert_array_equal(getattr(first, field.name), getattr(second, field.name))


def test_progress_is_told_of_every_state(run_small):
    seen = []
    run_small(on_step=seen.append)
    assert seen == list(range(STEPS + 1))


def test_shipped_controller_brings_the_body_nearer_its_target(shipped, paper_2):
    target = load_target('simulation:2@300', paper_2)
    law = make_law('reduced_equilibrium', shipped.system, LawSettings(2.0, 0.0, 0.3))
    law.regulate(target)
    body = Body(Integrator(shipped.system.mechanics, 0.005), shipped.system.actuated_mass)
    run = run_closed_loop(body, shipped.autoencoder, law, 1000)
    error = np.mean((run.configuration - target.configuration) ** 2, axis=1)
    assert error[-50:].mean() < error[0]
    assert np.linalg.norm(run.force, axis=1).max() <= 2.0 * (1 + 1e-12)


def test_a_force_is_held_between_two_measurements(run_small):
    _, run = run_small(imperfections=Imperfections(hold=4))
    for k in range(STEPS + 1):
        np.testing.assert_array_equal(run.force[k], run.force[k - k % 4])
        np.testing.assert_array_equal(run.latent[k], run.latent[k - k % 4])
    assert len(np.unique(run.force, axis=0)) == STEPS // 4 + 1


def test_latency_delays_the_force(run_small):
    law, run = run_small(imperfections=Imperfections(latency=3))
    np.testing.assert_array_equal(run.force[:3], 0)
    for k in range(3, STEPS + 1):
        answer = law.force(run.latent[k - 3], run.latent_velocity[k - 3])
        np.testing.assert_array_equal(run.force[k], answer)


def test_noise_is_on_what_is_measured_alone(run_small, small_system):
    _, run = run_small(imperfections=Imperfections(noise=0.01, seed=3))
    encoded = small_system(3).autoencoder.encode(run.configuration)
    assert np.abs(encoded - run.latent).min(axis=1).max() > 0
    _, again = run_small(imperfections=Imperfections(noise=0.01, seed=3))
    np.testing.assert_array_equal(run.force, again.force)
    _, other = run_small(imperfections=Imperfections(noise=0.01, seed=4))
    assert np.abs(run.force - other.force).max() > 0


def test_noise_on_velocities_is_of_their_own(run_small, small_system):
    noisy = Imperfections(velocity_noise=0.1, seed=3)
    _, run = run_small(imperfections=noisy)
    autoencoder = small_system(3).autoencoder
    errors = []
    for k in range(STEPS + 1):
        latent, velocity = autoencoder.encoder_jacobian_vector_product(
            run.configuration[k], run.velocity[k]
        )
        np.testing.assert_array_equal(run.latent[k], latent)
        errors.append(run.latent_velocity[k] - velocity)
    assert np.abs(errors).min() > 0
    # The noise of the encoder's input comes through its Jacobian, which is near that at rest.
    jacobian = np.column_stack(
        [
            autoencoder.encoder_jacobian_vector_product(run.configuration[0], direction)[1]
            for direction in np.eye(24)
        ]
    )
    expected = noisy.velocity_noise * np.linalg.norm(jacobian, axis=1)
    np.testing.assert_allclose(np.std(errors, axis=0), expected, rtol=0.5)


def test_the_law_gets_the_estimate(run_small, small_system):
    """And what is recorded is that estimate, of one who knows the measurements and the forces."""
    system, settings = small_system(3), ObserverSettings(delay=0.01)
    law, run = run_small(observer=LatentObserver(system, settings))
    again, encoded = LatentObserver(system, settings), None
    with single_threaded_algebra():
        for k in range(STEPS + 1):
            encoded, velocity = system.autoencoder.encoder_jacobian_vector_product(
                run.configuration[k], run.velocity[k], encoded
            )
            state = again.estimate(encoded, velocity, k * 5_000_000)
            again.acted(k * 5_000_000, run.force[k])
            np.testing.assert_array_equal([run.latent[k], run.latent_velocity[k]], state)
            np.testing.assert_array_equal(run.force[k], law.force(*state))
    assert np.abs(run.latent - system.autoencoder.encode(run.configuration)).max() > 0


@pytest.mark.parametrize(
    'bad',
    [{'hold': 0}, {'latency': -1}, {'noise': -0.1}, {'noise': np.nan}, {'velocity_noise': -0.1}],
)
def test_bad_imperfections_are_refused(bad):
    with pytest.raises(ValueError, match='expected hold ≥ 1'):
        Imperfections(**bad)
