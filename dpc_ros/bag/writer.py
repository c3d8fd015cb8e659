"""Writing a rosbag2 bag: a folder with MCAP files and `metadata.yaml`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from types import TracebackType

from dpc_ros.bag.file_writer import FileWriter
from dpc_ros.bag.metadata import (
    LOSSES_RECORD,
    RECORD_NAME,
    BagFile,
    bag_content,
    write_metadata,
)
from dpc_ros.bag.topic import Topic

DEFAULT_CHUNK_SIZE = 512 * 1024  # bytes


class BagWriter:
    """A rosbag2 bag in the making, MCAP profile `ros2`, chunks compressed with zstd.

    Messages come as CDR bytes, as a raw subscription hands them over, and are written as they are.
    A chunk goes to the file when it is full, or by `sync`, which waits until it is on the disk.
    `close` finishes the file and writes `metadata.yaml`; as a context manager the writer does so
    after an error too. One thread at a time may use a writer.

    The files are `<folder name>_0.mcap`, `_1.mcap`, …; each has the schemas, the topics so far and
    all records of keys and values, so that it can be read alone. Attachments stand only once.

    When the disk is full, space that was set aside takes what had come and the end of the file:
    what was asked for raises, and `close` finishes the bag. Where even that is refused, the last
    file keeps its complete chunks, has no end, and there is no `metadata.yaml`.

    Args:
        folder: of the bag; it is made, with its parents.
        ros_distro: name of the ROS distribution.
        chunk_size: bytes of messages that a chunk collects before compression.
        split_size: bytes at which a file gives way to the next; 0 is never.
        split_duration_ns: log time [ns] after which a file gives way to the next; 0 is never.

    Raises:
        FileExistsError: the folder exists and is not empty, or is a file.
        ValueError: the chunk size is not positive, or a limit is negative.
        OSError: the folder or the file can't be made.
    """

    def __init__(
        self,
        folder: str | Path,
        ros_distro: str = 'jazzy',
        chunk_size: int = DEFAULT_CHUNK_SIZE,
        split_size: int = 0,
        split_duration_ns: int = 0,
    ) -> None:
        if chunk_size <= 0:
            raise ValueError(f'chunk_size: expected a number of bytes > 0, got {chunk_size}')
        for what, limit in (('split_size', split_size), ('split_duration_ns', split_duration_ns)):
            if limit < 0:
                raise ValueError(f'{what}: expected 0 or more, got {limit}')
        self.folder = Path(folder).resolve()
        if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
            raise FileExistsError(
                f'{self.folder}: expected a new or an empty folder for the bag, '
                'but it holds something: choose another name or remove it'
            )
        self.folder.mkdir(parents=True, exist_ok=True)
        self._ros_distro = ros_distro
        self._chunk_size = chunk_size
        self._split_size = split_size
        self._split_duration_ns = split_duration_ns
        self._topics: dict[str, Topic] = {}
        self._definitions: dict[str, str] = {}
        self._records: list[tuple[str, dict[str, str]]] = []
        self._lost: Counter[str] = Counter()
        self._complete: list[BagFile] = []
        self._closed = False
        self._start_file()

    @property
    def message_counts(self) -> dict[str, int]:
        """Number of messages written to each topic."""
        counts = Counter(dict.fromkeys(self._topics, 0))
        for file in [*self._complete, *([] if self._file.closed else [self._file.summary])]:
            counts.update({topic.name: count for topic, count in file.counts.items()})
        return dict(counts)

    @property
    def is_whole(self) -> bool:
        """Whether the bag is closed and every file of it has its end."""
        return self._closed and self._file.path.name in {file.name for file in self._complete}

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
        if self._definitions.setdefault(topic.type_name, topic.definition) != topic.definition:
            raise ValueError(
                f'{topic.name}: the bag already has another definition of {topic.type_name}'
            )
        self._file.add_topic(topic)
        self._topics[topic.name] = topic

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
            OSError: the disk is full or refuses.
        """
        self._check_open()
        if topic_name not in self._topics:
            raise ValueError(
                f'{topic_name}: expected one of the topics {sorted(self._topics)}: add it first'
            )
        if self._is_full(len(cdr), log_time_ns):
            self._finish_file()
            self._start_file()
        self._file.write(topic_name, cdr, log_time_ns, publish_time_ns, sequence)

    def count_lost(self, topic_name: str, number: int) -> None:
        """Note messages that never came, 0 to say so; the sums stand at the end of each file."""
        self._lost[topic_name] += number

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Write a record of keys and values about the run.

        Raises:
            ValueError: the bag is closed, the name is one that the writer itself gives, or a value
                is no text.
            OSError: the disk is full or refuses.
        """
        self._check_open()
        if name in (RECORD_NAME, LOSSES_RECORD):
            owner = "rosbag2's own" if name == RECORD_NAME else 'that of the losses'
            raise ValueError(f'metadata: the name {name!r} is {owner}, choose another')
        for key, value in content.items():
            if not isinstance(key, str) or not isinstance(value, str):
                raise ValueError(f'metadata {name}: expected texts, got {key!r}: {value!r}')
        self._records.append((name, dict(content)))
        self._file.add_metadata(name, content)

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Write a whole file into the bag.

        Args:
            name: of the attachment.
            media_type: of its content, `application/json`.
            data: its content.
            time_ns: when it was put in [ns since the epoch].

        Raises:
            ValueError: the bag is closed.
            OSError: the disk is full or refuses.
        """
        self._check_open()
        self._file.add_attachment(name, media_type, data, time_ns)

    def sync(self) -> None:
        """Close the chunk in progress and return when all that was written is on the disk.

        Raises:
            ValueError: the bag is closed.
            OSError: the disk is full or refuses.
        """
        self._check_open()
        self._file.sync()

    def close(self) -> None:
        """Finish the MCAP file, then write `metadata.yaml`; a second call does nothing.

        Raises:
            OSError: the disk refuses the end of the file, or `metadata.yaml`.
        """
        if self._closed:
            return
        self._closed = True
        if not self._file.closed:
            self._finish_file()
        if self.is_whole:
            write_metadata(self.folder, bag_content(self._complete, self._ros_distro))

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _is_full(self, size: int, log_time_ns: int) -> bool:
        file = self._file
        if not file.message_count:
            return False
        too_large = 0 < self._split_size < file.size + size
        return too_large or 0 < self._split_duration_ns <= log_time_ns - file.first_ns

    def _start_file(self) -> None:
        path = self.folder / f'{self.folder.name}_{len(self._complete)}.mcap'
        self._file = FileWriter(path, self._chunk_size)
        for topic in self._topics.values():
            self._file.add_topic(topic)
        for name, content in self._records:
            self._file.add_metadata(name, content)

    def _finish_file(self) -> None:
        losses = {topic: str(number) for topic, number in sorted(self._lost.items())}
        if self._file.finish({LOSSES_RECORD: losses} if losses else {}, self._ros_distro):
            self._complete.append(self._file.summary)

    def _check_open(self) -> None:
        if self._file.closed:
            raise ValueError(f'{self.folder}: the bag is closed and takes nothing more')


def further_folder(folder: Path) -> Path:
    """Return the first of `<folder>_1`, `<folder>_2`, … that does not exist yet."""
    further = (folder.with_name(f'{folder.name}_{number}') for number in count(1))
    return next(each for each in further if not each.exists())
