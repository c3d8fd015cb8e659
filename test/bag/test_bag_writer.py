import errno
import itertools
import os
import resource

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosHistory, QosReliability

from dpc_ros.bag import LOSSES_RECORD, BagWriter, QosProfile, Topic

JOINT_STATE = 'sensor_msgs/msg/JointState'
WRENCH = 'geometry_msgs/msg/WrenchStamped'
FINITE = st.floats(-1e6, 1e6)


def read_with_mcap(folder):
    (file,) = folder.glob('*.mcap')
    with file.open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        return [
            (channel.topic, record.log_time, record.data)
            for _, channel, record in reader.iter_messages()
        ]


def read_with_rosbags(folder):
    with AnyReader([folder]) as reader:
        return [(topic.topic, time, data) for topic, time, data in reader.messages()]


@settings(deadline=None, max_examples=25)
@given(
    rows=st.lists(
        st.tuples(st.booleans(), st.integers(0, 2**40), st.lists(FINITE, max_size=40)), max_size=60
    ),
    chunk_size=st.sampled_from([1, 200, 256 * 1024]),
)
def test_two_independent_readers_give_back_the_same_messages(
    rows, chunk_size, messages, tmp_path_factory
):
    folder = tmp_path_factory.mktemp('runs') / 'bag'
    # Unique log times: the order of equal ones is the reader's choice.
    rows = sorted({time: (is_state, values) for is_state, time, values in rows}.items())
    written = []
    with BagWriter(folder, chunk_size=chunk_size) as bag:
        bag.add_topic(messages.topic('/configuration', JOINT_STATE))
        bag.add_topic(messages.topic('/control_force', WRENCH))
        for time, (is_state, values) in rows:
            topic = '/configuration' if is_state else '/control_force'
            cdr = (
                messages.joint_state(time, values, values, 'net@1')
                if is_state
                else messages.wrench(time, (len(values), -1.5))
            )
            bag.write(topic, cdr, time, time + 1, len(written))
            written.append((topic, time, cdr))
        counts = bag.message_counts
    assert read_with_mcap(folder) == written
    assert read_with_rosbags(folder) == written
    assert sum(counts.values()) == len(written)
    with AnyReader([folder]) as reader:
        assert {name: info.msgcount for name, info in reader.topics.items()} == counts
        if written:
            assert reader.start_time == written[0][1]
            # rosbags gives the end as exclusive.
            assert reader.duration == written[-1][1] - written[0][1] + 1


def test_both_readers_decode_what_was_meant(messages, tmp_path):
    position, velocity = np.arange(400.0), -np.arange(400.0)
    with BagWriter(tmp_path / 'run') as bag:
        bag.add_topic(messages.topic('/configuration', JOINT_STATE))
        cdr = messages.joint_state(3_000_000_007, position, velocity, 'net@1')
        bag.write('/configuration', cdr, 5, 4, 1)
    with AnyReader([tmp_path / 'run']) as reader:
        ((connection, _, data),) = reader.messages()
        decoded = [reader.deserialize(data, connection.msgtype)]
    with (tmp_path / 'run' / 'run_0.mcap').open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        decoded += [item.decoded_message for item in reader.iter_decoded_messages()]
    assert len(decoded) == 2
    for message in decoded:
        assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 7)
        assert message.header.frame_id == 'net@1'
        assert np.array_equal(message.position, position)
        assert np.array_equal(message.velocity, velocity)


def test_messages_out_of_order_are_read_in_the_order_of_their_log_times(messages, tmp_path):
    times = [5, 3, 9, 1]
    with BagWriter(tmp_path / 'run', chunk_size=1) as bag:
        bag.add_topic(messages.topic('/control_force', WRENCH))
        for time in times:
            bag.write('/control_force', messages.wrench(time, (0, time)), time, time, 0)
    for read in (read_with_mcap, read_with_rosbags):
        assert [time for _, time, _ in read(tmp_path / 'run')] == sorted(times)


