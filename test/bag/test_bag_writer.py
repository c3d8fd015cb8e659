import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosHistory, QosReliability

from dpc_ros.bag import BagWriter, QosProfile, Topic

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
