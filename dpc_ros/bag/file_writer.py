"""Writing one MCAP file of a bag: profile `ros2`, zstd chunks, check sums, statistics, index."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from dpc_ros import __version__
from dpc_ros.bag.metadata import RECORD_NAME, BagFile, bag_content, bag_text
from dpc_ros.bag.reserved_stream import ReservedStream
from dpc_ros.bag.topic import Topic, qos_text

_LATEST_NS = 2**63 - 1  # ns, the largest time of ROS 2
_SEQUENCES = 2**32  # MCAP counts messages with 32 bits
# What the end of a file takes, at most [bytes]; a chunk index has an entry for each channel.
_MESSAGE_OVERHEAD = 64  # record, and entry in the message index
_CHUNK_INDEX = 128
_CHUNK_INDEX_ENTRY = 16
_END = 1 << 18  # statistics, footer, rosbag2's record, metadata.yaml


class FileWriter:
    """One MCAP file in the making, complete in itself.

    Each chunk goes to the operating system whole. Space for the chunk in progress and for the end
    of the file is set aside on the disk, so that a file can be finished on a full one.

    Args:
        path: of the file, which must not exist.
        chunk_size: bytes of messages that a chunk collects before compression.

    Attributes:
        path: of the file.
        message_count: messages written.
        first_ns: earliest log time [ns since the epoch].

    Raises:
        OSError: the file can't be made.
    """

    def __init__(self, path: Path, chunk_size: int) -> None:
        self.path = path
        self._chunk_size = chunk_size
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._counts: dict[Topic, int] = {}
        self._topics: dict[str, Topic] = {}
        self._described = 0  # bytes of schemas and channels, which the summary repeats
        self._chunks = 0  # an upper bound of their number
        self._pending = 0  # bytes in the chunk in progress
        self._unsynced = True
        self._broken = False
        self.message_count = 0
        self.first_ns = _LATEST_NS
        self._last_ns = 0
        self._stream = ReservedStream(path)
        self._writer = Writer(
            self._stream,  # type: ignore[arg-type]  # write, tell and flush is all it asks for
            chunk_size=chunk_size,
            compression=CompressionType.ZSTD,
            enable_crcs=True,
            enable_data_crcs=True,
        )
        try:
            self._make_room(0)
            self._writer.start(profile='ros2', library=f'dpc_ros {__version__}')
            _sync_folder(path.parent)
        except OSError:
            self._stream.close()
            path.unlink()
            raise

    @property
    def closed(self) -> bool:
        """Whether the file takes nothing more."""
        return self._stream.closed

    @property
    def size(self) -> int:
        """Bytes of the file, as if the chunk in progress could not be compressed."""
        return self._stream.tell() + self._pending

    @property
    def summary(self) -> BagFile:
        """What `metadata.yaml` says of the file."""
        filled = self.message_count > 0
        return BagFile(
            name=self.path.name,
            counts=dict(self._counts),
            starting_time_ns=self.first_ns if filled else 0,
            duration_ns=self._last_ns - self.first_ns if filled else 0,
        )

    def add_topic(self, topic: Topic) -> None:
        """Announce a topic, which is new to the file."""
        if topic.type_name not in self._schemas:
            self._schemas[topic.type_name] = self._writer.register_schema(
                name=topic.type_name, encoding='ros2msg', data=topic.definition.encode()
            )
            self._described += len(topic.definition)
        metadata = {
            'offered_qos_profiles': qos_text(topic.offered_qos_profiles),
            'topic_type_hash': topic.type_hash,
        }
        self._channels[topic.name] = self._writer.register_channel(
            topic=topic.name,
            message_encoding='cdr',
            schema_id=self._schemas[topic.type_name],
            metadata=metadata,
        )
        self._described += len(topic.name) + sum(map(len, metadata.values())) + _CHUNK_INDEX
        self._topics[topic.name] = topic
        self._counts[topic] = 0

    def write(
        self, topic_name: str, cdr: bytes, log_time_ns: int, publish_time_ns: int, sequence: int
    ) -> None:
        """Write one message; see `BagWriter.write`.

        Raises:
            ValueError: a time is out of range.
            OSError: the disk is full or refuses.
        """
        for what, time in (('log time', log_time_ns), ('publish time', publish_time_ns)):
            if not 0 <= time <= _LATEST_NS:
                raise ValueError(f'{topic_name}: expected a {what} of 0 to 2⁶³ − 1 ns, got {time}')
        size = len(cdr) + _MESSAGE_OVERHEAD
        self._make_room(size)
        position = self._stream.tell()
        self._guarded(
            self._writer.add_message,
            channel_id=self._channels[topic_name],
            log_time=log_time_ns,
            data=cdr,
            publish_time=publish_time_ns,
            sequence=sequence % _SEQUENCES,
        )
        self._pending += size
        self._unsynced = True
        self.message_count += 1
        self._counts[self._topics[topic_name]] += 1
        self.first_ns = min(self.first_ns, log_time_ns)
        self._last_ns = max(self._last_ns, log_time_ns)
        if self._stream.tell() > position:
            self._note_chunk()
        self._check_full()

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Write a record of keys and values.

        Raises:
            OSError: the disk is full or refuses.
        """
        self._guarded(self._writer.add_metadata, name, dict(content))
        self._unsynced = True
        self._check_full()

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Write a file into the file.

        Raises:
            OSError: the disk is full or refuses.
        """
        self._make_room(len(data))
        self._guarded(
            self._writer.add_attachment,
            create_time=0,
            log_time=time_ns,
            name=name,
            media_type=media_type,
            data=data,
        )
        self._unsynced = True
        self._check_full()

    def sync(self) -> None:
        """Close the chunk in progress and return when all of the file is on the disk.

        Raises:
            OSError: the disk is full or refuses.
        """
        if not self._unsynced:
            return
        self._guarded(self._writer.flush)
        self._note_chunk()
        self._guarded(self._stream.sync)
        self._unsynced = False
        self._check_full()

    def finish(self, records: Mapping[str, Mapping[str, str]], ros_distro: str) -> bool:
        """Write last records and the end of the file, and close it.

        A file that could not be written any more keeps its complete chunks and gets no end.

        Returns:
            whether the file is complete.

        Raises:
            OSError: the disk refuses now.
        """
        try:
            if not self._broken:
                for name, content in records.items():
                    self._writer.add_metadata(name, dict(content))
                text = bag_text(bag_content([self.summary], ros_distro))
                self._writer.add_metadata(RECORD_NAME, {'serialized_metadata': text})
                self._writer.finish()
                self._stream.sync()
        finally:
            self._stream.close()
        return not self._broken

    def _guarded(self, action: Callable[..., Any], *arguments: Any, **named: Any) -> None:
        """Let the MCAP writer act; after a write that failed it must not go on."""
        try:
            action(*arguments, **named)
        except OSError:
            self._broken = True
            raise

    def _note_chunk(self) -> None:
        self._pending = 0
        self._chunks += 1

    def _needed(self, size: int) -> int:
        """Return the bytes that a chunk with one more part and the end of the file can take."""
        index = self._chunks * (_CHUNK_INDEX + _CHUNK_INDEX_ENTRY * len(self._channels))
        return 2 * self._chunk_size + size + index + self._described + _END

    def _make_room(self, size: int) -> None:
        needed = self._needed(size)
        if needed > self._stream.reserved:
            self._stream.reserve(needed + needed // 4)

    def _check_full(self) -> None:
        if self._stream.full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _sync_folder(folder: Path) -> None:
    """Return when the names in a folder are on the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
