import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dpc_ros.bag import Run, Target, analyse, draw, read_run, table
from dpc_ros.bag.convergence_table import row_times
from dpc_ros.network import NO_GRAVITY, Gravity, Mechanics

STEP = 5_000_000  # ns
START = 10**18  # ns
NUMBERS = st.floats(-10, 10)
LENGTHS = st.integers(1, 80)


def make_run(configuration, targets=(), velocity=None, latent=None, force=None, step=STEP):
    """A run with a state, a latent state and a force at each step."""
    configuration = np.asarray(configuration, dtype=float)
    stamps = START + step * np.arange(len(configuration))
    latent = np.zeros((0, 0)) if latent is None else np.asarray(latent, dtype=float)
    force = np.zeros((0, 2)) if force is None else np.asarray(force, dtype=float)
    return Run(
        path='run_0.mcap',
        namespace='',
        configuration_stamp=stamps,
        configuration=configuration,
        velocity=np.zeros_like(configuration) if velocity is None else velocity,
        latent_stamp=stamps[: len(latent)],
        latent=latent,
        latent_velocity=np.zeros_like(latent),
        force_stamp=stamps[: len(force)],
        force=force,
        external_force_stamp=np.zeros(0, dtype=np.int64),
        external_force=np.zeros((0, 2)),
        targets=tuple(targets),
        network_identifier='',
        autoencoder_identifier='',
        messages={'/configuration': len(stamps)},
    )


def at(stamp, configuration):
    return Target(stamp, np.asarray(configuration, dtype=float), None, '')


def latent_at(stamp, latent):
    return Target(stamp, None, np.asarray(latent, dtype=float), '')


def errors(frames=LENGTHS):
    return frames.flatmap(lambda k: arrays(float, (k, 4), elements=NUMBERS))


@settings(deadline=None)
@given(error=errors(), target=arrays(float, 4, elements=NUMBERS))
def test_nmse_is_one_at_the_start_and_zero_at_the_target(error, target):
    assume(np.abs(error[0]).max() > 1e-3)
    error[-1] = 0
    result = analyse(make_run(target + error, [at(0, target)]))
    assert result.time[0] == 0
    assert result.nmse[-1] == 0
    if len(error) > 1:
        assert result.nmse[0] == 1
    assert (result.nmse >= 0).all()


@settings(deadline=None)
@given(error=errors(), scale=st.floats(1e-3, 1e3))
def test_nmse_does_not_change_when_all_errors_are_scaled(error, scale):
    assume(np.abs(error[0]).max() > 1e-3)
    origin = np.zeros(4)
    one = analyse(make_run(error, [at(0, origin)]))
    other = analyse(make_run(scale * error, [at(0, origin)]))
    np.testing.assert_allclose(other.nmse, one.nmse, rtol=1e-9, atol=1e-15)
    assert other.final_nmse == pytest.approx(one.final_nmse, rel=1e-9, abs=1e-15)


@settings(deadline=None)
@given(rate=st.floats(1.5, 20), amplitude=st.floats(0.1, 10))
def test_settling_time_of_an_exponential_is_the_analytic_one(rate, amplitude):
    time = np.arange(801) * STEP / 1e9
    decay = np.exp(-rate * time)
    result = analyse(make_run(amplitude * decay[:, None] * np.ones(4), [at(0, np.zeros(4))]))
    # nMSE = exp(−2 rate t), so that final + 0.05 (1 − final) is passed at −log(…)/(2 rate).
    np.testing.assert_allclose(result.nmse, decay**2, rtol=1e-9)
    threshold = result.final_nmse + 0.05 * (1 - result.final_nmse)
    analytic = -np.log(threshold) / (2 * rate)
    assert analytic <= result.settling_time + 1e-12
    assert result.settling_time < analytic + STEP / 1e9 + 1e-12
    assert not result.failed


