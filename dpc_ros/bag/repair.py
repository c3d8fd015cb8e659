"""A valid bag out of one that was cut off, never finished, or damaged."""

from __future__ import annotations

import os
import re
import shutil
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.writer import CompressionType, Writer
from tqdm import tqdm

from dpc_ros import __version__
from dpc_ros.bag.mcap_file import Contents, read_contents, read_raw
from dpc_ros.bag.metadata import (
    FILE_NAME,
    RECORD_NAME,
    BagFile,
    bag_content,
    bag_text,
    file_names,
    read_metadata,
    write_metadata,
)
from dpc_ros.bag.salvage import PATIENCE, Salvage, salvage
from dpc_ros.bag.splits import BagError, find_splits
from dpc_ros.bag.topic import Topic, offered_profiles
from dpc_ros.bag.writer import DEFAULT_CHUNK_SIZE
from dpc_ros.files import new_folder, replacing

_SUFFIX = '.mcap'
_DISTRO = re.compile(r'^ros_distro: (\w+)$', re.MULTILINE)
_LATEST_NS = 2**63 - 1  # ns, the largest time of ROS 2


class NothingReadableError(BagError):
    """A bag of which nothing can be saved."""


@dataclass(frozen=True)
class RepairedFile:
    """What became of one MCAP file.

    Attributes:
        name: of the file that was read.
        messages: number of messages that the result has of it.
        chunks: number of sound chunks that they were in.
        size: of the file that was read [bytes].
        losses: what was lost, in words; empty for a file that was whole and is copied as it is.
        is_kept: whether the result has a file of it.
    """

    name: str
    messages: int
    chunks: int
    size: int
    losses: tuple[str, ...]
    is_kept: bool


def repair(
    source: str | Path, target: str | Path, progress: bool = False
) -> tuple[RepairedFile, ...]:
    """Write all that can be read of a bag into a new one, and read that back.

    Every sound chunk is taken, of a damaged or incomplete one nothing. A file that is whole is
    copied byte by byte.

    Args:
        source: folder of a bag, with or without its `metadata.yaml`, or an MCAP file.
        target: folder to write, or an `.mcap` file where the source is a file.
        progress: show a bar.

    Returns:
        what became of each file, in their order; then those that are missing, and `metadata.yaml`
        where it was not as it should be.

    Raises:
        BagError: the source is no bag.
        NothingReadableError: nothing at all can be saved; nothing is written.
        FileExistsError: the target exists.
        OSError: it can't be written, or not be read back as it was written.
    """
    source, target = Path(source), Path(target)
    if os.path.lexists(target):
        raise FileExistsError(
            f'{target}: expected a new place for the repaired bag, but it exists: name another'
        )
    if source.is_dir() and target.suffix == _SUFFIX:
        raise ValueError(f'{target}: expected a folder for the bag in the folder {source}')
    found = [
        _examine(path, progress)
        for path in ((source,) if source.is_file() else find_splits(source))
    ]
    usable = [each for each in found if _is_usable(each)]
    if not usable:
        raise NothingReadableError(
            f'{source}: expected at least one complete chunk or record of an MCAP file, but '
            f'{found[0].losses[0]}: nothing of it can be saved'
        )
    distro = _ros_distro(source, usable)
    if target.suffix == _SUFFIX:
        with replacing(target) as partial:
            _write_file(usable[0], partial, distro, progress)
    else:
        with new_folder(target) as folder:
            _write_folder(usable, folder, distro, progress)
    return (
        *(
            RepairedFile(
                name=each.path.name,
                messages=sum(each.messages.values()),
                chunks=each.chunks,
                size=each.size,
                losses=tuple(each.losses),
                is_kept=each in usable,
            )
            for each in found
        ),
        *_missing(source, found),
    )


def _examine(path: Path, progress: bool) -> Salvage:
    found = salvage(path, progress)
    if not found.losses:
        try:
            _read_back(path, found)
        except BagError as error:
            found.losses.append(f'its index, but none of its data: {error}')
    return found


def _is_usable(found: Salvage) -> bool:
    records = [record for record in found.metadata if record.name != RECORD_NAME]
    return not found.losses or bool(found.messages or records or found.attachments)


def _missing(source: Path, found: Sequence[Salvage]) -> list[RepairedFile]:
    """Return what the table of contents names and the folder lacks, and itself if it is wrong."""
    if not source.is_dir():
        return []
    names = _listed(source)
    files = [
        RepairedFile(name, 0, 0, 0, ('it is missing',), False)
        for name in names
        if not (source / name).is_file()
    ]
    if names != [each.path.name for each in found]:
        loss = 'it was missing or named other files: it is written anew'
        files.append(RepairedFile(FILE_NAME, 0, 0, 0, (loss,), True))
    return files


def _listed(folder: Path) -> list[str]:
    with suppress(OSError, ValueError):
        return file_names(folder)
    return []


