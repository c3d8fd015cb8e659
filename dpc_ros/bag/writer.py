"""Writing a rosbag2 bag: a folder with one MCAP file and `metadata.yaml`."""

from __future__ import annotations

import os
from pathlib import Path
from types import TracebackType

from mcap.writer import CompressionType, Writer

from dpc_ros import __version__
from dpc_ros.bag.metadata import (
    RECORD_NAME,
    FileSpan,
    bag_content,
    bag_text,
    topic_content,
    write_metadata,
)
from dpc_ros.bag.topic import Topic, qos_text

DEFAULT_CHUNK_SIZE = 256 * 1024  # bytes; what a crash of the recorder can lose at most

_LATEST_NS = 2**63 - 1  # ns, the largest time of ROS 2
_SEQUENCES = 2**32  # MCAP counts messages with 32 bits


class BagWriter:
    """A rosbag2 bag in the making, MCAP profile `ros2`, chunks compressed with zstd.

    Messages come as CDR bytes, as a raw subscription hands them over, and are written as they are.
    A chunk goes to the file when it is full. `close` finishes the file and writes
    `metadata.yaml`; as a context manager the writer does so after an error too. One thread at a
    time may use a writer.

    Args:
        folder: of the bag; it is made, with its parents. The file is `<folder name>_0.mcap`.
        ros_distro: name of the ROS distribution.
        chunk_size: bytes of messages that a chunk collects before compression.

    Raises:
        FileExistsError: the folder exists and is not empty, or is a file.
        ValueError: the chunk size is not positive.
    """

    def __init__(
        self,
        folder: str | Path,
        ros_distro: str = 'jazzy',
        chunk_size: int = DEFAULT_CHUNK_SIZE,
    ) -> None:
        if chunk_size <= 0:
            raise ValueError(f'chunk_size: expected a number of bytes > 0, got {chunk_size}')
        self.folder = Path(folder).resolve()
        if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
            raise FileExistsError(
                f'{self.folder}: expected a new or an empty folder for the bag, '
                'but it holds something: choose another name or remove it'
            )
        self.folder.mkdir(parents=True, exist_ok=True)
        self.path = self.folder / f'{self.folder.name}_0.mcap'
        self._ros_distro = ros_distro
        self._topics: dict[str, Topic] = {}
        self._counts: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, tuple[int, str]] = {}
        self._first_ns = _LATEST_NS
        self._last_ns = 0
        self._stream = self.path.open('xb')
        self._writer = Writer(
            self._stream,
            chunk_size=chunk_size,
            compression=CompressionType.ZSTD,
            enable_crcs=True,
            enable_data_crcs=True,
        )
        self._writer.start(profile='ros2', library=f'dpc_ros {__version__}')

    @property
    def message_counts(self) -> dict[str, int]:
        """Number of messages written to each topic."""
        return dict(self._counts)

    def add_topic(self, topic: Topic) -> None:
        """Announce a topic before its first message; the same topic twice is once.

        Raises:
            ValueError: the bag is closed, has another topic of that name, or knows another
                definition of the type.
        """
        self._check_open()
        if topic.name in self._topics:
            if self._topics[topic.name] != topic:
                raise ValueError(f'{topic.name}: the bag already has another topic of this name')
            return
        self._channels[topic.name] = self._writer.register_channel(
            topic=topic.name,
            message_encoding='cdr',
            schema_id=self._schema(topic),
            metadata={
                'offered_qos_profiles': qos_text(topic.offered_qos_profiles),
                'topic_type_hash': topic.type_hash,
            },
        )
        self._topics[topic.name] = topic
        self._counts[topic.name] = 0

    def write(
        self,
        topic_name: str,
        cdr: bytes,
        log_time_ns: int,
        publish_time_ns: int,
        sequence: int = 0,
    ) -> None:
        """Write one message.

        Args:
            topic_name: of an announced topic.
            cdr: the serialised message, with its encapsulation header.
            log_time_ns: when it was received [ns since the epoch].
            publish_time_ns: when it was sent [ns since the epoch].
            sequence: the publisher's number of the message, kept modulo 2³²; 0 if not known.

        Raises:
            ValueError: the bag is closed, the topic is unknown, or a time is out of range.
        """
        self._check_open()
        if topic_name not in self._channels:
            raise ValueError(
                f'{topic_name}: expected one of the topics {sorted(self._channels)}: add it first'
            )
        for what, time in (('log time', log_time_ns), ('publish time', publish_time_ns)):
            if not 0 <= time <= _LATEST_NS:
                raise ValueError(f'{topic_name}: expected a {what} of 0 to 2⁶³ − 1 ns, got {time}')
        self._writer.add_message(
            channel_id=self._channels[topic_name],
            log_time=log_time_ns,
            data=cdr,
            publish_time=publish_time_ns,
            sequence=sequence % _SEQUENCES,
        )
        self._counts[topic_name] += 1
        self._first_ns = min(self._first_ns, log_time_ns)
        self._last_ns = max(self._last_ns, log_time_ns)

    def add_metadata(self, name: str, content: dict[str, str]) -> None:
        """Write a record of keys and values about the run.

        Raises:
            ValueError: the bag is closed, the name is rosbag2's own, or a value is no text.
        """
        self._check_open()
        if name == RECORD_NAME:
            raise ValueError(f"metadata: the name {name!r} is rosbag2's own, choose another")
        for key, value in content.items():
            if not isinstance(key, str) or not isinstance(value, str):
                raise ValueError(f'metadata {name}: expected texts, got {key!r}: {value!r}')
        self._writer.add_metadata(name, content)

    def close(self) -> None:
        """Finish the MCAP file, then write `metadata.yaml`; a second call does nothing."""
        if self._stream.closed:
            return
        content = self._content()
        with self._stream:
            self._writer.add_metadata(RECORD_NAME, {'serialized_metadata': bag_text(content)})
            self._writer.finish()
            self._stream.flush()
            os.fsync(self._stream.fileno())
        write_metadata(self.folder, content)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _schema(self, topic: Topic) -> int:
        if topic.type_name not in self._schemas:
            number = self._writer.register_schema(
                name=topic.type_name, encoding='ros2msg', data=topic.definition.encode()
            )
            self._schemas[topic.type_name] = number, topic.definition
        number, definition = self._schemas[topic.type_name]
        if definition != topic.definition:
            raise ValueError(
                f'{topic.name}: the bag already has another definition of {topic.type_name}'
            )
        return number

    def _content(self) -> dict:
        empty = not any(self._counts.values())
        file = FileSpan(
            name=self.path.name,
            message_count=sum(self._counts.values()),
            start_ns=0 if empty else self._first_ns,
            end_ns=0 if empty else self._last_ns,
        )
        topics = [
            (
                topic_content(name, topic.type_name, topic.offered_qos_profiles, topic.type_hash),
                self._counts[name],
            )
            for name, topic in self._topics.items()
        ]
        return bag_content([file], topics, self._ros_distro)

    def _check_open(self) -> None:
        if self._stream.closed:
            raise ValueError(f'{self.path}: the bag is closed and takes nothing more')