def test_final_nmse_is_the_mean_over_the_last_quarter_second():
    errors = np.ones((201, 2))
    errors[-50:] = np.sqrt(0.25)  # 50 steps of 5 ms
    assert analyse(make_run(errors, [at(0, [0, 0])])).final_nmse == pytest.approx(0.25)
    errors[-51:] = np.sqrt(np.linspace(0.1, 0.2, 51))[:, None]
    expected = np.linspace(0.1, 0.2, 51)[1:].mean()
    assert analyse(make_run(errors, [at(0, [0, 0])])).final_nmse == pytest.approx(expected)


def test_a_run_that_goes_away_fails_and_never_settles():
    away = np.linspace(1, 3, 200)[:, None] * np.ones(2)
    result = analyse(make_run(away, [at(0, [0, 0])]))
    assert result.failed
    assert np.isnan(result.settling_time)
    assert 'FAILED' in table(result)
    assert 'never' in table(result)


@pytest.mark.parametrize('value', [np.nan, np.inf, 1e300])
def test_a_run_that_explodes_fails(value):
    states = np.ones((100, 2))
    states[50:] = value
    result = analyse(make_run(states, [at(0, [0, 0])]))
    assert result.failed
    assert np.isnan(result.settling_time)
    assert table(result)


def test_a_body_that_begins_at_its_target_has_no_error_until_it_leaves():
    states = np.zeros((10, 2))
    result = analyse(make_run(states, [at(0, [0, 0])]))
    assert (result.nmse == 0).all()
    assert result.settling_time == result.final_nmse == 0
    states[-1] = 1
    assert analyse(make_run(states, [at(0, [0, 0])])).failed


def test_without_a_target_there_is_no_error():
    result = analyse(make_run(np.ones((10, 2)), [at(START + 10**9, [0, 0])]))
    assert np.isnan(result.nmse).all()
    assert np.isnan([result.final_nmse, result.settling_time, result.target_time]).all()
    assert result.target is None
    assert not result.failed
    assert 'none in force' in table(result)


def test_each_target_has_its_own_beginning():
    states = np.linspace(1, 2, 400)[:, None] * np.ones(2)
    second = START + 200 * STEP
    result = analyse(make_run(states, [at(START + 100 * STEP, [9, 9]), at(second - 1, [3, 3])]))
    assert np.isnan(result.nmse[:100]).all()
    assert result.nmse[100] == result.nmse[200] == 1
    assert (result.nmse[101:200] < 1).all()
    assert (result.nmse[201:] < 1).all()
    assert result.target_time == 1.0
    assert result.target.configuration.tolist() == [3, 3]
    assert result.settling_time > result.target_time


def test_the_same_target_again_is_no_new_one():
    states = np.linspace(1, 2, 400)[:, None] * np.ones(2)
    once = analyse(make_run(states, [at(0, [3, 3])]))
    often = analyse(make_run(states, [at(START + k * 10**8, [3, 3]) for k in range(20)]))
    assert np.array_equal(once.nmse, often.nmse)
    assert often.target_time == 0


def test_of_two_targets_of_one_stamp_the_last_received_wins():
    result = analyse(make_run(np.ones((10, 2)), [at(0, [5, 5]), at(0, [3, 3])]))
    assert result.target.configuration.tolist() == [3, 3]


def test_a_final_window_does_not_reach_behind_the_last_target():
    states = np.ones((200, 2))
    states[-10:] = 2
    late = START + 180 * STEP
    result = analyse(make_run(states, [at(0, [1, 1]), at(late, [3, 3])]))
    assert result.final_nmse == pytest.approx((10 * 1 + 10 * 0.25) / 20)


@pytest.mark.parametrize('wrong', [[1.0], [], [np.nan, 0.0], [np.inf, 0.0]])
def test_targets_that_no_controller_takes_are_ignored_and_counted(wrong):
    states = np.linspace(1, 2, 10)[:, None] * np.ones(2)
    result = analyse(make_run(states, [at(0, [3, 3]), at(START + 1, wrong)]))
    assert np.array_equal(result.nmse, analyse(make_run(states, [at(0, [3, 3])])).nmse)
    assert result.ignored_targets == 1
    assert '1 unusable ignored' in table(result)


