"""The MCAP file of a bag without ROS: its topics, metadata and decoded messages."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap_ros2.decoder import DecoderFactory
from zstandard import ZstdError

from dpc_ros.bag.check_sums import MAGIC, verify
from dpc_ros.bag.metadata import RECORD_NAME

# What the readers raise on a damaged file; a wrong check sum is a ValueError.
_DAMAGE = (
    McapError,
    ValueError,
    LookupError,
    OverflowError,
    RuntimeError,
    TypeError,
    struct.error,
    ZstdError,
)
_SHOWN = 5  # files listed in an error


class BagError(ValueError):
    """A bag that can't be read: what was expected, what came, what to do."""


@dataclass(frozen=True)
class Contents:
    """What the summary of a file says.

    Attributes:
        types: type of each topic, `sensor_msgs/msg/JointState`.
        messages: number of messages of each topic.
        metadata: metadata records by name, without rosbag2's own; of two of one name the later
            one overwrites single keys of the earlier.
    """

    types: dict[str, str]
    messages: dict[str, int]
    metadata: dict[str, dict[str, str]]


@dataclass(frozen=True, eq=False)
class Message:
    """A decoded message of a bag.

    Attributes:
        topic: name of the topic.
        sequence: the publisher's number of the message, 0 if not known.
        log_time_ns: when it was received [ns since the epoch].
        content: an object with the fields of the ROS message.
    """

    topic: str
    sequence: int
    log_time_ns: int
    content: Any


def find_file(path: str | Path) -> Path:
    """Return the MCAP file that a path means: the file itself or the folder that holds it.

    Raises:
        BagError: nothing is there, or the folder holds none or several.
    """
    path = Path(path)
    if path.is_file():
        return path
    if not path.is_dir():
        raise BagError(
            f'{path}: expected the folder of a bag or an .mcap file, but nothing is there: '
            'check the path'
        )
    files = sorted(path.glob('*.mcap'))
    if len(files) == 1:
        return files[0]
    if files:
        raise BagError(
            f'{path}: expected a folder with one .mcap file, but it holds {len(files)}: '
            f'name one of them, {_some(files)}'
        )
    raise BagError(
        f'{path}: expected a folder with an .mcap file, but it holds '
        f'{_some(sorted(path.iterdir())) or "nothing"}: name the folder of a bag'
    )


def read_contents(path: str | Path) -> Contents:
    """Read the summary of a bag.

    Raises:
        BagError: the path is no bag, or the file is damaged or cut off.
    """
    with _reader(find_file(path)) as reader:
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise McapError('it has no summary')
        types: dict[str, str] = {}
        messages: dict[str, int] = {}
        for number, channel in summary.channels.items():
            count = summary.statistics.channel_message_counts.get(number, 0)
            messages[channel.topic] = messages.get(channel.topic, 0) + count
            schema = summary.schemas.get(channel.schema_id)
            types[channel.topic] = schema.name if schema else ''
        metadata: dict[str, dict[str, str]] = {}
        for record in reader.iter_metadata():
            if record.name != RECORD_NAME:
                metadata.setdefault(record.name, {}).update(record.metadata)
    return Contents(types, messages, metadata)


def read_messages(path: str | Path, topics: Collection[str]) -> Iterator[Message]:
    """Read the messages of some topics in the order of their log times.

    Raises:
        BagError: the path is no bag, the file is damaged, or a message can't be decoded.
    """
    file = find_file(path)
    factory = DecoderFactory()
    with _reader(file) as reader:
        for schema, channel, record in reader.iter_messages(topics=topics):
            decode = factory.decoder_for(channel.message_encoding, schema)
            if decode is None:
                raise BagError(
                    f'{file}: expected CDR messages with a ros2msg definition on {channel.topic}, '
                    f'got {channel.message_encoding} with {schema.encoding if schema else "none"}'
                )
            try:
                content = decode(record.data)
            except _DAMAGE as error:
                raise BagError(
                    f'{file}: a message of {channel.topic} at log time {record.log_time} ns is no '
                    f'{schema.name if schema else "message"}: {_reason(error)}'
                ) from error
            yield Message(channel.topic, record.sequence, record.log_time, content)


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
            verify(stream)
            yield make_reader(stream, validate_crcs=True)
        except BagError:
            raise
        except (*_DAMAGE, OSError) as error:
            raise BagError(
                f'{file}: expected a complete MCAP file, but it is cut off or damaged '
                f'({_reason(error)}): `mcap recover` saves what can be read of it'
            ) from error


def _reason(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def _some(files: list[Path]) -> str:
    names = [file.name for file in files[:_SHOWN]]
    return ', '.join(names) + (', …' if len(files) > _SHOWN else '')
