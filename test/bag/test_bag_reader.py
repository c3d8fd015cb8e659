import os
import shutil
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpc_ros.bag import BagError, BagWriter, read_run

JOINT_STATE = 'sensor_msgs/msg/JointState'
STEP = 5_000_000  # ns


def test_a_run_comes_back_as_it_was_written(small_log, record):
    folder = record(small_log)
    for path in (folder, str(folder), folder / 'bag_0.mcap'):
        run = read_run(path)
        stamps, positions, velocities = zip(*small_log.configuration, strict=True)
        assert run.configuration_stamp.dtype == np.int64
        assert run.configuration_stamp.tolist() == list(stamps)
        assert np.array_equal(run.configuration, positions)
        assert np.array_equal(run.velocity, velocities)
        assert np.array_equal(run.latent, [row[1] for row in small_log.latent])
        assert np.array_equal(run.latent_velocity, [row[2] for row in small_log.latent])
        assert run.force_stamp.tolist() == list(stamps[:-1])
        assert np.array_equal(run.force, [row[1] for row in small_log.force])
        assert np.array_equal(run.external_force, [[0.5, 0.25]])
        (target,) = run.targets
        assert target.stamp_ns == 0
        assert target.latent is None
        assert target.configuration.tolist() == [1, 2, 3, 4]
        assert run.network_identifier == small_log.network
        assert run.autoencoder_identifier == small_log.checkpoint
        assert run.metadata == small_log.metadata
        assert run.messages == {
            '/configuration': 20,
            '/latent_state': 20,
            '/control_force': 19,
            '/external_force': 1,
            '/target': 1,
        }
        for counts in (run.repeats, run.losses, run.setbacks):
            assert set(counts.values()) == {0}


@settings(deadline=None, max_examples=25)
@given(stamps=st.lists(st.integers(0, 2**31 * 10**9 - 1), min_size=1, max_size=30))
def test_signals_are_in_the_order_of_stamps_with_the_first_of_each(stamps, log_type, record):
    # The simulator repeats a state in lockstep until it is answered.
    log = log_type(configuration=[(t, [k, 0.0], [0.0, 0.0]) for k, t in enumerate(stamps)])
    run = read_run(record(log))
    assert run.configuration_stamp.tolist() == sorted(set(stamps))
    assert run.configuration[:, 0].tolist() == [stamps.index(t) for t in sorted(set(stamps))]
    assert run.repeats == {'/configuration': len(stamps) - len(set(stamps))}
    assert run.setbacks == {'/configuration': sum(b < a for a, b in pairwise(stamps))}


@settings(deadline=None, max_examples=25)
@given(lost=st.sets(st.integers(1, 18)), restart=st.booleans())
def test_losses_are_the_gaps_of_the_sequence_numbers(lost, restart, log_type, record):
    numbers = [k for k in range(20) if k not in lost]
    numbers = [k + 1 for k in numbers]
    if restart:  # the publisher's process was started again: its numbers start anew
        numbers += [1, 2]
    rows = [(k, [0.0, 0.0], [0.0, 0.0]) for k in range(len(numbers))]
    run = read_run(record(log_type(configuration=rows, sequences={'configuration': numbers})))
    assert run.losses == {'/configuration': len(lost)}


def test_sequence_numbers_that_are_not_known_are_no_losses(log_type, record):
    rows = [(k, [0.0, 0.0], [0.0, 0.0]) for k in range(3)]
    log = log_type(configuration=rows, sequences={'configuration': [0, 0, 0]})
    assert read_run(record(log)).losses == {'/configuration': 0}


def test_targets_are_sorted_by_stamp_and_told_apart_by_their_names(log_type, record):
    log = log_type(
        configuration=[(1, [0.0, 0.0], [0.0, 0.0])],
        targets=[(9, [1.0, 2.0], False), (4, [3.0], True), (4, [5.0], True), (0, [], False)],
    )
    targets = read_run(record(log)).targets
    assert [target.stamp_ns for target in targets] == [0, 4, 4, 9]
    assert [target.latent is None for target in targets] == [True, False, False, True]
    assert [target.latent[0] for target in targets[1:3]] == [3.0, 5.0]