def test_quality_of_service_and_type_hash_reach_the_reader(messages, tmp_path):
    target = QosProfile(depth=1, durability='transient_local')
    loose = QosProfile(history='unknown', depth=0, reliability='best_effort', lifespan_ns=1_500)
    topic = messages.topic('/target', JOINT_STATE, [target, loose])
    with BagWriter(tmp_path / 'run', ros_distro='kilted') as bag:
        bag.add_topic(topic)
    # The folder is read by metadata.yaml, the file by what its channel says.
    for path in (tmp_path / 'run', tmp_path / 'run' / 'run_0.mcap'):
        with AnyReader([path]) as reader:
            (connection,) = reader.connections
            first, second = connection.ext.offered_qos_profiles
            assert first.history == QosHistory.KEEP_LAST
            assert first.depth == 1
            assert first.durability == QosDurability.TRANSIENT_LOCAL
            assert first.reliability == QosReliability.RELIABLE
            assert first.deadline == (9223372036, 854775807)
            assert second.history == QosHistory.UNKNOWN
            assert second.reliability == QosReliability.BEST_EFFORT
            assert second.lifespan == (0, 1_500)
    with AnyReader([tmp_path / 'run']) as reader:
        # rosbags recomputes the hash from the definition and refuses another one.
        assert reader.connections[0].digest == topic.type_hash
        assert reader.readers[0].ros_distro == 'kilted'


def test_metadata_is_that_of_rosbag2_version_9(messages, tmp_path):
    with BagWriter(tmp_path / 'run') as bag:
        bag.add_topic(messages.topic('/control_force', WRENCH))
        for time in (100, 150):
            bag.write('/control_force', messages.wrench(time, (0, 1)), time, time, 0)
    text = (tmp_path / 'run' / 'metadata.yaml').read_text()
    assert '&' not in text, 'aliases are legal YAML that hardly any reader of bags expects'
    (content,) = yaml.safe_load(text).values()
    expected_keys = (
        'version storage_identifier duration starting_time message_count '
        'topics_with_message_count compression_format compression_mode relative_file_paths files '
        'custom_data ros_distro'
    )
    assert list(content) == expected_keys.split()
    assert content['version'] == 9
    assert content['starting_time'] == {'nanoseconds_since_epoch': 100}
    assert content['duration'] == {'nanoseconds': 50}
    assert content['relative_file_paths'] == ['run_0.mcap']
    assert content['files'][0]['message_count'] == content['message_count'] == 2
    # rosbag2 learns the format version of a lone file from the record inside it.
    with (tmp_path / 'run' / 'run_0.mcap').open('rb') as stream:
        records = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}
    assert yaml.safe_load(records['rosbag2']['serialized_metadata']) == content


def test_an_empty_bag_is_a_bag(tmp_path):
    BagWriter(tmp_path / 'run').close()
    assert read_with_mcap(tmp_path / 'run') == []
    assert read_with_rosbags(tmp_path / 'run') == []


def test_an_error_in_the_run_keeps_what_was_recorded(messages, tmp_path):
    def interrupted():
        with BagWriter(tmp_path / 'run') as bag:
            bag.add_topic(messages.topic('/control_force', WRENCH))
            bag.write('/control_force', messages.wrench(1, (0, 1)), 1, 1, 1)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert len(read_with_rosbags(tmp_path / 'run')) == 1


def test_an_empty_folder_is_taken_and_a_used_one_refused(tmp_path):
    (tmp_path / 'run').mkdir()
    BagWriter(tmp_path / 'run').close()
    before = sorted(tmp_path.rglob('*'))
    with pytest.raises(FileExistsError, match='holds something: choose another name'):
        BagWriter(tmp_path / 'run')
    (tmp_path / 'file').write_text('x')
    with pytest.raises(FileExistsError, match='expected a new or an empty folder'):
        BagWriter(tmp_path / 'file')
    assert sorted(tmp_path.rglob('*')) == sorted([*before, tmp_path / 'file'])


