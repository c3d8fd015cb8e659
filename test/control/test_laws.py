"""Control laws are their formulas, within the bound on the force."""

import pickle
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import solve_continuous_lyapunov

from dpc_ros.control import (
    LAWS,
    ConstantForce,
    EquilibriumError,
    LawSettings,
    PaperLaw,
    QuadraticRegulator,
    ReducedEquilibriumLaw,
    Target,
    TargetError,
    TransposeLaw,
    feed_forward,
    make_law,
    reduced_equilibrium,
)
from dpc_ros.control.laws import damped_left_inverse
from dpc_ros.reduction import simulate_compressed

ALPHA, BETA = 0.7, 1.3
SETTINGS = LawSettings(proportional_gain=ALPHA, derivative_gain=BETA)


def vectors(size, bound=2.0):
    return arrays(float, size, elements=st.floats(-bound, bound))


@pytest.fixture(scope='module')
def target(small_configurations):
    return Target(configuration=small_configurations[len(small_configurations) // 2])


@pytest.fixture(scope='module', params=LAWS)
def law(request, small_system, target):
    law = make_law(request.param, small_system(3), replace(SETTINGS, largest_force=0.5))
    law.regulate(target)
    return law


@given(st.integers(0, 2**32 - 1), st.integers(2, 6))
def test_damped_left_inverse_tends_to_the_left_inverse(seed, rows):
    field = np.random.default_rng(seed).normal(size=(rows, 2)) + 3 * np.eye(rows, 2)
    exact = damped_left_inverse(field, 0.0)
    np.testing.assert_allclose(exact @ field, np.eye(2), atol=1e-6)
    np.testing.assert_allclose(exact, np.linalg.pinv(field), rtol=1e-5, atol=1e-5)
    errors = [
        np.linalg.norm(damped_left_inverse(field, damping) - exact)
        for damping in (1e-1, 1e-2, 1e-3, 1e-4)
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-3 * np.linalg.norm(exact)


@given(vectors((3, 2)), st.floats(0.01, 1.0))
def test_damping_bounds_the_inverse_also_of_a_singular_field(field, damping):
    field[:, 1] = 0.5 * field[:, 0]
    field[0, 0] = 3.0
    largest = np.linalg.norm(field, 2)
    inverse = damped_left_inverse(field, damping)
    assert np.linalg.norm(inverse, 2) <= 1 / (2 * damping * largest) * (1 + 1e-6)


@given(vectors(2, 1.0))
def test_paper_law_holds_the_body_at_its_target_where_it_can(small_system, latent):
    system = small_system(2)
    law = PaperLaw(system, replace(SETTINGS, inverse_damping=0.0))
    law.regulate(Target(latent=latent))
    force = law.force(latent, np.zeros(2))
    gradient = system.potential_gradient(latent)
    np.testing.assert_allclose(system.input_field(latent) @ force, gradient, rtol=1e-6, atol=1e-6)


@given(vectors(3), vectors(3), vectors(3))
def test_paper_law_is_its_formula(small_system, goal, latent, velocity):
    system = small_system(3)
    law = PaperLaw(system, replace(SETTINGS, inverse_damping=0.1))
    law.regulate(Target(latent=goal))
    momentum = system.mass_matrix(latent) @ velocity
    wanted = system.potential_gradient(goal) + ALPHA * (goal - latent) - BETA * momentum
    expected = damped_left_inverse(system.input_field(goal), 0.1) @ wanted
    np.testing.assert_allclose(law.force(latent, velocity), expected, rtol=1e-9, atol=1e-9)


@pytest.fixture(scope='module')
def resting(small_system, target):
    """The reduced-equilibrium law with the feed-forward that it rests on."""
    law = ReducedEquilibriumLaw(small_system(3), SETTINGS)
    law.regulate(target)
    return law, feed_forward(law.system, target.configuration)


def test_reduced_equilibrium_law_rests_at_its_equilibrium(resting):
    law, solution = resting
    force = law.force(solution.latent, np.zeros(3))
    np.testing.assert_array_equal(force, solution.force)
    gradient = law.system.potential_gradient(solution.latent, force)
    np.testing.assert_allclose(gradient, 0, atol=1e-7)


@given(offset=vectors(3), velocity=vectors(3))
def test_reduced_equilibrium_law_is_its_formula(resting, offset, velocity):
    law, solution = resting
    field = law.system.input_field(solution.latent)
    expected = solution.force - field.T @ (ALPHA * offset + BETA * velocity)
    force = law.force(solution.latent + offset, velocity)
    np.testing.assert_allclose(force, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize('name', LAWS)
def test_a_configuration_and_its_latent_are_targets(small_system, target, name):
    system = small_system(3)
    autoencoder = system.autoencoder
    latent = autoencoder.encode(target.configuration)
    decoded = Target(configuration=autoencoder.decode(latent))
    first, second = (make_law(name, system, SETTINGS) for _ in range(2))
    first.regulate(Target(latent=latent))
    second.regulate(target if name in ('paper', 'transpose') else decoded)
    state = latent + 0.1, np.ones(3)
    np.testing.assert_allclose(first.force(*state), second.force(*state), rtol=1e-9, atol=1e-12)


@given(latent=vectors(3, 50.0), velocity=vectors(3, 50.0))
def test_the_bound_shortens_a_force_and_keeps_its_direction(law, latent, velocity):
    free, bounded = law.unbounded_force(latent, velocity), law.force(latent, velocity)
    length = np.linalg.norm(free)
    assert np.linalg.norm(bounded) == pytest.approx(min(length, law.settings.largest_force))
    np.testing.assert_allclose(bounded * length, free * np.linalg.norm(bounded), atol=1e-9)


def test_a_solution_of_another_process_is_as_good_as_an_own_one(law, target):
    state = np.ones(3), np.ones(3)
    before = law.force(*state)
    other = make_law(
        next(name for name, kind in LAWS.items() if kind is type(law)), law.system, law.settings
    )
    solution = other.solve(target)
    np.testing.assert_array_equal(other.force(*state), 0)  # solving alone changes nothing
    other.adopt(pickle.loads(pickle.dumps(solution)))
    np.testing.assert_array_equal(other.force(*state), before)


@pytest.mark.parametrize('name', LAWS)
def test_without_a_target_there_is_no_force(small_system, name):
    law = make_law(name, small_system(3), SETTINGS)
    np.testing.assert_array_equal(law.force(np.ones(3), np.ones(3)), 0)


@pytest.mark.parametrize('name', LAWS)
@pytest.mark.parametrize(
    ('bad', 'message'),
    [
        (Target(configuration=np.zeros(400)), 'configuration: expected 24 values, got 400'),
        (Target(latent=np.zeros(2)), 'latent: expected 3 values, got 2'),
    ],
    ids=['configuration', 'latent'],
)
def test_a_target_that_does_not_fit_leaves_the_old_one(small_system, target, name, bad, message):
    law = make_law(name, small_system(3), SETTINGS)
    law.regulate(target)
    before = law.force(np.ones(3), np.ones(3))
    with pytest.raises(TargetError, match=message):
        law.regulate(bad)
    np.testing.assert_array_equal(law.force(np.ones(3), np.ones(3)), before)


@pytest.mark.parametrize('value', [-1.0, np.nan])
@pytest.mark.parametrize('key', [each.name for each in fields(LawSettings) if each.type == 'float'])
def test_settings_have_to_be_numbers(value, key):
    with pytest.raises(ValueError, match=f'{key.replace("_", " ")}: expected a number'):
        LawSettings(**{key: value})


def test_only_the_bound_may_be_infinite():
    assert LawSettings(largest_force=np.inf).largest_force == np.inf
    with pytest.raises(ValueError, match='integral gain: expected a finite number'):
        LawSettings(integral_gain=np.inf)
    with pytest.raises(ValueError, match='force weight: expected a number > 0'):
        LawSettings(force_weight=0.0)
    with pytest.raises(ValueError, match='equilibrium starts: expected at least 2, got 1'):
        LawSettings(equilibrium_starts=1)


def test_an_unknown_law_names_the_known_ones(small_system):
    with pytest.raises(ValueError, match=r"'pid'.*lqr.*paper"):
        make_law('pid', small_system(3))


@given(latent=vectors(3), velocity=vectors(3))
def test_transpose_law_is_its_formula(small_system, target, latent, velocity):
    system = small_system(3)
    law = TransposeLaw(system, SETTINGS)
    law.regulate(target)
    goal = system.autoencoder.encode(target.configuration)
    field = system.input_field(goal)
    inverse = damped_left_inverse(field, SETTINGS.inverse_damping)
    expected = inverse @ system.potential_gradient(goal)
    expected = expected + field.T @ (ALPHA * (goal - latent) - BETA * velocity)
    np.testing.assert_allclose(law.force(latent, velocity), expected, rtol=1e-9, atol=1e-9)


def test_saturation_is_told(law):
    law.force(np.full(3, 50.0), np.zeros(3))
    assert law.saturated
    free = make_law('paper', law.system)
    free.regulate(Target(latent=np.zeros(3)))
    free.force(np.full(3, 50.0), np.zeros(3))
    assert not free.saturated


@pytest.fixture
def regulator(small_system, target):
    law = QuadraticRegulator(small_system(3), LawSettings())
    law.regulate(target)
    return law


def held(regulator):
    """Return the equilibrium of the full body under the regulator's feed-forward."""
    body = ConstantForce(regulator.system.mechanics, regulator.system.actuated_mass)
    return body.equilibrium(regulator.feed_forward, regulator._solution.goal)


def test_regulator_rests_at_the_bodys_own_equilibrium(regulator, target):
    """Of no other constant force nearby is the equilibrium nearer to the target."""
    system = regulator.system
    goal, force = held(regulator), regulator.feed_forward
    latent = system.autoencoder.encode(goal)
    np.testing.assert_allclose(regulator.force(latent, np.zeros(3)), force, atol=1e-7)
    slope = ConstantForce(system.mechanics, system.actuated_mass).slope(goal)
    assert np.abs(slope.T @ (goal - target.configuration)).max() < 1e-6


def test_gain_is_the_one_of_the_riccati_equation(regulator):
    system, settings = regulator.system, regulator.settings
    goal = held(regulator)
    latent = system.autoencoder.encode(goal)
    jacobian = system.autoencoder.decoder_jacobian(latent)
    stiffness = jacobian.T @ system.mechanics.potential_hessian(goal) @ jacobian
    a, b = regulator.linearised(latent, stiffness)
    gain = np.hstack([regulator._solution.latent_gain, regulator._solution.velocity_gain])
    gain[:, 3:] -= settings.collocated_damping * system.input_field(latent).T
    # The gain of the stationary solution: its costate P is the quadratic cost of the closed loop,
    # and no other gain nearby costs less.
    weight = 1e-9 * np.eye(6)
    spread = jacobian.T @ jacobian / len(jacobian)
    weight[:3, :3] += spread
    weight[3:, 3:] += settings.velocity_weight * spread

    def cost(k):
        closed = a - b @ k
        return solve_continuous_lyapunov(closed.T, -(weight + settings.force_weight * k.T @ k))

    best = cost(gain)
    np.testing.assert_allclose(gain, b.T @ best / settings.force_weight, rtol=1e-6, atol=1e-9)
    for change in np.random.default_rng(0).normal(scale=0.05, size=(10, *gain.shape)):
        worse = cost(gain + change * np.abs(gain).max())
        assert np.linalg.eigvalsh(worse - best).min() > -1e-9 * np.abs(best).max()


def test_linearisation_is_that_of_the_compressed_system(small_system, central_difference):
    """Where the decoder's equilibrium is the body's: about the reduced equilibrium."""
    system = small_system(3)
    law = QuadraticRegulator(system, LawSettings())
    force = np.array([0.4, -0.3])
    start = system.autoencoder.encode(system.mechanics.network.rest_configuration)
    latent = reduced_equilibrium(system, force, start)
    a, b = law.linearised(latent, system.potential_hessian(latent, force))

    def rate(state):
        acceleration = system.acceleration(state[:3], state[3:6], state[6:])
        return np.concatenate([state[3:6], acceleration])

    point = np.concatenate([latent, np.zeros(3), force])
    expected = central_difference(rate, point, 1e-5)
    np.testing.assert_allclose(np.hstack([a, b]), expected, rtol=1e-4, atol=1e-3)


def test_integral_waits_then_moves_with_the_error_and_starts_anew(small_system, target):
    settings = LawSettings(integral_gain=2.0, integral_delay=0.1)
    law = QuadraticRegulator(small_system(3), settings)
    law.regulate(target)
    latent = law._solution.target + 0.2
    step = 10_000_000  # ns
    forces = [law.force(latent, np.zeros(3), k * step) for k in range(40)]
    for waiting in forces[:10]:
        np.testing.assert_array_equal(waiting, forces[0])
    changes = np.diff(forces[12:], axis=0)
    np.testing.assert_allclose(changes, np.broadcast_to(changes[0], changes.shape), rtol=1e-6)
    assert np.linalg.norm(changes[0]) > 0
    # a gap of a second: nobody knows what happened meanwhile
    after_a_leap = [law.force(latent, np.zeros(3), (140 + k) * step) for k in range(40)]
    np.testing.assert_array_equal(after_a_leap, forces)
    law.restart()
    np.testing.assert_array_equal(law.force(latent, np.zeros(3), 0), forces[0])


def test_integral_rests_where_the_law_does(small_system, target):
    law = QuadraticRegulator(small_system(3), LawSettings(integral_gain=2.0, integral_delay=0.0))
    law.regulate(target)
    for k in range(20):
        force = law.force(law._solution.target, np.zeros(3), k * 10_000_000)
        np.testing.assert_array_equal(force, law.feed_forward)


def test_integral_does_not_wind_up_while_the_force_is_saturated(small_system, target):
    settings = LawSettings(integral_gain=2.0, integral_delay=0.0, largest_force=0.01)
    law = QuadraticRegulator(small_system(3), settings)
    law.regulate(target)
    for k in range(20):
        law.force(law._solution.target + 5.0, np.zeros(3), k * 10_000_000)
        assert law.saturated
    np.testing.assert_array_equal(law._constant, law.feed_forward)


def test_integral_unwinds_while_the_force_is_saturated(small_system, target):
    settings = LawSettings(integral_gain=2.0, integral_delay=0.0, largest_force=0.01)
    law = QuadraticRegulator(small_system(3), settings)
    law.regulate(target)
    away = law._solution.slope @ np.array([0.0, 0.3])
    for side in (1, -1):  # wound up on one side, the error asks for the other
        law.restart()
        law._constant = law._constant + side * np.array([0.0, 0.5])
        before = law._constant
        law.force(law._solution.target + side * away, np.zeros(3), 0)
        law.force(law._solution.target + side * away, np.zeros(3), 10_000_000)
        assert law.saturated
        assert np.linalg.norm(law._constant) < np.linalg.norm(before)


def lyapunov(system, goal, latent, velocity):
    """Return W = η − V_η(ξ̄) − (ξ − ξ̄)ᵀ∇V_η(ξ̄) + ½α|ξ̄ − ξ|²."""
    away = latent - goal
    energy = system.total_energy(latent, velocity) - system.potential(goal)
    return energy - away @ system.potential_gradient(goal) + 0.5 * ALPHA * away @ away


def exact_law(system, goal, latent, velocity):
    """Return the paper's force at m = 2 with Γ at ξ and its inverse not damped."""
    momentum = system.momentum(latent, velocity)
    wanted = system.potential_gradient(goal) + ALPHA * (goal - latent) - BETA * momentum
    return np.linalg.solve(system.input_field(latent), wanted)


def test_the_papers_lyapunov_function_falls_at_its_rate(small_system):
    """Ẇ = −ξ̇ᵀ(Δ + βM_η)ξ̇ along a latent run of the paper's law."""
    system = small_system(2)
    goal = np.array([0.3, -0.2])
    latent, velocity = np.array([-0.2, 0.3]), np.array([0.5, 0.4])
    step, values, rates = 1e-4, [], []
    for _ in range(1000):
        values.append(lyapunov(system, goal, latent, velocity))
        damping = system.damping_matrix(latent) + BETA * system.mass_matrix(latent)
        rates.append(-velocity @ damping @ velocity)
        force = exact_law(system, goal, latent, velocity)
        # To rounding at every state,
        power = system.power(latent, velocity, force)
        static = system.potential_gradient(goal) + ALPHA * (goal - latent)
        assert power - velocity @ static == pytest.approx(rates[-1], rel=1e-9, abs=1e-12)
        run = simulate_compressed(system, latent, velocity, step, 1, force)
        latent, velocity = run.latent[-1], run.velocity[-1]
    # and in sum along the run, whose forces are held over each step.
    fallen = values[-1] - values[0]
    expected = step * (np.sum(rates) - 0.5 * (rates[0] + rates[-1]))
    assert fallen == pytest.approx(expected, rel=1e-2)
    assert fallen < 0


def test_a_riccati_equation_without_solution_leaves_the_old_target(
    small_system, target, monkeypatch
):
    law = QuadraticRegulator(small_system(3), LawSettings())
    law.regulate(target)
    state = np.ones(3), np.ones(3)
    before = law.force(*state)

    def fails(*arguments):
        raise np.linalg.LinAlgError('no solution')

    monkeypatch.setattr('dpc_ros.control.regulator.solve_continuous_are', fails)
    with pytest.raises(EquilibriumError, match='no regulator about the equilibrium: no solution'):
        law.regulate(Target(latent=np.zeros(3)))
    np.testing.assert_array_equal(law.force(*state), before)


def test_a_law_of_this_package_takes_no_options(small_system):
    with pytest.raises(ValueError, match=r"'lqr' takes no options, got \['force_weight'\]"):
        make_law('lqr', small_system(3), LawSettings(options={'force_weight': 1.0}))
