"""What a log holds: topics, rates, gaps, losses, models, records, files."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from tqdm import tqdm

from dpc_ros.bag.force_frame import without_controller
from dpc_ros.bag.header import Header, read_header, starts_with_header
from dpc_ros.bag.mcap_file import Contents, RawMessage, read_contents, read_raw
from dpc_ros.bag.metadata import LOSSES_RECORD
from dpc_ros.bag.sequence import Sequence
from dpc_ros.bag.topic import NANOSECONDS

_SHOWN = 60  # characters of a value of a record
_NOTHING = '–'
TOPIC_COLUMNS = ('topic', 'type', 'messages', 'rate [Hz]', 'longest gap [s]', 'lost', 'repeated')


@dataclass(eq=False)
class TopicInformation:
    """What a log has of a topic.

    Attributes:
        type_name: `sensor_msgs/msg/JointState`.
        messages: their number.
        publishers: number of publishers that the log names, 0 where it does not say.
        first_ns: log time of the first message [ns since the epoch].
        last_ns: log time of the last message.
        longest_gap_ns: longest time between two messages.
        lost: messages that the sequence numbers miss, None where there are several publishers or
            the numbers are not known.
        recorded_lost: messages that the recorder itself counted as lost, None where it did not say.
        repeats: messages whose stamp had been there before, None without a header.
        frame_ids: number of messages with each frame_id; `<network>@<digest>` names a model,
            `mass_162@<id>` a controller.
    """

    type_name: str
    messages: int = 0
    publishers: int = 0
    first_ns: int = 0
    last_ns: int = 0
    longest_gap_ns: int = 0
    lost: int | None = None
    recorded_lost: int | None = None
    repeats: int | None = None
    frame_ids: Counter[str] = field(default_factory=Counter)

    @property
    def rate(self) -> float:
        """Messages per second between the first and the last, 0 where there are fewer than two."""
        span = (self.last_ns - self.first_ns) / NANOSECONDS
        return (self.messages - 1) / span if span > 0 else 0.0


@dataclass(frozen=True, eq=False)
class Information:
    """What a log holds.

    Attributes:
        contents: what its summaries say.
        size: of its files [bytes].
        topics: by name.
    """

    contents: Contents
    size: int
    topics: dict[str, TopicInformation]


def inform(path: str | Path, progress: bool = False) -> Information:
    """Read a log once and count.

    Raises:
        BagError: it can't be read.
    """
    contents = read_contents(path)
    counters = {
        name: _Counter(
            TopicInformation(type_name, publishers=contents.publishers[name]),
            starts_with_header(contents.definitions[name]),
        )
        for name, type_name in contents.types.items()
    }
    total = sum(contents.messages.values())
    for message in tqdm(
        read_raw(path), desc='reading', total=total, delay=2, disable=not progress, leave=False
    ):
        counters[message.topic].add(message)
    topics = {name: counters[name].result() for name in sorted(counters)}
    for name, text in contents.metadata.get(LOSSES_RECORD, {}).items():
        if name in topics and text.isdecimal():
            topics[name].recorded_lost = int(text)
    return Information(contents, sum(file.stat().st_size for file in contents.files), topics)


class _Counter:
    """Counts the messages of one topic as they come in."""

    def __init__(self, information: TopicInformation, has_header: bool) -> None:
        self._information = information
        self._has_header = has_header
        self._stamps: set[int] = set()
        self._sequence = Sequence()

    def add(self, message: RawMessage) -> None:
        found = self._information
        if found.messages:
            gap = message.log_time_ns - found.last_ns
            found.longest_gap_ns = max(found.longest_gap_ns, gap)
        else:
            found.first_ns = message.log_time_ns
        found.messages += 1
        found.last_ns = message.log_time_ns
        self._sequence.add(message.sequence, message.publish_time_ns)
        header: Header | None = read_header(message.cdr) if self._has_header else None
        if header is not None:
            found.frame_ids[header.frame_id] += 1
            self._stamps.add(header.stamp_ns)

    def result(self) -> TopicInformation:
        found = self._information
        if self._sequence.is_numbered and found.publishers <= 1:
            found.lost = self._sequence.lost
        if self._has_header:
            found.repeats = sum(found.frame_ids.values()) - len(self._stamps)
        return found


def information_table(information: Information) -> str:
    """Return what a log holds in lines of text."""
    contents = information.contents
    duration = (contents.end_ns - contents.start_ns) / NANOSECONDS
    lines = [
        f'duration    {duration:.3f} s',
        f'size        {information.size / 1e6:.3f} MB in {len(contents.files)} '
        + ('file' if len(contents.files) == 1 else 'files'),
        *(f'file        {file.name}, {file.stat().st_size} bytes' for file in contents.files),
        '',
    ]
    rows = [TOPIC_COLUMNS, *topic_rows(information)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        texts = [cell.ljust(width) for cell, width in zip(row[:2], widths[:2], strict=True)]
        texts += [cell.rjust(width) for cell, width in zip(row[2:], widths[2:], strict=True)]
        lines.append('  '.join(texts))
    for title, frames in (('models', _models), ('controllers', _controllers)):
        found = {name: frames(topic) for name, topic in information.topics.items()}
        shown = [f'  {name}: {", ".join(sorted(each))}' for name, each in found.items() if each]
        lines += ['', title, *shown] if shown else []
    for record, content in contents.metadata.items():
        lines += ['', record, *(f'  {key}: {_brief(value)}' for key, value in content.items())]
    if contents.attachments:
        lines += ['', 'attachments']
        lines += [f'  {a.name}, {a.media_type}, {a.size} bytes' for a in contents.attachments]
    return '\n'.join(lines)


def _models(topic: TopicInformation) -> list[str]:
    """Return the frames that name a network or a checkpoint."""
    return [frame for frame in topic.frame_ids if '@' in without_controller(frame)]


def _controllers(topic: TopicInformation) -> list[str]:
    """Return the frames that name the controller of a force."""
    return [frame for frame in topic.frame_ids if frame != without_controller(frame)]


def topic_rows(information: Information) -> list[tuple[str, ...]]:
    """Return what `TOPIC_COLUMNS` say of each topic, in words."""
    return [_row(name, topic) for name, topic in information.topics.items()]


def _row(name: str, topic: TopicInformation) -> tuple[str, ...]:
    lost = _NOTHING if topic.lost is None else str(topic.lost)
    if topic.recorded_lost is not None and topic.recorded_lost != topic.lost:
        lost += f' (recorder: {topic.recorded_lost})'
    return (
        name,
        topic.type_name,
        str(topic.messages),
        f'{topic.rate:.1f}' if topic.rate else _NOTHING,
        f'{topic.longest_gap_ns / NANOSECONDS:.3f}' if topic.messages > 1 else _NOTHING,
        lost,
        _NOTHING if topic.repeats is None else str(topic.repeats),
    )


def _brief(value: str) -> str:
    """Return a text of one line; of a longer one what it is."""
    lines = value.splitlines()
    if len(lines) <= 1 and len(value) <= _SHOWN:
        return value
    return f'{len(lines)} lines' if len(lines) > 1 else f'{value[: _SHOWN - 1]}…'