@pytest.mark.parametrize(
    ('names', 'is_latent'),
    [(['xi_0', 'x_1'], True), (['x_0', 'xi_1'], False), (['', 'xi_1'], False), ([], False)],
)
def test_the_first_name_tells_a_latent_target(names, is_latent, messages, tmp_path):
    # As the controller takes it.
    with BagWriter(tmp_path / 'bag') as bag:
        for name in ('/configuration', '/target'):
            bag.add_topic(messages.topic(name, JOINT_STATE))
        bag.write('/configuration', messages.joint_state(1, [0.0], [0.0]), 10, 10)
        bag.write('/target', messages.joint_state(0, [1.0, 2.0], names=names), 11, 11)
    (target,) = read_run(tmp_path / 'bag').targets
    assert (target.latent is not None) == is_latent
    assert (target.configuration is None) == is_latent


def test_without_a_controller_there_are_no_forces(log_type, record):
    run = read_run(record(log_type(configuration=[(1, [0.0, 0.0], [0.0, 0.0])])))
    assert run.force.shape == run.external_force.shape == (0, 2)
    assert run.force_stamp.shape == run.latent_stamp.shape == (0,)
    assert run.latent.shape[0] == 0
    assert run.targets == ()
    assert run.autoencoder_identifier == ''


def test_namespaces(log_type, record):
    def body(namespace, value):
        rows = [(1, [value, 0.0], [0.0, 0.0])]
        return log_type(configuration=rows, namespace=namespace, force=[(1, (value, 0))])

    run = read_run(record(body('/body_2', 2.0)))
    assert run.namespace == '/body_2'
    assert run.messages['/body_2/configuration'] == 1
    both = record(body('', 1.0), body('/lab/body_2', 2.0))
    with pytest.raises(BagError, match=r"\['/', '/lab/body_2'\]: name one"):
        read_run(both)
    for name in ('lab/body_2', '/lab/body_2', '/lab/body_2/'):
        assert read_run(both, name).configuration[0, 0] == read_run(both, name).force[0, 0] == 2.0
    for name in ('', '/'):
        assert read_run(both, name).configuration[0, 0] == 1.0
    with pytest.raises(BagError, match=r"'body_3': the bag has \['/', '/lab/body_2'\]"):
        read_run(both, 'body_3')


def test_paths_that_are_no_bag(small_log, record, tmp_path):
    with pytest.raises(BagError, match='nothing is there'):
        read_run(tmp_path / 'missing')
    with pytest.raises(BagError, match=r'\.mcap file, but it holds nothing'):
        read_run(tmp_path)
    (tmp_path / 'notes.txt').write_text('not a bag')
    with pytest.raises(BagError, match=r'\.mcap file, but it holds notes\.txt'):
        read_run(tmp_path)
    with pytest.raises(BagError, match='expected an MCAP file, but it starts with'):
        read_run(tmp_path / 'notes.txt')
    (tmp_path / 'empty.mcap').touch()
    with pytest.raises(BagError, match='it is empty'):
        read_run(tmp_path / 'empty.mcap')
    shutil.copy(record(small_log) / 'bag_0.mcap', tmp_path)
    with pytest.raises(BagError, match=r'holds 2: name one of them, bag_0\.mcap, empty\.mcap'):
        read_run(tmp_path)


def test_a_bag_without_configurations_says_what_it_holds(messages, log_type, record, tmp_path):
    log = log_type(configuration=[], force=[(1, (0, 1))])
    with pytest.raises(BagError, match=r"configuration.*got .*'/control_force': 1"):
        read_run(record(log))
    BagWriter(tmp_path / 'run').close()
    with pytest.raises(BagError, match='got no topic'):
        read_run(tmp_path / 'run')


def test_topics_of_another_kind_are_refused(messages, tmp_path):
    with BagWriter(tmp_path / 'run') as bag:
        bag.add_topic(messages.topic('/configuration', JOINT_STATE))
        bag.add_topic(messages.topic('/control_force', JOINT_STATE))
        cdr = messages.joint_state(1, [0.0], [0.0])
        bag.write('/configuration', cdr, 1, 1, 1)
        bag.write('/control_force', cdr, 1, 1, 1)
    with pytest.raises(BagError, match=r'WrenchStamped on /control_force, got .*JointState'):
        read_run(tmp_path / 'run')


@pytest.mark.parametrize(
    ('states', 'complaint'),
    [
        ([([1.0, 2.0], [0.0])], 'one size'),
        ([([1.0], [0.0]), ([1.0, 2.0], [0.0, 0.0])], 'one size'),
    ],
)
def test_states_of_several_sizes_are_refused(states, complaint, log_type, record):
    log = log_type(configuration=[(k, q, v) for k, (q, v) in enumerate(states)])
    with pytest.raises(BagError, match=complaint):
        read_run(record(log))


