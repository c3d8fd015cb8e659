"""What is said of a compressed simulation beside the full one is what was simulated."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.network import Integrator, simulate
from dpc_ros.reduction import CompressedSystem, DivergenceError
from dpc_ros.reduction.comparison import compare
from dpc_ros.reduction.figure import animate, draw_energies, draw_errors, draw_frames
from dpc_ros.reduction.report import course, summary, table

STEP = 0.005


@pytest.fixture(scope='module')
def trajectory(small_mechanics):
    rest = small_mechanics.network.rest_configuration
    return simulate(Integrator(small_mechanics, STEP), rest, np.zeros_like(rest), 200)


@pytest.fixture(scope='module')
def comparison(small_system, trajectory):
    return compare(small_system(3), trajectory, 0.02)


def test_nothing_is_lost_without_compression(full_rank_system, trajectory):
    comparison = compare(full_rank_system('isotropic'), trajectory, STEP)
    assert comparison.relative_error < 1e-10
    assert comparison.relative_error_about_rest < 1e-8
    assert comparison.relative_energy_error < 1e-8
    assert comparison.energy_increase < 1e-6
    for motion in (comparison.pointwise, comparison.compressed):
        np.testing.assert_allclose(motion.configuration, trajectory.configuration, atol=1e-9)
        np.testing.assert_allclose(motion.velocity, trajectory.velocity, atol=1e-7)


def test_every_frame_is_of_the_motion(comparison, trajectory, small_system):
    system = small_system(3)
    full = comparison.full
    np.testing.assert_array_equal(full.configuration, trajectory.configuration[::4])
    np.testing.assert_array_equal(full.velocity, trajectory.velocity[::4])
    np.testing.assert_allclose(comparison.time, trajectory.time[::4])
    autoencoder = system.autoencoder
    expected = autoencoder.decode(autoencoder.encode(full.configuration))
    np.testing.assert_allclose(comparison.pointwise.configuration, expected, atol=1e-12)
    for motion in (full, comparison.pointwise, comparison.compressed):
        states = zip(motion.configuration, motion.velocity, strict=True)
        energy = [system.mechanics.total_energy(*state) for state in states]
        np.testing.assert_allclose(motion.total, energy)


def test_both_begin_at_the_same_reconstruction(comparison):
    first, simulated = comparison.pointwise, comparison.compressed
    np.testing.assert_allclose(first.configuration[0], simulated.configuration[0], atol=1e-12)
    np.testing.assert_allclose(first.velocity[0], simulated.velocity[0], atol=1e-12)


def test_errors_are_those_between_the_motions(comparison, small_network):
    full, compressed = comparison.full, comparison.compressed
    difference = compressed.configuration - full.configuration
    assert comparison.configuration_error.mean() == pytest.approx(np.mean(difference**2))
    ratio = comparison.relative_error_about_rest / comparison.relative_error
    moved = full.configuration - small_network.rest_configuration
    assert ratio == pytest.approx(np.linalg.norm(full.configuration) / np.linalg.norm(moved))
    energy = np.sqrt(np.mean((compressed.total - full.total) ** 2))
    assert comparison.relative_energy_error * np.ptp(full.total) == pytest.approx(energy)
    assert comparison.energy_increase <= 1e-9


def test_every_rise_of_the_energy_is_seen_however_slow(comparison):
    total = comparison.compressed.total
    for rise in (np.where(np.arange(len(total)) < 10, 0.0, 7.0), np.linspace(0, 7, len(total))):
        falling = -1e-9 * np.arange(len(total))
        motion = replace(
            comparison.compressed, kinetic=falling + rise, potential=np.zeros_like(rise)
        )
        risen = replace(comparison, compressed=motion)
        expected = 7.0 / np.ptp(comparison.full.total)
        assert risen.energy_increase == pytest.approx(expected, rel=1e-6)


def test_report_holds_what_was_compared(comparison):
    rows = course(comparison)
    assert [row['time_s'] for row in rows] == comparison.time.tolist()
    assert [row['configuration_mse_m2'] for row in rows] == comparison.configuration_error.tolist()
    assert summary(comparison)['relative_error'] == comparison.relative_error
    text = table(comparison)
    assert f'{comparison.relative_error:.3%}' in text
    assert len(text.splitlines()) >= 12


def test_pictures_are_drawn(comparison, tmp_path):
    named = {'one': comparison, 'other': comparison}
    draw_errors(comparison, tmp_path / 'errors.png')
    draw_energies(named, tmp_path / 'energies.png')
    draw_frames(named, (0.0, 0.5), tmp_path / 'frames.png')
    for path in tmp_path.glob('*.png'):
        assert path.read_bytes().startswith(b'\x89PNG')
    animate(named, tmp_path / 'motion.gif', every=10)
    with Image.open(tmp_path / 'motion.gif') as gif:
        assert gif.n_frames == 6
        assert gif.info['duration'] == 200  # ms, as long as the motion takes
    animate(named, tmp_path / 'motion.gif')
    with Image.open(tmp_path / 'motion.gif') as gif:
        assert gif.info['duration'] == 40
    assert len(list(tmp_path.iterdir())) == 4


@pytest.mark.parametrize('step', [0.001, 0.0075, 0.0, -0.02, np.nan, np.inf])
def test_steps_have_to_fit_the_motion(small_system, trajectory, step):
    with pytest.raises(ValueError, match=r'expected a multiple of 0\.005 s'):
        compare(small_system(3), trajectory, step)


def test_the_motion_has_to_be_longer_than_a_step(small_system, trajectory):
    with pytest.raises(ValueError, match='expected one shorter than the motion'):
        compare(small_system(3), trajectory, 10.0)


def test_a_method_is_passed_on(small_system, trajectory, comparison):
    other = compare(small_system(3), trajectory, 0.02, 'implicit_midpoint')
    assert np.abs(other.compressed.configuration - comparison.compressed.configuration).max() > 0
    with pytest.raises(ValueError, match='unknown method'):
        compare(small_system(3), trajectory, 0.02, 'euler')


def test_divergence_is_told(mechanics, paper_trajectories):
    """Of POD on system 2 at steps that are far too long for it: finite, but far off."""
    system = CompressedSystem(mechanics, load_checkpoint('paper_2_pod_m5').autoencoder(), 162)
    trajectory = paper_trajectories(mechanics.network)[0][1]
    with pytest.raises(DivergenceError, match=r'diverged with steps of 0\.5 s'):
        compare(system, trajectory, 0.5)