def _ros_distro(source: Path, found: Sequence[Salvage]) -> str:
    """Return the distribution that the bag's own metadata name, empty where they are lost."""
    with suppress(OSError, ValueError):
        return str(read_metadata(source).get('ros_distro', ''))
    for each in found:
        for record in each.metadata:
            text = record.metadata.get('serialized_metadata', '')
            if record.name == RECORD_NAME and (match := _DISTRO.search(text)):
                return match.group(1)
    return ''


def _write_folder(found: Sequence[Salvage], folder: Path, distro: str, progress: bool) -> None:
    files = [_write_file(each, folder / each.path.name, distro, progress) for each in found]
    source = found[0].path.parent
    if not any(each.losses for each in found) and _listed(source) == [file.name for file in files]:
        shutil.copyfile(source / FILE_NAME, folder / FILE_NAME)
    else:
        write_metadata(folder, bag_content(files, distro))


def _write_file(found: Salvage, path: Path, distro: str, progress: bool) -> BagFile:
    """Write the file of a salvage, read it back, and return what `metadata.yaml` says of it."""
    if found.losses:
        with path.open('xb') as stream:
            _rewrite(found, stream, distro, progress)
            stream.flush()
            os.fsync(stream.fileno())
        again = salvage(path, progress)
        if again.losses or _counts(again) != _counts(found):
            raise OSError(
                f'{path}: expected to read what was written, but lost {"; ".join(again.losses)}: '
                'check the disk'
            )
    else:
        shutil.copyfile(found.path, path)
    contents = _read_back(path, found)
    duration = contents.end_ns - contents.start_ns
    return BagFile(found.path.name, _topic_counts(found), contents.start_ns, duration)


def _rewrite(found: Salvage, stream: BinaryIO, distro: str, progress: bool) -> None:
    writer = Writer(
        stream,
        chunk_size=DEFAULT_CHUNK_SIZE,
        compression=CompressionType.ZSTD,
        enable_crcs=True,
        enable_data_crcs=True,
    )
    writer.start(profile=found.profile, library=f'dpc_ros {__version__}')
    for record in found.metadata:
        if record.name != RECORD_NAME:
            writer.add_metadata(record.name, record.metadata)
    schemas = {0: 0} | {
        number: writer.register_schema(schema.name, schema.encoding, schema.data)
        for number, schema in found.schemas.items()
    }
    channels = {
        number: writer.register_channel(
            channel.topic, channel.message_encoding, schemas[channel.schema_id], channel.metadata
        )
        for number, channel in found.channels.items()
        if channel.schema_id in schemas
    }
    start, end = _LATEST_NS, 0
    total = sum(found.messages.values())
    name = found.path.name
    bar = tqdm(
        found.read_messages(),
        desc=f'writing {name}',
        total=total,
        delay=PATIENCE,
        disable=not progress,
    )
    for message in bar:
        writer.add_message(
            channels[message.channel_id],
            message.log_time,
            message.data,
            message.publish_time,
            message.sequence,
        )
        start, end = min(start, message.log_time), max(end, message.log_time)
    for attachment in found.read_attachments():
        writer.add_attachment(**vars(attachment))
    start = start if total else 0
    content = bag_content([BagFile(name, _topic_counts(found), start, end - start)], distro)
    writer.add_metadata(RECORD_NAME, {'serialized_metadata': bag_text(content)})
    writer.finish()


def _read_back(path: Path, found: Salvage) -> Contents:
    """Read a file to its end by its index.

    Raises:
        BagError: it is not readable, or does not hold just what was found.
    """
    contents = read_contents(path)
    counts = Counter(message.topic for message in read_raw(path))
    announced = {topic: count for topic, count in contents.messages.items() if count}
    if not counts == announced == _counts(found):
        raise BagError(
            f'{path}: expected {_counts(found)} messages, got {dict(counts)} of {announced}'
        )
    if len(contents.attachments) != len(found.attachments):
        raise BagError(
            f'{path}: expected {len(found.attachments)} attachments, '
            f'got {len(contents.attachments)}'
        )
    return contents


def _counts(found: Salvage) -> dict[str, int]:
    counts: Counter[str] = Counter()
    for number, count in found.messages.items():
        counts[found.channels[number].topic] += count
    return dict(counts)


def _topic_counts(found: Salvage) -> dict[Topic, int]:
    """Return the number of messages of each topic; what is none of ROS stands in the file alone."""
    counts = _counts(found)
    topics: dict[str, Topic] = {}
    for channel in found.channels.values():
        schema = found.schemas.get(channel.schema_id)
        with suppress(ValueError):
            topics[channel.topic] = Topic(
                name=channel.topic,
                type_name=schema.name if schema else '',
                definition=schema.data.decode(errors='replace') if schema else '',
                offered_qos_profiles=offered_profiles(channel.metadata),
                type_hash=channel.metadata.get('topic_type_hash', ''),
            )
    return {topic: counts.get(name, 0) for name, topic in topics.items()}
