"""Every format holds the numbers that were logged, to the last digit."""

import csv
import sys

import numpy as np
import pyarrow.parquet
import pytest

from dpc_ros import cli
from dpc_ros.bag.export import export
from dpc_ros.network import save_network


@pytest.fixture(scope='module')
def bag(record, small_log):
    return record(small_log)


def read_csv(target, topic):
    with (target / f'{topic}.csv').open(newline='') as stream:
        rows = list(csv.DictReader(stream))
    return {name: [row[name] for row in rows] for name in rows[0]}


def read_parquet(target, topic):
    return pyarrow.parquet.read_table(target / f'{topic}.parquet').to_pydict()


@pytest.mark.parametrize(('suffix', 'read'), [('csv', read_csv), ('parquet', read_parquet)])
def test_tables_hold_what_was_logged(suffix, read, bag, small_log, tmp_path):
    target = tmp_path / f'out.{suffix}'
    cli.main(['bag', 'export', str(bag), str(target)])
    states = read(target, 'configuration')
    stamps, positions, velocities = zip(*small_log.configuration, strict=True)
    assert [int(stamp) for stamp in states['stamp_ns']] == list(stamps)
    for i in range(4):
        for name, values in (('position', positions), ('velocity', velocities)):
            column = [float(value) for value in states[f'{name}[{i}]']]
            assert column == [float(row[i]) for row in values]
    assert set(states['header.frame_id']) == {small_log.network}
    latents = read(target, 'latent_state')
    assert [float(x) for x in latents['position.xi_0']] == [r[1][0] for r in small_log.latent]
    assert 'name' not in latents
    forces = read(target, 'control_force')
    assert [float(x) for x in forces['wrench.force.y']] == [row[1][1] for row in small_log.force]
    assert [int(t) for t in forces['log_time_ns']] == sorted(map(int, forces['log_time_ns']))


def test_npz_holds_an_array_for_each_field(bag, small_log, tmp_path):
    export(bag, tmp_path / 'out.npz')
    with np.load(tmp_path / 'out.npz') as arrays:
        positions = [row[1] for row in small_log.configuration]
        assert np.array_equal(arrays['configuration/position'], positions)
        assert arrays['latent_state/position.names'].tolist() == ['xi_0', 'xi_1']
        assert arrays['control_force/wrench.force.x'].shape == (len(small_log.force),)


def test_coordinates_are_named_by_the_network(small_network, log_type, record, tmp_path):
    rest = small_network.rest_configuration
    log = log_type(configuration=[(1, rest, rest)], network=small_network.identifier, force=[])
    save_network(small_network, tmp_path / 'grid.json')
    export(record(log), tmp_path / 'out.csv', tmp_path / 'grid.json')
    states = read_csv(tmp_path / 'out.csv', 'configuration')
    for name, value in zip(small_network.coordinate_names, rest, strict=True):
        assert float(states[f'position.{name}'][0]) == value


def test_targets_of_two_sizes_stand_in_one_table(log_type, record, tmp_path):
    log = log_type(
        configuration=[(1, [0.0, 0.0], [0.0, 0.0])],
        targets=[(1, [1.0, 2.0], False), (2, [3.0], True)],
        namespace='/lab/body',
    )
    export(record(log), tmp_path / 'out.npz')
    with np.load(tmp_path / 'out.npz') as arrays:
        targets = arrays['lab/body/target/position']
    np.testing.assert_array_equal(targets, [[1.0, 2.0], [3.0, np.nan]])


def test_what_can_not_be_exported_leaves_nothing(bag, tmp_path, monkeypatch):
    (tmp_path / 'there.npz').touch()
    with pytest.raises(FileExistsError, match='expected a new place'):
        export(bag, tmp_path / 'there.npz')
    with pytest.raises(ValueError, match=r'ends in one of \.csv, \.npz, \.parquet'):
        export(bag, tmp_path / 'out.xlsx')
    with pytest.raises(ValueError, match='nothing is there'):
        export(tmp_path / 'nothing', tmp_path / 'out.csv')
    monkeypatch.setitem(sys.modules, 'pyarrow', None)
    with pytest.raises(ValueError, match=r"pip install 'dpc_ros\[parquet\]'"):
        export(bag, tmp_path / 'out.parquet')
    assert [path.name for path in tmp_path.iterdir()] == ['there.npz']
