"""Simulated compressed systems keep what the equations of motion keep."""

import inspect
from dataclasses import replace

import numpy as np
import pytest

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.network import Gravity, Integrator, Mechanics, simulate
from dpc_ros.reduction import (
    METHODS,
    CompressedSystem,
    DivergenceError,
    UnsolvedStepError,
    simulate_compressed,
)

GRAVITY = Gravity(16.31, -1.277)  # of test simulation 14
LATENT, VELOCITY = np.array([0.8, -0.5, 0.3]), np.array([2.0, 1.0, -3.0])
PUSH = np.array([0.4, 0.2])


@pytest.fixture(params=sorted(METHODS))
def method(request):
    return request.param


@pytest.fixture(scope='module')
def undamped(small_system):
    system = small_system(3)
    network = system.mechanics.network
    network = replace(network, damping=np.zeros_like(network.damping))
    mechanics = Mechanics(network, system.mechanics.gravity)
    return CompressedSystem(mechanics, system.autoencoder, system.actuated_mass)


@pytest.fixture(scope='module')
def shipped_motion(paper_2):
    """Return the shipped compressed system 2 under strong gravity, and its state at rest."""
    autoencoder = load_checkpoint('paper_2_extended_m5').autoencoder()
    system = CompressedSystem(Mechanics(paper_2, GRAVITY), autoencoder, 162)
    return system, (autoencoder.encode(paper_2.rest_configuration), np.zeros(5))


def energies(system, trajectory):
    states = zip(trajectory.latent, trajectory.velocity, strict=True)
    return np.array([system.total_energy(*state) for state in states])


@pytest.mark.parametrize(('method_name', 'order'), [('rk4', 4), ('implicit_midpoint', 2)])
def test_methods_converge_with_their_order(small_system, method_name, order):
    system, duration = small_system(3), 0.4
    exact = simulate_compressed(system, LATENT, VELOCITY, 0.001, 400, PUSH)
    errors = []
    for step in (0.01, 0.005):
        trajectory = simulate_compressed(
            system, LATENT, VELOCITY, step, round(duration / step), PUSH, method_name
        )
        errors.append(np.linalg.norm(trajectory.latent[-1] - exact.latent[-1]))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.4)


@pytest.mark.parametrize('damping', ['isotropic', 'axial'])
def test_a_linear_decoder_of_full_rank_gives_the_bodys_own_trajectory(full_rank_system, damping):
    system = full_rank_system(damping)
    rest = system.mechanics.network.rest_configuration
    step, steps, still = 0.005, 100, np.zeros(rest.size)
    force = system.full_input_field @ PUSH
    full = simulate(Integrator(system.mechanics, step), rest, still, steps, force)
    latent = system.autoencoder.encode(rest)
    trajectory = simulate_compressed(system, latent, still, step, steps, PUSH)
    decoded = system.autoencoder.decode(trajectory.latent)
    np.testing.assert_allclose(decoded, full.configuration, atol=1e-10)
    np.testing.assert_array_equal(trajectory.time, full.time)


def test_an_undamped_implicit_simulation_runs_backwards(undamped):
    there = simulate_compressed(undamped, LATENT, VELOCITY, 0.02, 50, None, 'implicit_midpoint')
    back = simulate_compressed(
        undamped, there.latent[-1], -there.velocity[-1], 0.02, 50, None, 'implicit_midpoint'
    )
    np.testing.assert_allclose(back.latent[::-1], there.latent, atol=1e-8)
    np.testing.assert_allclose(-back.velocity[::-1], there.velocity, atol=1e-7)


def test_energy_of_an_undamped_implicit_simulation_does_not_drift(undamped):
    """Its error swings within a bound of second order in the step, however long the run."""
    swings = []
    for step in (0.02, 0.01):
        trajectory = simulate_compressed(
            undamped, LATENT, VELOCITY, step, round(4 / step), None, 'implicit_midpoint'
        )
        error = energies(undamped, trajectory)
        error -= error[0]
        early, late = np.array_split(np.abs(error), 2)
        assert late.max() <= 1.3 * early.max()
        swings.append(np.abs(error).max())
    assert swings[1] <= 0.35 * swings[0]


def test_energy_of_an_undamped_system_is_kept_to_the_fifth_order_by_rk4(undamped):
    losses = []
    for step in (0.01, 0.005):
        energy = energies(
            undamped, simulate_compressed(undamped, LATENT, VELOCITY, step, round(2 / step))
        )
        losses.append(np.abs(energy - energy[0]).max())
    assert losses[1] <= losses[0] / 2**3.6


def test_energy_never_rises_without_input(small_system, method):
    system = small_system(3)
    trajectory = simulate_compressed(system, LATENT, VELOCITY, 0.01, 500, None, method)
    energy = energies(system, trajectory)
    assert np.diff(energy).max() <= 1e-9 * np.ptp(energy)
    assert np.abs(trajectory.velocity[-1]).max() < np.abs(VELOCITY).max()


def test_energy_balance_over_a_driven_run(small_system, method):
    """η(T) − η(0) is the integral of the power, by the trapezoidal rule on a fine grid."""
    system, step = small_system(3), 0.002
    forces = 2.0 * np.random.default_rng(0).normal(size=(20, 2)).repeat(10, axis=0)
    trajectory = simulate_compressed(system, LATENT, VELOCITY, step, 200, forces, method)
    energy = energies(system, trajectory)
    work = 0.0
    for k, force in enumerate(forces):
        ends = [
            system.power(trajectory.latent[i], trajectory.velocity[i], force) for i in (k, k + 1)
        ]
        work += 0.5 * step * sum(ends)
    assert energy[-1] - energy[0] == pytest.approx(work, rel=2e-3)


