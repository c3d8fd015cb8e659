"""Every format holds the numbers that were logged, to the last digit."""

import csv
import sys

import numpy as np
import pyarrow.parquet
import pytest

from dpc_ros import cli
from dpc_ros.bag import BagWriter
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


def test_whole_numbers_keep_all_digits_where_some_are_missing(messages, tmp_path):
    types = messages.store.types
    longest = types['builtin_interfaces/msg/Duration'](sec=2**31 - 1, nanosec=999_999_999)
    largest = longest.sec * 10**9 + longest.nanosec  # no double has it
    nothing = np.zeros(0)
    point = types['trajectory_msgs/msg/JointTrajectoryPoint'](*[nothing] * 4, longest)
    header = types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](0, 0), '')
    layout = types['std_msgs/msg/MultiArrayLayout']([], 0)
    rows = [
        ('/path', 'trajectory_msgs/msg/JointTrajectory', [(header, [], p) for p in ([], [point])]),
        (
            '/seen',
            'std_msgs/msg/UInt64MultiArray',
            [(layout, np.array(a, np.uint64)) for a in ([7], [2**64 - 1, 8])],
        ),
    ]
    with BagWriter(tmp_path / 'bag') as bag:
        for topic, name, contents in rows:
            bag.add_topic(messages.topic(topic, name))
            for time, content in enumerate(contents):
                cdr = messages.store.serialize_cdr(types[name](*content), name)
                bag.write(topic, bytes(cdr), time, time)
    for suffix in ('csv', 'npz', 'parquet'):
        export(tmp_path / 'bag', tmp_path / f'out.{suffix}')
    name = 'points[0].time_from_start'
    for read, missing, number in ((read_csv, '', str), (read_parquet, None, int)):
        target = tmp_path / f'out.{read.__name__.removeprefix("read_")}'
        assert read(target, 'path')[name] == [missing, number(largest)]
        table = read(target, 'seen')
        assert table['data[0]'] == [number(7), number(2**64 - 1)]
        assert table['data[1]'] == [missing, number(8)]
    with np.load(tmp_path / 'out.npz') as arrays:
        assert arrays[f'path/{name}'].tolist() == [0, largest]
        assert arrays[f'path/{name}.missing'].tolist() == [True, False]
        assert arrays['seen/data'].tolist() == [[7, 0], [2**64 - 1, 8]]
        assert arrays['seen/data.missing'].tolist() == [[False, True], [False, False]]
        assert 'path/log_time_ns.missing' not in arrays


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