@settings(deadline=None)
@given(matrix=arrays(float, (4, 2), elements=NUMBERS), latents=errors().map(lambda e: e[:, :2]))
def test_latent_error_is_the_distance_to_the_encoded_target(matrix, latents, linear_autoencoder):
    autoencoder = linear_autoencoder(matrix + 20 * np.eye(4)[:, :2])
    states = autoencoder.decode(latents)
    target = states[-1]
    run = make_run(states, [at(0, target)], latent=latents)
    result = analyse(run, autoencoder=autoencoder)
    expected = np.linalg.norm(latents - autoencoder.encode(target), axis=1)
    np.testing.assert_allclose(result.latent_error, expected, atol=1e-12)
    assert result.latent_error[-1] == pytest.approx(0, abs=1e-9)
    # A latent target is the same one decoded.
    decoded = analyse(replace(run, targets=(latent_at(0, latents[-1]),)), autoencoder=autoencoder)
    np.testing.assert_allclose(decoded.latent_error, result.latent_error, atol=1e-9)
    assert decoded.latent_error[-1] == 0


def test_a_latent_target_is_measured_against_its_decoded_configuration(linear_autoencoder):
    autoencoder = linear_autoencoder([[1.0, 0.0], [0.0, 2.0], [1.0, 1.0], [0.5, 0.0]])
    states = np.linspace(1, 2, 50)[:, None] * np.arange(1.0, 5.0)
    latent = [3.0, -1.0]
    result = analyse(make_run(states, [latent_at(0, latent)]), autoencoder=autoencoder)
    decoded = analyse(make_run(states, [at(0, autoencoder.decode(np.array(latent)))]))
    assert np.array_equal(result.nmse, decoded.nmse)
    with pytest.raises(ValueError, match='expected an autoencoder to decode the latent target'):
        analyse(make_run(states, [latent_at(0, latent)]))


def test_force_figures():
    force = np.zeros((100, 2))
    force[10] = (3, -4)
    result = analyse(make_run(np.ones((100, 2)), force=force))
    assert np.array_equal(result.force, force)
    assert result.peak_force == 5
    assert result.rms_force == pytest.approx(0.5)
    silent = analyse(make_run(np.ones((100, 2))))
    assert np.isnan([silent.peak_force, silent.rms_force]).all()
    assert silent.force.shape == (0, 2)


@settings(deadline=None, max_examples=20)
@given(
    states=errors(st.integers(1, 10)),
    speeds=errors(st.just(10)),
    gravity=st.builds(Gravity, st.floats(0, 20), st.floats(-3, 3)),
)
def test_energies_are_those_of_the_mechanics(states, speeds, gravity, square_network):
    mechanics = Mechanics(square_network, gravity)
    run = make_run(states, velocity=speeds[: len(states)])
    run = replace(run, network_identifier=square_network.identifier)
    energy = analyse(run, mechanics).energy
    for k, (q, v) in enumerate(zip(states, speeds, strict=False)):
        assert energy.kinetic[k] == pytest.approx(mechanics.kinetic_energy(v))
        assert energy.potential[k] == pytest.approx(mechanics.potential(q))
        assert energy.total[k] == pytest.approx(mechanics.total_energy(q, v))
    assert analyse(run).energy is None


def test_models_of_another_body_are_refused(square_network, linear_autoencoder):
    mechanics = Mechanics(square_network, NO_GRAVITY)
    with pytest.raises(ValueError, match=r'6 coordinates, got square@.* with 4'):
        analyse(make_run(np.ones((3, 6))), mechanics)
    other = replace(make_run(np.ones((3, 4))), network_identifier='square@000000000000')
    with pytest.raises(ValueError, match='expected those of square@000000000000'):
        analyse(other, mechanics)
    autoencoder = linear_autoencoder(np.eye(6)[:, :2])
    with pytest.raises(ValueError, match=r'from 4 to 2 coordinates.* got 6 to 2'):
        analyse(make_run(np.ones((3, 4))), autoencoder=autoencoder)
    with pytest.raises(ValueError, match=r'from 6 to 3 coordinates.* got 6 to 2'):
        analyse(make_run(np.ones((3, 6)), latent=np.ones((3, 3))), autoencoder=autoencoder)


