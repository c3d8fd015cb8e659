"""What `repair` saves: every complete chunk, whatever has become of the rest, and nothing else."""

import os
import random
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from dpc_ros import cli
from dpc_ros.bag import BagError, BagWriter, Topic, read_contents, read_raw
from dpc_ros.bag.check_sums import verify
from dpc_ros.bag.repair import NothingReadableError, repair
from dpc_ros.bag.salvage import salvage
from dpc_ros.resources import share_directory

SAMPLE = share_directory() / 'bags' / 'demo_1s' / 'bag_0.mcap'
OPCODE_CHUNK, OPCODE_METADATA = 6, 12


def messages_of(path):
    return [
        (m.topic, m.type_name, m.sequence, m.log_time_ns, m.publish_time_ns, m.cdr)
        for m in read_raw(path)
    ]


def records_of(content):
    """Return opcode and end of each record of a whole file, read by nothing but their lengths."""
    place, records = 8, []
    while place < len(content) - 8:
        opcode, length = struct.unpack_from('<BQ', content, place)
        place += 9 + length
        records.append((opcode, place))
    return records


class Expected:
    """The messages of the first chunks of a file, as an independent reader gives them."""

    def __init__(self, path):
        self.content = path.read_bytes()
        ends = [end for opcode, end in records_of(self.content) if opcode == OPCODE_CHUNK]
        with path.open('rb') as stream:
            summary = make_reader(stream).get_summary()
        indexes = summary.chunk_indexes
        assert [i.chunk_start_offset + i.chunk_length for i in indexes] == ends
        names = {number: channel.topic for number, channel in summary.channels.items()}
        everything = messages_of(path)
        # Topics are taken in turn: the times of two chunks may overlap.
        complete, self.until = set(), []
        with path.open('rb') as stream:
            chunks = [
                record
                for record in StreamReader(stream, emit_chunks=True).records
                if isinstance(record, Chunk)
            ]
        for end, chunk in zip(ends, chunks, strict=True):
            inside = [r for r in breakup_chunk(chunk) if isinstance(r, Message)]
            complete |= {(names[r.channel_id], r.sequence, r.log_time) for r in inside}
            self.until.append((end, [m for m in everything if (m[0], *m[2:4]) in complete]))
        records = records_of(self.content)
        self.metadata_end = next(end for opcode, end in records if opcode == OPCODE_METADATA)

    def of_first(self, length):
        """Return the messages of the chunks that are complete in a file cut off there."""
        return next((m for end, m in reversed(self.until) if end <= length), [])


@pytest.fixture(scope='session')
def tiny(tmp_path_factory):
    """A file of five chunks and a metadata record, some thousand bytes."""
    folder = tmp_path_factory.mktemp('tiny') / 'bag'
    with BagWriter(folder, chunk_size=160) as bag:
        bag.add_metadata('dpc_ros.parameters', {'yaml': 'a: 1'})
        bag.add_topic(Topic('/a', 'std_msgs/msg/Float64', 'float64 data'))
        bag.add_topic(Topic('/b', 'std_msgs/msg/Int8', 'int8 data'))
        for k in range(16):
            time = 10**18 + 1000 * k
            topic, cdr = ('/b', bytes([k])) if k % 4 == 1 else ('/a', struct.pack('<d', k / 7))
            bag.write(topic, b'\0\1\0\0' + cdr, time, time - 10, k)
    expected = Expected(folder / 'bag_0.mcap')
    assert len(expected.until) >= 5
    assert len(expected.content) < 64 * 1024
    return expected


@pytest.fixture(scope='session')
def sample():
    return Expected(SAMPLE)


def assert_saves(content, expected, folder, also_rosbags=False):
    """Assert that a file of that content is repaired to those messages, or said to hold none."""
    damaged, repaired = folder / 'damaged.mcap', folder / 'repaired.mcap'
    damaged.write_bytes(content)
    try:
        (file,) = repair(damaged, repaired)
    except NothingReadableError:
        assert not expected
        assert not repaired.exists()
        return None
    assert messages_of(repaired) == expected
    assert file.messages == len(expected)
    with repaired.open('rb') as stream:
        verify(stream)
    if also_rosbags:
        with AnyReader([repaired]) as reader:
            read = [(topic.topic, time, data) for topic, time, data in reader.messages()]
        assert read == [(m[0], m[3], m[5]) for m in expected]
    repaired.unlink()
    return file