def test_what_a_bag_refuses(messages, tmp_path):
    topic = messages.topic('/control_force', WRENCH)
    cdr = messages.wrench(1, (0, 1))
    with BagWriter(tmp_path / 'run') as bag:
        bag.add_topic(topic)
        bag.add_topic(topic)
        with pytest.raises(ValueError, match='another topic of this name'):
            bag.add_topic(messages.topic('/control_force', JOINT_STATE))
        with pytest.raises(ValueError, match='another definition'):
            bag.add_topic(Topic('/other', WRENCH, 'float64 x'))
        with pytest.raises(ValueError, match='add it first'):
            bag.write('/target', cdr, 1, 1, 1)
        with pytest.raises(ValueError, match='log time'):
            bag.write('/control_force', cdr, -1, 1, 1)
        with pytest.raises(ValueError, match='expected texts'):
            bag.add_metadata('run', {'seed': 7})
        with pytest.raises(ValueError, match='own'):
            bag.add_metadata('rosbag2', {})
        assert bag.message_counts == {'/control_force': 0}
    bag.close()
    with pytest.raises(ValueError, match='closed'):
        bag.write('/control_force', cdr, 1, 1, 1)
    with pytest.raises(ValueError, match='closed'):
        bag.add_topic(topic)
    with pytest.raises(ValueError, match='chunk_size'):
        BagWriter(tmp_path / 'other', chunk_size=0)


@pytest.mark.parametrize(
    'wrong',
    [
        {'history': 'keep_first'},
        {'reliability': 1},
        {'depth': -1},
        {'deadline_ns': -1},
        {'lifespan_ns': 2**63},
    ],
)
def test_a_profile_that_is_none_is_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        QosProfile(**wrong)


@pytest.mark.parametrize(
    ('name', 'type_name', 'definition'),
    [
        ('configuration', JOINT_STATE, 'float64 x'),
        ('/', JOINT_STATE, 'float64 x'),
        ('/configuration', 'sensor_msgs/JointState', 'float64 x'),
        ('/configuration', JOINT_STATE, ' \n'),
    ],
)
def test_a_topic_that_is_none_is_refused(name, type_name, definition):
    with pytest.raises(ValueError, match=r'expected|empty'):
        Topic(name, type_name, definition)


def test_sequence_numbers_of_64_bits_are_kept_modulo_32(messages, tmp_path):
    with BagWriter(tmp_path / 'run') as bag:
        bag.add_topic(messages.topic('/control_force', WRENCH))
        bag.write('/control_force', messages.wrench(1, (0, 1)), 1, 1, 2**64 - 1)
    with (tmp_path / 'run' / 'run_0.mcap').open('rb') as stream:
        ((_, _, record),) = make_reader(stream).iter_messages()
    assert record.sequence == 2**32 - 1


def test_what_is_synced_is_on_the_disk_in_complete_chunks(
    messages, tmp_path, monkeypatch, complete_messages
):
    synced = []

    def fsync(descriptor):
        os_fsync(descriptor)
        synced.append((os.readlink(f'/proc/self/fd/{descriptor}'), os.fstat(descriptor).st_size))

    def numbers_in(file):
        return [message.sequence for message in complete_messages(file)]

    os_fsync = os.fsync
    monkeypatch.setattr(os, 'fsync', fsync)
    file = tmp_path / 'run' / 'run_0.mcap'
    with BagWriter(tmp_path / 'run') as bag:
        assert [path for path, _ in synced] == [str(file.parent)]  # its name is on the disk
        bag.add_topic(messages.topic('/control_force', WRENCH))
        for time in range(1, 4):
            bag.write('/control_force', messages.wrench(time, (0, 1)), time, time, time)
            bag.sync()
            # What is read here is what a killed process leaves behind.
            assert numbers_in(file) == list(range(1, time + 1))
            assert synced[-1] == (str(file), file.stat().st_size)
        count = len(synced)
        bag.sync()
        assert len(synced) == count, 'nothing has come since'
        bag.write('/control_force', messages.wrench(4, (0, 1)), 4, 4, 4)
        assert numbers_in(file) == [1, 2, 3]
    assert (str(file), file.stat().st_size) in synced


