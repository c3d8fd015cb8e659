"""What can be read of an MCAP file that was cut off, never finished, or damaged.

The records of the data section are walked one after the other, without the index at the end. One
that is not sound (its length, its fields and, for chunks and attachments, its check sum must
agree) is a gap, behind which the walk goes on at the next sound record.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    Header,
    McapRecord,
    Message,
    Metadata,
    Schema,
)
from mcap.stream_reader import breakup_chunk
from tqdm import tqdm

from dpc_ros.bag.check_sums import MAGIC, verify_summary
from dpc_ros.bag.mcap_file import DAMAGE, reason

PATIENCE = 2.0  # s before a bar of progress is shown

_FRAME = struct.Struct('<BQ')  # opcode and length of a record
_INDEX = struct.Struct('<HI')  # channel and size of its entries
_INDEX_ENTRY_SIZE = 16  # bytes
_CHECK_SUM_SIZE = 4  # bytes
_READERS: dict[int, type] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}
# Where the walk may go on behind a gap: not at what stands inside of chunks, too, nor at indexes,
# which hold hardly more than numbers. Records of more than 4 GiB are not looked for.
_LANDMARKS = (Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END)
_LANDMARK = re.compile(b'(?=[%s].{4}\0{4})' % re.escape(bytes(_LANDMARKS)), re.DOTALL)
_SUMMARY_START = struct.Struct('<Q')  # in the footer, behind the frame
_FOOTER_SIZE = 20  # bytes, without the frame
_Bytes = bytes | mmap.mmap
_Content = McapRecord | list[McapRecord] | None


class _ExactStream(ReadDataStream):
    """Reads as many bytes as it is told, or fails."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile('a wrong length')
        return data


@dataclass(eq=False)
class Salvage:
    """What a file holds that is sound.

    Attributes:
        path: of the file.
        size: of the file [bytes].
        profile: that the file's header names, `ros2` where it is lost.
        places: first byte and end of each sound chunk, and of each message outside of chunks.
        chunks: number of sound chunks.
        schemas: by their numbers in the file.
        channels: by their numbers in the file.
        messages: number of sound messages of each channel that is known.
        metadata: all records, in their order.
        attachments: first byte and end of each.
        losses: what could not be read, in words; empty for a file that is whole.
    """

    path: Path
    size: int
    profile: str = 'ros2'
    places: list[tuple[int, int]] = field(default_factory=list)
    chunks: int = 0
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: dict[int, int] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    attachments: list[tuple[int, int]] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)

    def read_messages(self) -> Iterator[Message]:
        """Yield the sound messages of the known channels in the order of the file."""
        with _mapped(self.path) as data:
            for start, end in self.places:
                _, record = _record(data, start, end)
                for part in breakup_chunk(record) if isinstance(record, Chunk) else [record]:
                    if isinstance(part, Message) and part.channel_id in self.messages:
                        yield part

    def read_attachments(self) -> Iterator[Attachment]:
        """Yield the sound attachments in the order of the file."""
        with _mapped(self.path) as data:
            for start, end in self.attachments:
                _, record = _record(data, start, end)
                assert isinstance(record, Attachment)
                yield record


def salvage(path: str | Path, progress: bool = False) -> Salvage:
    """Walk a file and note all that is sound in it.

    Raises:
        OSError: the file can't be opened or read.
    """
    path = Path(path)
    found = Salvage(path, path.stat().st_size)
    if found.size == 0:
        found.losses.append('it is empty')
        return found
    bar = tqdm(
        desc=f'reading {path.name}',
        total=found.size,
        unit='B',
        unit_scale=True,
        delay=PATIENCE,
        disable=not progress,
    )
    with _mapped(path) as data, bar:
        _walk(data, found, bar)
    counts, found.messages = found.messages, {}
    for number, count in counts.items():
        channel = found.channels.get(number)
        if channel is None or (channel.schema_id and channel.schema_id not in found.schemas):
            found.losses.append(f'{count} messages of a topic whose description is lost')
        else:
            found.messages[number] = count
    return found


def _walk(data: _Bytes, found: Salvage, bar: tqdm) -> None:
    place = len(MAGIC)
    if data[:place] != MAGIC[: len(data)]:
        found.losses.append('its first bytes are not those of an MCAP file')
    while place < len(data):
        bar.update(place - bar.n)
        sound = _sound_record(data, place)
        if not isinstance(sound, str) and _is_misplaced(sound[-1], found):
            sound = 'a damaged record'
        if isinstance(sound, str):
            following = _next_landmark(data, place + 1)
            found.losses.append(f'bytes {place} to {following}: {sound}')
            place = following
            continue
        end, opcode, record = sound
        if opcode == Opcode.DATA_END:
            _check_end(data, place, end, found)
            return
        _keep(record, place, end, found)
        place = end
    found.losses.append('it was not finished: what the recorder still held is lost')


def _is_misplaced(record: _Content, found: Salvage) -> bool:
    """Return whether a record can't stand there: a message has no check sum outside of a chunk."""
    if not isinstance(record, Message):
        return False
    return found.chunks > 0 or record.channel_id not in found.channels