def test_a_small_log_cut_off_at_every_byte_keeps_every_complete_chunk(tiny, tmp_path, monkeypatch):
    # Thousands of waits for the disk would be most of the time.
    monkeypatch.setattr(os, 'fsync', lambda file: None)
    path, before = tmp_path / 'cut.mcap', None
    for length in range(len(tiny.content)):
        expected = tiny.of_first(length)
        path.write_bytes(tiny.content[:length])
        found = salvage(path)
        assert sum(found.messages.values()) == len(expected)
        assert found.losses
        # What is written depends on what the walk has found, however far it came behind that.
        sound = {key: value for key, value in vars(found).items() if key not in ('size', 'losses')}
        if sound == before:
            continue
        before = sound
        file = assert_saves(tiny.content[:length], expected, tmp_path, also_rosbags=True)
        # Its metadata record is the first thing in it.
        assert (file is not None) == (length >= tiny.metadata_end)
        assert file is None or file.losses
    file = assert_saves(tiny.content, tiny.of_first(len(tiny.content)), tmp_path)
    assert file.losses == ()


def test_a_real_log_cut_off_at_500_places_keeps_every_complete_chunk(sample, tmp_path):
    places = random.Random(6).sample(range(len(sample.content)), 500)
    # Reading hundreds of times the same beginning takes most of the time: once for each chunk that
    # is complete, and the walk alone for the others.
    seen = set()
    for number, place in enumerate(places):
        expected = sample.of_first(place)
        if len(expected) not in seen:
            seen.add(len(expected))
            assert_saves(sample.content[:place], expected, tmp_path, number < 5)
            continue
        path = tmp_path / 'cut.mcap'
        path.write_bytes(sample.content[:place])
        found = salvage(path)
        assert sum(found.messages.values()) == len(expected)
        assert found.losses


@settings(max_examples=60)
@given(data=st.data())
def test_a_flipped_bit_costs_the_chunk_it_is_in_and_no_other(data, tiny, tmp_path_factory):
    content = bytearray(tiny.content)
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= 1 << data.draw(st.integers(0, 7))
    everything = tiny.of_first(len(content))
    records = records_of(tiny.content)
    opcode, _ = next((record for record in records if record[1] > place), (0, 0))
    starts = [0] + [len(messages) for _, messages in tiny.until]
    hit = next((k for k, (end, _) in enumerate(tiny.until) if place < end), None)
    folder = tmp_path_factory.mktemp('flipped')
    (folder / 'damaged.mcap').write_bytes(content)
    (file,) = repair(folder / 'damaged.mcap', folder / 'repaired.mcap')
    saved = messages_of(folder / 'repaired.mcap')
    assert file.losses, 'nothing goes unnoticed'
    if opcode == OPCODE_CHUNK and saved != everything:
        # The end of the file describes the topics again, should the first chunk be lost.
        assert saved == everything[: starts[hit]] + everything[starts[hit + 1] :]
    else:
        assert saved == everything


@settings(max_examples=40)
@given(data=st.data())
def test_several_damages_at_once_give_sound_messages_only(data, tiny, tmp_path_factory):
    content = bytearray(tiny.content)
    for _ in range(data.draw(st.integers(2, 6))):
        place = data.draw(st.integers(0, len(content) - 1))
        size = data.draw(st.integers(1, 200))
        content[place : place + size] = data.draw(st.sampled_from([b'', bytes(size), b'\xff']))
    folder = tmp_path_factory.mktemp('mangled')
    (folder / 'damaged.mcap').write_bytes(content)
    try:
        repair(folder / 'damaged.mcap', folder / 'repaired.mcap')
    except NothingReadableError:
        return
    assert set(messages_of(folder / 'repaired.mcap')) <= set(tiny.of_first(len(tiny.content)))


@settings(max_examples=60)
@given(content=st.binary(max_size=300), magic=st.booleans())
def test_what_is_no_log_is_said_to_be_none(content, magic, tmp_path_factory):
    folder = tmp_path_factory.mktemp('noise')
    (folder / 'noise.mcap').write_bytes(b'\x89MCAP0\r\n' * magic + content)
    with pytest.raises(NothingReadableError, match='nothing of it can be saved'):
        repair(folder / 'noise.mcap', folder / 'repaired')
    assert [path.name for path in folder.iterdir()] == ['noise.mcap']


