"""The MCAP files of a bag without ROS: their topics, metadata and messages."""

from __future__ import annotations

import heapq
import os
import struct
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap.records import Channel, Schema, Statistics
from mcap.records import Message as RecordedMessage
from mcap.summary import Summary
from mcap_ros2.decoder import DecoderFactory
from zstandard import ZstdError

from dpc_ros.bag.check_sums import MAGIC, verify
from dpc_ros.bag.metadata import RECORD_NAME
from dpc_ros.bag.splits import BagError, find_files
from dpc_ros.bag.topic import Topic, offered_profiles

# What the readers raise on a damaged file; a wrong check sum is a ValueError.
DAMAGE = (
    McapError,
    ValueError,
    LookupError,
    OverflowError,
    RuntimeError,
    TypeError,
    struct.error,
    ZstdError,
)
_verified: set[tuple[str, int, int]] = set()  # path, size and time [ns] of whole files
_Record = tuple[Path, Schema | None, Channel, RecordedMessage]


@dataclass(frozen=True)
class Attachment:
    """What the index of a file says of an attachment.

    Attributes:
        name: of the attachment.
        media_type: `text/plain`, …
        size: of its data [bytes].
        log_time_ns: when it was recorded [ns since the epoch].
    """

    name: str
    media_type: str
    size: int
    log_time_ns: int


@dataclass(frozen=True)
class Contents:
    """What the summaries of a bag's files say.

    Attributes:
        files: the MCAP files, in the order of the recording.
        types: type of each topic, `sensor_msgs/msg/JointState`.
        definitions: text of the message definition of each topic, empty where it is not there.
        publishers: number of publishers whose offers each topic names, 0 where it does not say.
        messages: number of messages of each topic.
        metadata: metadata records by name, without rosbag2's own; of two of one name the later
            one overwrites single keys of the earlier.
        attachments: in the order of the files.
        start_ns: log time of the first message, 0 where there is none [ns since the epoch].
        end_ns: log time of the last message, likewise.
    """

    files: tuple[Path, ...]
    types: dict[str, str]
    definitions: dict[str, str]
    publishers: dict[str, int]
    messages: dict[str, int]
    metadata: dict[str, dict[str, str]]
    attachments: tuple[Attachment, ...]
    start_ns: int
    end_ns: int


@dataclass(frozen=True, eq=False)
class RawMessage:
    """A message of a bag as it was received.

    Attributes:
        topic: name of the topic.
        type_name: `sensor_msgs/msg/JointState`, empty where the bag does not say it.
        sequence: the publisher's number of the message, 0 if not known.
        log_time_ns: when it was received [ns since the epoch].
        publish_time_ns: when it was sent [ns since the epoch].
        cdr: the serialised message, with its encapsulation header.
    """

    topic: str
    type_name: str
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    cdr: bytes


@dataclass(frozen=True, eq=False)
class Message:
    """A decoded message of a bag.

    Attributes:
        topic: name of the topic.
        type_name: `sensor_msgs/msg/JointState`.
        sequence: the publisher's number of the message, 0 if not known.
        log_time_ns: when it was received [ns since the epoch].
        publish_time_ns: when it was sent [ns since the epoch].
        cdr: the serialised message, with its encapsulation header.
        content: an object with the fields of the ROS message.
    """

    topic: str
    type_name: str
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    cdr: bytes
    content: Any


def read_contents(path: str | Path) -> Contents:
    """Read the summaries of a bag.

    Args:
        path: folder of the bag, or one MCAP file.

    Raises:
        BagError: the path is no bag, or a file is damaged or cut off.
    """
    files = find_files(path)
    types: dict[str, str] = {}
    definitions: dict[str, str] = {}
    publishers: dict[str, int] = {}
    messages: dict[str, int] = {}
    metadata: dict[str, dict[str, str]] = {}
    attachments: list[Attachment] = []
    spans: list[tuple[int, int]] = []
    for file in files:
        with _reader(file) as reader:
            summary, statistics = _summary(reader)
            if statistics.message_count:
                spans.append((statistics.message_start_time, statistics.message_end_time))
            for number, channel in summary.channels.items():
                count = statistics.channel_message_counts.get(number, 0)
                messages[channel.topic] = messages.get(channel.topic, 0) + count
                schema = summary.schemas.get(channel.schema_id)
                types[channel.topic] = schema.name if schema else ''
                definitions[channel.topic] = schema.data.decode(errors='replace') if schema else ''
                offers = len(offered_profiles(channel.metadata))
                publishers[channel.topic] = max(publishers.get(channel.topic, 0), offers)
            for record in reader.iter_metadata():
                if record.name != RECORD_NAME:
                    metadata.setdefault(record.name, {}).update(record.metadata)
            attachments += [
                Attachment(index.name, index.media_type, index.data_size, index.log_time)
                for index in summary.attachment_indexes
            ]
    return Contents(
        files,
        types,
        definitions,
        publishers,
        messages,
        metadata,
        tuple(attachments),
        start_ns=min((start for start, _ in spans), default=0),
        end_ns=max((end for _, end in spans), default=0),
    )


