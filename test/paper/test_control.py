"""The control experiment runs what its files say and counts what came of it."""

import shutil
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from dpc_ros.control import Imperfections, load_target
from dpc_ros.network import load_network
from dpc_ros.paper import control, control_rows, control_tuning, regulation
from dpc_ros.paper.models import Workshop
from dpc_ros.paper.regulation import LIMIT
from dpc_ros.paper.tables import with_tables
from dpc_ros.resources import share_directory
from dpc_ros.results import read_results, write_results

RESULTS = share_directory() / 'docs' / 'results'


def outcome(*nmse):
    """Return a run of 5 s whose error takes these values over equal parts of it."""
    return regulation.Outcome(np.repeat(nmse, 1001 // len(nmse) + 1)[:1001].astype(float))


@pytest.fixture(scope='module')
def tasks():
    return regulation.load_tasks('paper_targets')


def test_targets_are_drawn_as_the_paper_says(tasks, paper_2):
    assert [task.run for task in tasks] == list(range(1, 51))
    assert {task.mass for task in tasks} == {122, 162, 192}
    rows = (share_directory() / 'config/control/paper_targets.csv').read_text().splitlines()[1:]
    for task, row in list(zip(tasks, rows, strict=True))[::10]:
        specification = row.split(',')[2]
        simulation, step = specification.removeprefix('simulation:').split('@')
        assert 1 <= int(simulation) <= 7
        assert 50 <= int(step) <= 400
        expected = load_target(specification, paper_2).configuration
        np.testing.assert_array_equal(task.target, expected)


def test_no_target_is_one_that_gains_are_chosen_on():
    for name in ('paper_targets', 'reachable_targets'):
        tuning = f'tuning_{name.removeprefix("paper_")}'
        files = [share_directory() / f'config/control/{each}.csv' for each in (name, tuning)]
        reported, chosen = (
            {line.split(',', 1)[1] for line in path.read_text().splitlines()} for path in files
        )
        assert len(reported & chosen) == 1  # the header


def test_reachable_targets_are_held(mechanics):
    network = load_network('paper_2')
    for task in regulation.load_tasks('tuning_reachable_targets', 3):
        bound = regulation.bound(task, starts=2)
        assert bound < 1e-3
        assert np.abs(task.target - network.rest_configuration).max() > 1e-3


def test_a_run_reaches_what_is_possible(tasks):
    task = tasks[7]
    bound = regulation.bound(task, starts=2)
    found = regulation.regulate('lqr', 'paper_2_extended_m5', LIMIT, 5.0, task)
    assert found.nmse[0] == 1.0
    assert found.final < 1.2 * bound
    assert found.peak_force <= 20.0 * (1 + 1e-12)
    noisy = regulation.regulate(
        'lqr', 'paper_2_extended_m5', LIMIT, 0.1, task, imperfections=Imperfections(noise=0.1)
    )
    assert np.abs(noisy.nmse[:21] - found.nmse[:21]).max() > 0


def test_a_body_that_diverges_fails_and_stays_a_number(tasks):
    wild = replace(LIMIT, proportional_gain=1e6, derivative_gain=0.0, largest_force=1e6)
    found = regulation.regulate('transpose', 'paper_2_extended_m5', wild, 1.0, tasks[0])
    assert found.failed
    assert found.reason
    assert not np.isnan(found.nmse).any()
    assert not np.isnan([found.peak_force, found.rms_force]).any()


def test_the_time_of_a_run_does_not_depend_on_its_step(tasks):
    coarse, fine = (
        regulation.regulate('lqr', 'paper_2_extended_m5', LIMIT, 1.0, tasks[7], step=step)
        for step in (0.005, 0.001)
    )
    assert len(fine.nmse) == 1001
    assert fine.at(0.8) == pytest.approx(coarse.at(0.8), rel=0.05)
    assert fine.reason == coarse.reason == ''


def test_what_is_counted_of_a_run():
    falling = outcome(1.0, 0.5, 0.1, 0.1)
    assert falling.final == pytest.approx(0.1)
    assert not falling.failed
    assert falling.settling_time == pytest.approx(2.5, abs=0.02)
    assert falling.at(2.0) == 0.5
    assert outcome(1.0, 2.0).failed
    assert outcome(1.0, np.inf).failed
    assert outcome(0.3).settling_time == 0.0
    assert outcome(1.0, np.inf).settling_time == np.inf


def test_a_summary_is_beside_the_bound_of_each_run():
    found = [outcome(1.0, 0.2), outcome(1.0, 0.3), outcome(1.0, 3.0)]
    row = control_rows.summary(found, [0.1, 0.3, 0.5])
    assert (row['runs'], row['failed']) == (3, 1)
    assert row['final_over_bound_median'] == pytest.approx(2.0)
    assert row['final_nmse_median'] == pytest.approx(0.3)
    assert row['final_nmse_max'] == pytest.approx(3.0)


def test_the_best_gains_are_those_of_the_smallest_error():
    rows = [
        {
            'law': 'paper',
            'checkpoint': 'a@1',
            'proportional_gain': alpha,
            'derivative_gain': 1.0,
            'final_nmse_median': error,
        }
        for alpha, error in ((1.0, 0.5), (2.0, 0.1), (3.0, np.inf))
    ]
    (settings,) = control_tuning.best_gains(rows).values()
    assert settings.proportional_gain == 2.0
    assert settings.largest_force == 20.0


def test_the_best_regulator_is_the_quickest_that_bears_the_hardest_loop():
    rows = [
        {
            'law': 'lqr',
            'checkpoint': 'a@1',
            'force_weight': weight,
            'velocity_weight': 0.0,
            'collocated_damping': 1.0,
            'final_over_bound_median': over,
            'failed': failed,
            'nmse_3s_median': error,
        }
        for weight, over, failed, error in (
            (1.0, 1.0, 0, 0.4),
            (2.0, 1.0, 0, 0.2),
            (3.0, 1.5, 0, 0.1),
            (4.0, 1.0, 1, 0.1),
        )
    ]
    assert control_tuning.best_regulator(rows).force_weight == 2.0


def test_the_defaults_are_the_gains_that_the_tuning_chose():
    rows = read_results(RESULTS / 'control_tuning.json')
    assert control_tuning.best_regulator(rows) == LIMIT


def test_tuning_reads_other_targets_only(monkeypatch):
    read = []

    def tasks_of(name):
        read.append(name)
        return [None]

    def each(description, function, tasks):
        return [1.0] if 'bounds' in description else [outcome(1.0)]

    monkeypatch.setattr(control_tuning, 'load_tasks', tasks_of)
    assert control_tuning.tune(each, [('paper', 'paper_2_flat_m2'), ('lqr', 'paper_2_pod_m5')])
    assert control_tuning.tune_regulator(each, 'paper_2_pod_m5')
    assert read == ['tuning_targets', 'tuning_targets', 'tuning_reachable_targets']


def test_results_hold_every_run_and_the_figure_follows(tmp_path):
    rows = {
        name: read_results(RESULTS / f'{name}.json')
        for name in ('control', 'control_runs', 'control_time')
    }
    laws = [row for row in rows['control'] if row['experiment'] == 'paper_targets']
    assert len(rows['control_runs']) == 50 * len(laws)
    for law in laws:
        runs = [
            row
            for row in rows['control_runs']
            if all(
                row.get(key) == law.get(key) for key in ('law', 'checkpoint', 'equilibrium_starts')
            )
        ]
        assert sum(run['failed'] for run in runs) == law['failed']
    control.draw_time(rows['control_time'], tmp_path / 'control.png')
    assert (tmp_path / 'control.png').read_bytes().startswith(b'\x89PNG')


@contextmanager
def each_task_here(progress):
    yield lambda description, function, tasks: [*map(function, tasks)]


def test_a_law_of_another_package_joins_the_tables(spring, tmp_path, monkeypatch):
    results = tmp_path / 'results'
    results.mkdir()
    for name in ('control', 'control_runs', 'control_time'):
        shutil.copy(RESULTS / f'{name}.json', results)
    workshop = Workshop(
        tmp_path, tmp_path, results, False, law=spring, law_options='{stiffness: 5.0}'
    )
    tasks = regulation.load_tasks('paper_targets', 2)
    files = control.measure_law(workshop, tasks)
    for name, rows in files.items():
        write_results(results / f'{name}.json', rows)
    page = '<!-- table laws from control -->\n<!-- end -->'
    *_, last = (line for line in with_tables(page, results).splitlines() if '|' in line)
    assert last.startswith(f'| {spring} | extended, m5 |')
    mine = [row for row in files['control_runs'] if row['law'] == spring]
    recorded = {row['run']: row['static_bound'] for row in files['control_runs']}
    assert [row['static_bound'] for row in mine] == [recorded[task.run] for task in tasks]
    control.draw_time(files['control_time'], tmp_path / 'control.png')
    monkeypatch.setattr(control, 'each_task', each_task_here)
    again = control.measure_law(workshop, tasks)  # its rows take the place of those before
    assert {name: len(rows) for name, rows in again.items()} == {
        name: len(rows) for name, rows in files.items()
    }
    with pytest.raises(ValueError, match='expected one of another package'):
        control.measure_law(replace(workshop, law='lqr'), tasks)


def test_workers_end_with_the_experiment():
    with regulation.each_task(progress=False) as each:
        found = each('tasks', partial(pow, 2), [1, 2, 3])
    assert found == [2, 4, 8]