def test_everything_but_messages_is_kept_too(messages, tmp_path):
    topic = messages.topic('/control_force', 'geometry_msgs/msg/WrenchStamped')
    with BagWriter(tmp_path / 'bag', ros_distro='kilted') as bag:
        bag.add_metadata('dpc_ros.parameters', {'yaml': 'a: 1', 'more': 'ä'})
        bag.add_topic(topic)
        bag.write(topic.name, messages.wrench(1, (2, 3)), 5, 4, 7)
        bag.sync()
        bag.add_attachment('plan.txt', 'text/plain', b'go there', 2)
    path = tmp_path / 'bag' / 'bag_0.mcap'
    content = path.read_bytes()
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    path.write_bytes(content[: content.index(b'serialized_metadata') - 10])
    repair(tmp_path / 'bag', tmp_path / 'new')
    contents = read_contents(tmp_path / 'new')
    assert contents.metadata == {'dpc_ros.parameters': {'yaml': 'a: 1', 'more': 'ä'}}
    (attachment,) = contents.attachments
    assert (attachment.name, attachment.media_type, attachment.size) == (
        'plan.txt',
        'text/plain',
        8,
    )
    with (tmp_path / 'new' / 'bag_0.mcap').open('rb') as stream:
        (read,) = make_reader(stream).iter_attachments()
    assert (read.log_time, read.data) == (2, b'go there')
    for path in (tmp_path / 'new', tmp_path / 'new' / 'bag_0.mcap'):
        with AnyReader([path]) as reader:
            (connection,) = reader.connections
            assert connection.msgtype == topic.type_name
            (profile,) = connection.ext.offered_qos_profiles
            assert profile.depth == 200
    with AnyReader([tmp_path / 'new']) as reader:
        assert reader.connections[0].digest == topic.type_hash


def test_a_folder_keeps_its_files(split_bag, small_log, tmp_path):
    folder = split_bag(small_log, 4)
    whole = messages_of(folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    files = repair(folder, tmp_path / 'copy')
    assert not any(file.losses for file in files)
    for path in folder.iterdir():
        assert (tmp_path / 'copy' / path.name).read_bytes() == before[path.name]
    assert messages_of(tmp_path / 'copy') == whole
    # Killed in the last file, before any table of contents; the one before is gone.
    last = messages_of(folder / 'bag_3.mcap')
    (folder / 'bag_3.mcap').write_bytes(before['bag_3.mcap'][:-30])
    (folder / 'bag_1.mcap').unlink()
    (folder / 'bag_4.mcap').touch()
    files = repair(folder, tmp_path / 'new')
    assert [(file.name, file.is_kept, bool(file.losses)) for file in files] == [
        ('bag_0.mcap', True, False),
        ('bag_2.mcap', True, False),
        ('bag_3.mcap', True, True),
        ('bag_4.mcap', False, True),
        ('bag_1.mcap', False, True),
        ('metadata.yaml', True, True),
    ]
    saved = messages_of(tmp_path / 'new')
    assert [m for m in whole if m in saved] == saved
    assert all(m in saved for m in last)
    with AnyReader([tmp_path / 'new']) as reader:
        assert reader.message_count == len(saved) == len(list(reader.messages()))


def test_a_log_without_chunks_is_saved_too(tmp_path):
    path = tmp_path / 'plain.mcap'
    with path.open('wb') as stream:
        writer = Writer(stream, use_chunking=False, enable_data_crcs=True)
        writer.start(profile='ros2')
        schema = writer.register_schema('std_msgs/msg/Int8', 'ros2msg', b'int8 data')
        channel = writer.register_channel('/b', 'cdr', schema)
        for k in range(10):
            writer.add_message(channel, k, bytes([0, 1, 0, 0, k]), k)
        writer.finish()
    whole = messages_of(path)
    last = records_of(path.read_bytes())[12][1]  # header, schema, channel, ten messages
    path.write_bytes(path.read_bytes()[: last - 1])
    repair(path, tmp_path / 'new')
    assert messages_of(tmp_path / 'new') == whole[:9]


def test_what_exists_is_never_written_over(tiny, tmp_path):
    damaged = tmp_path / 'damaged.mcap'
    damaged.write_bytes(tiny.content[:-1])
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'link').symlink_to('nowhere')
    for target in ('damaged.mcap', 'folder', 'link'):
        with pytest.raises(FileExistsError, match='expected a new place'):
            repair(damaged, tmp_path / target)
    assert damaged.read_bytes() == tiny.content[:-1]
    with pytest.raises(BagError, match='nothing is there'):
        repair(tmp_path / 'missing', tmp_path / 'new')


def test_the_command_says_what_was_lost_and_how_it_ended(tiny, tmp_path, capsys):
    path = tmp_path / 'log.mcap'
    path.write_bytes(tiny.content)
    cli.main(['bag', 'repair', str(path), str(tmp_path / 'copy')])
    assert f'nothing was wrong with {path}' in capsys.readouterr().out
    end = tiny.until[2][0]
    path.write_bytes(tiny.content[: end - 1])
    cli.main(['bag', 'repair', str(path), str(tmp_path / 'part')])
    shown = capsys.readouterr().out
    assert f'{len(tiny.until[1][1])} messages in 2 chunks' in shown
    assert f'to {end - 1}: a chunk that is cut off' in shown
    path.write_bytes(tiny.content[:20])
    with pytest.raises(SystemExit) as caught:
        cli.main(['bag', 'repair', str(path), str(tmp_path / 'none')])
    assert caught.value.code == 1
    assert capsys.readouterr().err.startswith(f'error: {path}: expected at least one complete')
    assert not (tmp_path / 'none').exists()