def test_mass_matrix_stays_positive_definite(small_system, shipped):
    draw = np.random.default_rng(0)
    for system, step in ((small_system(3), 0.01), (shipped.system, 0.02)):
        m = system.latent_size
        start = system.autoencoder.encode(system.mechanics.network.rest_configuration)
        trajectory = simulate_compressed(system, start, draw.normal(size=m), step, 50)
        for latent in trajectory.latent:
            assert np.linalg.eigvalsh(system.mass_matrix(latent)).min() > 0


def test_a_constant_force_is_the_same_force_at_every_step(small_system, method):
    system = small_system(3)
    constant = simulate_compressed(system, LATENT, VELOCITY, 0.01, 20, PUSH, method)
    held = simulate_compressed(system, LATENT, VELOCITY, 0.01, 20, np.tile(PUSH, (20, 1)), method)
    np.testing.assert_array_equal(constant.latent, held.latent)
    free = simulate_compressed(system, LATENT, VELOCITY, 0.01, 20, None, method)
    assert np.abs(free.latent[-1] - constant.latent[-1]).max() > 1e-3


def test_several_trajectories_are_simulated_as_each_alone(small_system, method):
    system = small_system(3)
    latents, velocities = np.random.default_rng(1).normal(size=(2, 2, 2, 3))
    together = simulate_compressed(system, latents, velocities, 0.01, 10, PUSH, method)
    assert together.latent.shape == together.velocity.shape == (11, 2, 2, 3)
    for i, j in np.ndindex(2, 2):
        alone = simulate_compressed(system, latents[i, j], velocities[i, j], 0.01, 10, PUSH, method)
        np.testing.assert_allclose(together.latent[:, i, j], alone.latent, atol=1e-12)
        np.testing.assert_allclose(together.velocity[:, i, j], alone.velocity, atol=1e-10)


def test_divergence_is_told(undamped, method):
    with pytest.raises(DivergenceError, match=r'at \S+ s.* step\w* of 2 s'):
        simulate_compressed(undamped, LATENT, 1e3 * VELOCITY, 2.0, 1000, None, method)


def test_bad_arguments_are_refused(small_system):
    system = small_system(3)
    simulate = inspect.unwrap(simulate_compressed)  # without the tests' own check of shapes
    with pytest.raises(ValueError, match="unknown method 'euler': choose one of"):
        simulate_compressed(system, LATENT, VELOCITY, 0.01, 1, None, 'euler')
    for step in (0.0, -0.1, np.nan, np.inf):
        with pytest.raises(ValueError, match='step: expected a time > 0 s'):
            simulate_compressed(system, LATENT, VELOCITY, step, 1)
    for steps in (-1, 2.5, 5.0, '5'):
        with pytest.raises(ValueError, match='steps: expected a whole number ≥ 0'):
            simulate(system, LATENT, VELOCITY, 0.01, steps)
    with pytest.raises(ValueError, match='force: expected u, or one for each of 5 steps'):
        simulate(system, LATENT, VELOCITY, 0.01, 5, np.zeros((4, 2)))
    for latent, velocity in ((LATENT[:2], VELOCITY[:2]), (LATENT, VELOCITY[:2])):
        with pytest.raises(ValueError, match='state: expected 3 latents and as many velocities'):
            simulate(system, latent, velocity, 0.01, 1)
    nothing = np.full(3, np.nan)
    for state in ((nothing, VELOCITY), (LATENT, nothing)):
        with pytest.raises(ValueError, match='expected finite numbers'):
            simulate(system, *state, 0.01, 1)
    with pytest.raises(ValueError, match='expected finite numbers'):
        simulate(system, LATENT, VELOCITY, 0.01, 1, np.array([np.inf, 0.0]))


def test_lists_will_do(small_system):
    system = small_system(3)
    unchecked = inspect.unwrap(simulate_compressed)
    given = unchecked(system, LATENT.tolist(), VELOCITY.tolist(), 0.01, 3, PUSH.tolist())
    expected = simulate_compressed(system, LATENT, VELOCITY, 0.01, 3, PUSH)
    np.testing.assert_array_equal(given.latent, expected.latent)


def test_implicit_steps_of_the_shipped_decoder_are_solved_to_rounding(shipped_motion):
    """Its convective force is no small part of the equation."""
    system, start = shipped_motion
    step, zero = 0.02, np.zeros(2)
    run = simulate_compressed(system, *start, step, 50, None, 'implicit_midpoint')
    for k in range(50):
        middle = (run.latent[k + 1] - run.latent[k]) / step
        half_way = 0.5 * (run.latent[k] + run.latent[k + 1])
        momenta = [system.momentum(run.latent[i], run.velocity[i]) for i in (k, k + 1)]
        rate = system.momentum_rate(half_way, middle, zero)
        np.testing.assert_allclose(momenta[1] - momenta[0], step * rate, atol=1e-11)
        mean = 0.5 * (momenta[0] + momenta[1])
        np.testing.assert_allclose(mean, system.momentum(half_way, middle), atol=1e-11)


def test_an_implicit_step_without_solution_is_told(shipped_motion):
    system, start = shipped_motion
    with pytest.raises(UnsolvedStepError, match='implicit step of 3 s was not solved'):
        simulate_compressed(system, *start, 3.0, 100, None, 'implicit_midpoint')