def test_states_of_several_networks_are_refused(messages, tmp_path):
    with BagWriter(tmp_path / 'run') as bag:
        bag.add_topic(messages.topic('/configuration', JOINT_STATE))
        for k, name in enumerate(('a@1', 'b@2')):
            cdr = messages.joint_state(k, [0.0], [0.0], name)
            bag.write('/configuration', cdr, k, k, 1)
    with pytest.raises(BagError, match=r"one frame_id on /configuration, got \['a@1', 'b@2'\]"):
        read_run(tmp_path / 'run')


def test_a_message_that_is_none_names_its_topic(messages, tmp_path):
    with BagWriter(tmp_path / 'run') as bag:
        bag.add_topic(messages.topic('/configuration', JOINT_STATE))
        bag.write('/configuration', messages.joint_state(1, [1.0, 2.0])[:-20], 1, 1, 1)
    with pytest.raises(BagError, match='a message of /configuration at log time 1 ns is no sensor'):
        read_run(tmp_path / 'run')


@settings(deadline=None, max_examples=150)
@given(data=st.data())
def test_a_file_cut_off_anywhere_is_said_to_be(data, small_log, record, tmp_path_factory):
    content = (_bag(record, small_log) / 'bag_0.mcap').read_bytes()
    length = data.draw(st.integers(1, len(content) - 1))
    path = tmp_path_factory.mktemp('cut') / 'bag_0.mcap'
    path.write_bytes(content[:length])
    with pytest.raises(BagError, match='MCAP file') as caught:
        read_run(path)
    assert str(caught.value).startswith(str(path))
    assert '\n' not in str(caught.value)


@settings(deadline=None, max_examples=150)
@given(data=st.data())
def test_a_file_with_flipped_bits_gives_the_run_or_a_bag_error(
    data, small_log, record, tmp_path_factory
):
    folder = _bag(record, small_log)
    content = bytearray((folder / 'bag_0.mcap').read_bytes())
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= 1 << data.draw(st.integers(0, 7))
    path = tmp_path_factory.mktemp('flipped') / 'bag_0.mcap'
    path.write_bytes(content)
    try:
        run = read_run(path)
    except BagError:
        return
    original = read_run(folder)
    assert np.array_equal(run.configuration, original.configuration)
    assert run.metadata == original.metadata
    assert run.messages == original.messages


_BAGS = {}


def test_a_file_that_was_found_whole_is_checked_again_once_it_has_changed(small_log, record):
    file = record(small_log) / 'bag_0.mcap'
    read_run(file)
    data = bytearray(file.read_bytes())
    time = file.stat().st_mtime_ns
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    os.utime(file, ns=(time + 1, time + 1))
    with pytest.raises(BagError, match='dpc bag repair'):
        read_run(file)


def _bag(record, log):
    if id(log) not in _BAGS:
        _BAGS[id(log)] = record(log)
    return _BAGS[id(log)]


def test_a_target_counts_from_when_the_controller_says(log_type, record):
    # One that is to count at once says nothing of when that was.
    log = log_type(
        configuration=[(t, [0.0], [0.0]) for t in range(0, 5 * STEP, STEP)],
        targets=[(0, [1.0], False), (0, [2.0], False)],
        targets_in_force=[(STEP, [1.0], False), (3 * STEP, [2.0], False)],
    )
    targets = read_run(record(log)).targets
    assert [(each.stamp_ns, *each.configuration) for each in targets] == [
        (STEP, 1.0),
        (3 * STEP, 2.0),
    ]


def test_arrivals_are_those_of_the_first_message_of_a_stamp(log_type, record):
    rows = [(t, [float(k)], [0.0]) for k, t in enumerate([0, STEP, STEP, 2 * STEP])]
    arrivals = read_run(record(log_type(configuration=rows))).arrivals
    assert arrivals.keys() == {'configuration'}
    times = arrivals['configuration']
    assert (times.received_ns - 10**18).tolist() == [0, 1000, 3000]
    assert (times.published_ns - 10**18).tolist() == [0, 999, 2997]


@pytest.mark.parametrize(
    ('frame', 'mass'), [('mass_162@1f3a9c02', 162), ('mass_3', 3), ('mass_', None), ('', None)]
)
def test_the_actuated_mass_is_that_of_the_forces(log_type, record, frame, mass):
    log = log_type(
        configuration=[(0, [0.0], [0.0])], force=[(0, (1.0, 2.0))], force_frames=(frame,)
    )
    assert read_run(record(log)).actuated_mass == mass