def _keep(record: _Content, start: int, end: int, found: Salvage) -> None:
    """Note a record of the data section, or those of a chunk."""
    if isinstance(record, list):
        found.chunks += 1
        found.places.append((start, end))
        for part in record:
            _note(part, found)
    elif isinstance(record, Header):
        found.profile = record.profile
    elif isinstance(record, Metadata):
        found.metadata.append(record)
    elif isinstance(record, Attachment):
        found.attachments.append((start, end))
    elif record is not None:
        if isinstance(record, Message):
            found.places.append((start, end))
        _note(record, found)


def _note(record: McapRecord, found: Salvage) -> None:
    if isinstance(record, Schema):
        found.schemas.setdefault(record.id, record)
    elif isinstance(record, Channel):
        found.channels.setdefault(record.id, record)
    elif isinstance(record, Message):
        found.messages[record.channel_id] = found.messages.get(record.channel_id, 0) + 1


def _check_end(data: _Bytes, start: int, end: int, found: Salvage) -> None:
    """Hold a file that reaches its end against its check sums, take the topics of its summary."""
    (expected,) = struct.unpack_from('<I', data, start + _FRAME.size)
    if expected and not found.losses and zlib.crc32(memoryview(data)[:start]) != expected:
        found.losses.append(
            'a check sum is wrong though every chunk is whole: '
            'something outside of them was altered'
        )
    try:
        with found.path.open('rb') as stream:
            verify_summary(stream)
        while end < len(data) - len(MAGIC):
            opcode, length = _FRAME.unpack_from(data, end)
            following = end + _FRAME.size + length
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                _note(_record(data, end, following)[1], found)
            end = following
    except DAMAGE as error:
        found.losses.append(f'its index, but none of its data: {reason(error)}')


def _sound_record(data: _Bytes, place: int) -> tuple[int, int, _Content] | str:
    """Return end, opcode and content of the record at a place, or in words why there is none.

    The content of a chunk is the list of its records; that of an index is left out.
    """
    if place + _FRAME.size > len(data):
        return 'cut off within a record'
    opcode, length = _FRAME.unpack_from(data, place)
    end = place + _FRAME.size + length
    if opcode not in (*_READERS, Opcode.MESSAGE, Opcode.MESSAGE_INDEX, Opcode.DATA_END):
        return 'no record of an MCAP file'
    if end > len(data):
        kind = 'chunk' if opcode == Opcode.CHUNK else 'record'
        return f'a {kind} that is cut off or whose length is wrong'
    if opcode == Opcode.DATA_END:
        return (end, opcode, None) if length == _CHECK_SUM_SIZE else 'a damaged record'
    if opcode == Opcode.MESSAGE_INDEX:
        return (end, opcode, None) if _is_index(data, place, length) else 'a damaged index'
    try:
        read, record = _record(data, place, end)
        if read != length:
            return 'a damaged record'
        if isinstance(record, Attachment):
            (expected,) = struct.unpack_from('<I', data, end - _CHECK_SUM_SIZE)
            content = data[place + _FRAME.size : end - _CHECK_SUM_SIZE]
            if expected and zlib.crc32(content) != expected:
                return 'an attachment whose check sum is wrong'
        if isinstance(record, Chunk):
            return end, opcode, _chunk_records(record)
    except (*DAMAGE, MemoryError) as error:
        kind = 'chunk' if opcode == Opcode.CHUNK else 'record'
        return f'a damaged {kind} ({reason(error)})'
    return end, opcode, record


def _record(data: _Bytes, start: int, end: int) -> tuple[int, McapRecord]:
    """Return how many bytes of a record were read, and what it is."""
    content = data[start + _FRAME.size : end]
    stream = _ExactStream(BytesIO(content))
    if data[start] == Opcode.MESSAGE:
        return len(content), Message.read(stream, len(content))
    record: Any = _READERS[data[start]].read(stream)  # type: ignore[attr-defined]
    return stream.count, record


def _chunk_records(chunk: Chunk) -> list[McapRecord]:
    if chunk.compression == 'zstd':
        # A wrong size must not make it take all memory.
        size = zstandard.get_frame_parameters(chunk.data).content_size
        if size not in (chunk.uncompressed_size, zstandard.CONTENTSIZE_UNKNOWN):
            raise ValueError('its size is wrong')
    elif not chunk.compression and len(chunk.data) != chunk.uncompressed_size:
        raise ValueError('its size is wrong')
    return breakup_chunk(chunk, validate_crc=True)


def _is_index(data: _Bytes, place: int, length: int) -> bool:
    if length < _INDEX.size:
        return False
    _, size = _INDEX.unpack_from(data, place + _FRAME.size)
    return size == length - _INDEX.size and size % _INDEX_ENTRY_SIZE == 0


def _next_landmark(data: _Bytes, place: int) -> int:
    for match in _LANDMARK.finditer(data, place):
        sound = _sound_record(data, match.start())
        if not isinstance(sound, str) and _is_distinct(data, *sound):
            return match.start()
    return len(data)


def _is_distinct(data: _Bytes, end: int, opcode: int, record: _Content) -> bool:
    """Return whether a sound record can't be a few numbers that look like one."""
    if opcode == Opcode.DATA_END:
        footer = len(data) - len(MAGIC) - _FOOTER_SIZE
        return footer >= end and _SUMMARY_START.unpack_from(data, footer) == (end,)
    if isinstance(record, Attachment | Metadata):
        return bool(record.name)
    return bool(record)


@contextmanager
def _mapped(path: Path) -> Iterator[mmap.mmap]:
    with (
        path.open('rb') as stream,
        mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data,
    ):
        yield data