@settings(deadline=None, max_examples=10)
@given(
    sizes=st.lists(st.integers(0, 400), min_size=1, max_size=40),
    split_size=st.sampled_from([0, 6_000, 20_000]),
    split_duration_ns=st.sampled_from([0, 70, 200]),
)
def test_a_split_log_is_one_log_of_files_that_stand_alone(
    sizes, split_size, split_duration_ns, messages, tmp_path_factory
):
    folder = tmp_path_factory.mktemp('runs') / 'bag'
    limits = {'split_size': split_size, 'split_duration_ns': split_duration_ns}
    written = []
    with BagWriter(folder, chunk_size=2_000, **limits) as bag:
        bag.add_topic(messages.topic('/configuration', JOINT_STATE))
        bag.add_metadata('run', {'seed': '7'})
        for k, size in enumerate(sizes):
            time = 10 * k
            position = np.random.default_rng(k).normal(size=size)
            cdr = messages.joint_state(time, position)
            bag.write('/configuration', cdr, time, time, k)
            bag.count_lost('/configuration', 1)
            written.append(('/configuration', time, cdr))
        counts = bag.message_counts
    assert counts == {'/configuration': len(sizes)}
    (content,) = yaml.safe_load((folder / 'metadata.yaml').read_text()).values()
    names = content['relative_file_paths']
    assert names == [f'bag_{k}.mcap' for k in range(len(names))]
    assert sorted(names) == sorted(path.name for path in folder.glob('*.mcap'))
    assert read_with_rosbags(folder) == written
    parts = [read_with_rosbags(folder / name) for name in names]
    assert list(itertools.chain(*parts)) == written
    lost = 0
    for name, part, entry in zip(names, parts, content['files'], strict=True):
        times = [time for _, time, _ in part]
        assert entry['message_count'] == len(part) > 0
        assert entry['starting_time'] == {'nanoseconds_since_epoch': times[0]}
        assert entry['duration'] == {'nanoseconds': times[-1] - times[0]}
        if split_duration_ns:
            assert times[-1] - times[0] < split_duration_ns
        with (folder / name).open('rb') as stream:
            reader = make_reader(stream, validate_crcs=True)
            records = {record.name: record.metadata for record in reader.iter_metadata()}
            summary = reader.get_summary()
        assert [schema.name for schema in summary.schemas.values()] == [JOINT_STATE]
        if split_size and len(part) > 1:
            last_chunk = summary.chunk_indexes[-1]
            assert last_chunk.chunk_start_offset + last_chunk.chunk_length <= split_size
        assert records['run'] == {'seed': '7'}
        own = yaml.safe_load(records['rosbag2']['serialized_metadata'])
        assert own['relative_file_paths'] == [name]
        lost += len(part)
        # The first message of the next file is lost before that file is closed, not this one.
        assert records[LOSSES_RECORD] == {'/configuration': str(lost)}
    if not split_size and not split_duration_ns:
        assert len(names) == 1


def test_on_a_full_disk_the_log_is_finished_with_all_that_came(small_disk, messages):
    folder = small_disk / 'run'
    written = []

    def fill():
        with BagWriter(folder) as bag:
            bag.add_topic(messages.topic('/configuration', JOINT_STATE))
            rng = np.random.default_rng(0)
            while True:
                time = len(written)
                cdr = messages.joint_state(time, rng.normal(size=400))
                written.append(('/configuration', time, cdr))
                bag.write('/configuration', cdr, time, time, time)

    with pytest.raises(OSError, match='No space left') as caught:
        fill()
    assert caught.value.errno == errno.ENOSPC
    # Refused before it was taken, or taken into the reserve.
    assert read_with_rosbags(folder) in (written, written[:-1])
    assert read_with_mcap(folder) == read_with_rosbags(folder)
    assert sum(path.stat().st_size for path in folder.iterdir()) > 2.5 * 2**20
    with pytest.raises(OSError, match='No space left'):
        (small_disk / 'rest').write_bytes(bytes(2 * 2**20))
    with pytest.raises(OSError, match='No space left'):
        BagWriter(small_disk / 'other')


def test_a_file_that_may_not_grow_keeps_its_complete_chunks(messages, tmp_path, complete_messages):
    folder, written = tmp_path / 'run', []
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    bag = BagWriter(folder, chunk_size=10_000)
    bag.add_topic(messages.topic('/configuration', JOINT_STATE))
    rng = np.random.default_rng(0)

    def fill():
        while True:
            cdr = messages.joint_state(1, rng.normal(size=400))
            bag.write('/configuration', cdr, len(written), 1, 1)
            written.append(len(written))

    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, before[1]))
    try:
        with pytest.raises(OSError, match='File too large'):
            fill()
        bag.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    kept = [message.log_time for message in complete_messages(folder / 'run_0.mcap')]
    assert kept == written[: len(kept)]
    assert len(kept) > 0.9 * len(written)
    assert not (folder / 'metadata.yaml').exists()
    with pytest.raises(ValueError, match='closed'):
        bag.sync()