@given(end=st.floats(0, 5000))
def test_the_table_shows_only_times_of_the_log_and_its_end(end):
    times = row_times(end)
    assert times[-1] == end
    assert times == sorted(set(times))
    assert len(times) < 45
    assert 0 in times
    assert all((t in times) == (t <= end) for t in (0.25, 0.5, 1, 2, 3, 4, 5))


def test_the_table_has_what_the_log_has(square_network, linear_autoencoder):
    decay = np.exp(-np.arange(501) * STEP / 1e9)[:, None]
    run = replace(
        make_run(decay * np.ones(4), [at(0, np.zeros(4))], latent=decay * np.ones(2), force=decay),
        losses={'/configuration': 3},
        repeats={'/configuration': 2},
        setbacks={'/configuration': 1},
        network_identifier=square_network.identifier,
    )
    run = replace(run, force=np.repeat(decay, 2, axis=1))
    autoencoder = linear_autoencoder(np.eye(4)[:, :2])
    result = analyse(run, Mechanics(square_network), autoencoder)
    lines = table(result).splitlines()
    assert square_network.identifier in lines[0]
    header = next(k for k, line in enumerate(lines) if 't [s]' in line)
    rows = [line.split() for line in lines[header + 1 : lines.index('', header)]]
    assert [row[0] for row in rows] == ['0.00', '0.25', '0.50', '1.00', '2.00', '2.50']
    for row in rows:
        k = round(float(row[0]) * 1e9 / STEP)
        shown = [float(cell) for cell in row[1:]]
        meant = [
            result.nmse[k],
            result.latent_error[k],
            result.force_norm[k],
            result.energy.kinetic[k],
            result.energy.potential[k],
        ]
        np.testing.assert_allclose(shown, meant, rtol=1e-3)
    assert '/configuration       501 messages  2 repeated, 3 LOST, 1 with a stamp SET BACK' in lines
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize('full', [True, False])
def test_the_figure_is_a_picture_and_leaves_the_global_state_alone(
    full, tmp_path, square_network, linear_autoencoder
):
    decay = np.exp(-np.arange(501) * STEP / 1e9)[:, None]
    rest = decay * np.ones(4)
    had_pyplot = 'matplotlib.pyplot' in sys.modules
    if full:
        run = make_run(rest, [at(0, np.zeros(4))], latent=rest[:, :2], force=rest[:, :2])
        run = replace(run, targets=(*run.targets, at(START + 100 * STEP, np.ones(4))))
        models = Mechanics(square_network), linear_autoencoder(np.eye(4)[:, :2])
        draw(analyse(run, *models), tmp_path / 'run.png')
    else:
        draw(analyse(make_run(rest[:1])), tmp_path / 'run.png')
    picture = (tmp_path / 'run.png').read_bytes()
    assert picture.startswith(b'\x89PNG')
    assert len(picture) > 10_000
    assert ('matplotlib.pyplot' in sys.modules) == had_pyplot


def test_from_the_bag_to_the_table(log_type, record, square_network):
    decay = np.exp(-3 * np.arange(201) * STEP / 1e9)
    rest = square_network.rest_configuration
    log = log_type(
        configuration=[
            (START + k * STEP, rest + d, -3 * d * np.ones(4)) for k, d in enumerate(decay)
        ],
        force=[(START + k * STEP, (d, 0)) for k, d in enumerate(decay)],
        targets=[(0, rest, False)],
        network=square_network.identifier,
    )
    result = analyse(read_run(record(log)), Mechanics(square_network))
    np.testing.assert_allclose(result.nmse, decay**2, rtol=1e-6)
    assert result.peak_force == 1
    assert not result.failed
    assert 'final nMSE' in table(result)


def test_nothing_of_ros_is_needed():
    unwanted = ('rclpy', 'sensor_msgs', 'geometry_msgs', 'rosbag2_py', 'matplotlib')
    code = f'import sys, dpc_ros.bag; print([m for m in {unwanted} if m in sys.modules])'
    run = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == '[]'