def read_topics(path: str | Path) -> dict[str, Topic]:
    """Read what a bag says of each of its topics that has a message, by name.

    Raises:
        BagError: the path is no bag, a file is damaged, or a topic is not one of ROS 2 messages.
    """
    topics: dict[str, Topic] = {}
    for file in find_files(path):
        with _reader(file) as reader:
            summary, statistics = _summary(reader)
            for number, channel in summary.channels.items():
                if channel.topic in topics or number not in statistics.channel_message_counts:
                    continue
                topics[channel.topic] = _topic(
                    file, summary.schemas.get(channel.schema_id), channel
                )
    return topics


def _topic(file: Path, schema: Schema | None, channel: Channel) -> Topic:
    encodings = (channel.message_encoding, schema.encoding if schema else '')
    if schema is None or encodings != ('cdr', 'ros2msg'):
        raise BagError(
            f'{file}: expected CDR messages with a ros2msg definition on {channel.topic}, got '
            f'{encodings}'
        )
    try:
        return Topic(
            name=channel.topic,
            type_name=schema.name,
            definition=schema.data.decode(),
            offered_qos_profiles=offered_profiles(channel.metadata),
            type_hash=channel.metadata.get('topic_type_hash', ''),
        )
    except ValueError as error:
        raise BagError(f'{file}: {channel.topic}: {error}') from error


def read_raw(path: str | Path, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
    """Read the messages of some topics, or all, in the order of their log times, undecoded.

    Raises:
        BagError: the path is no bag, or a file is damaged.
    """
    for _, schema, channel, record in _records(path, topics):
        yield RawMessage(
            channel.topic,
            schema.name if schema else '',
            record.sequence,
            record.log_time,
            record.publish_time,
            record.data,
        )


def read_messages(path: str | Path, topics: Collection[str] | None = None) -> Iterator[Message]:
    """Read the messages of some topics, or all, in the order of their log times.

    Raises:
        BagError: the path is no bag, a file is damaged, or a message can't be decoded.
    """
    factories: dict[Path, DecoderFactory] = {}  # it knows schemas by their numbers in one file
    for file, schema, channel, record in _records(path, topics):
        factory = factories.setdefault(file, DecoderFactory())
        type_name = schema.name if schema else 'message'
        try:
            decode = factory.decoder_for(channel.message_encoding, schema)
            if decode is None:
                raise BagError(
                    f'{file}: expected CDR messages with a ros2msg definition on {channel.topic}, '
                    f'got {channel.message_encoding} with {schema.encoding if schema else "none"}'
                )
            content = decode(record.data)
        except BagError:
            raise
        except DAMAGE as error:
            raise BagError(
                f'{file}: a message of {channel.topic} at log time {record.log_time} ns is no '
                f'{type_name}: {reason(error)}'
            ) from error
        yield Message(
            channel.topic,
            type_name,
            record.sequence,
            record.log_time,
            record.publish_time,
            record.data,
            content,
        )


def _records(path: str | Path, topics: Collection[str] | None) -> Iterator[_Record]:
    """Merge the files by log time, each opened when its first message is due."""
    files = find_files(path)
    due: list[tuple[int, int, _Record | None, Iterator[_Record]]] = [
        (_start_ns(file) if len(files) > 1 else 0, place, None, _records_of(file, topics))
        for place, file in enumerate(files)
    ]
    heapq.heapify(due)
    while due:
        _, place, record, rest = heapq.heappop(due)
        if record is not None:
            yield record
        following = next(rest, None)
        if following is not None:
            heapq.heappush(due, (following[-1].log_time, place, following, rest))


def _records_of(file: Path, topics: Collection[str] | None) -> Iterator[_Record]:
    with _reader(file) as reader:
        for schema, channel, record in reader.iter_messages(topics=topics):
            yield file, schema, channel, record


def _start_ns(file: Path) -> int:
    with _reader(file) as reader:
        _, statistics = _summary(reader)
        return statistics.message_start_time


def _summary(reader: McapReader) -> tuple[Summary, Statistics]:
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        raise McapError('it has no summary')
    return summary, summary.statistics


@contextmanager
def _reader(file: Path) -> Iterator[McapReader]:
    try:
        stream = file.open('rb')
    except OSError as error:
        raise BagError(f'{file}: expected a readable MCAP file, but {error.strerror}') from error
    with stream:
        start = stream.read(len(MAGIC))
        if not start:
            raise BagError(f'{file}: expected an MCAP file, but it is empty: record the run again')
        if start != MAGIC[: len(start)]:
            raise BagError(
                f'{file}: expected an MCAP file, but it starts with {start!r}: '
                'name a bag that rosbag2 or dpc_ros recorded with MCAP storage'
            )
        try:
            _verify_once(stream)
            yield make_reader(stream, validate_crcs=True)
        except BagError:
            raise
        except (*DAMAGE, OSError) as error:
            raise BagError(
                f'{file}: expected a complete MCAP file, but it is cut off or damaged '
                f'({reason(error)}): `dpc bag repair` saves what can be read of it'
            ) from error


def _verify_once(stream: BinaryIO) -> None:
    """Compare a whole file with its check sums unless that was done and it has not changed."""
    state = os.fstat(stream.fileno())
    key = (str(Path(stream.name).resolve()), state.st_size, state.st_mtime_ns)
    if key not in _verified:
        verify(stream)
        _verified.add(key)
    stream.seek(0)


def reason(error: Exception) -> str:
    """Return the first line of what an error says."""
    return str(error).splitlines()[0] if str(error) else type(error).__name__
