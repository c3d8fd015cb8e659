"""Where two logs differ: per topic the first difference and the largest, and the parameters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from tqdm import tqdm

from dpc_ros.bag.fields import fields, stamp_ns
from dpc_ros.bag.force_frame import without_controller
from dpc_ros.bag.mcap_file import Contents, Message, read_contents, read_messages
from dpc_ros.bag.metadata import NODE_PARAMETERS_RECORD, PARAMETERS_RECORD

_PARAMETERS_KEY = 'ros__parameters'
_FRAME = 'header.frame_id'
_RECORDER = 'recorder'  # the node whose parameters say how a log is kept, not what ran

_Key = tuple[int, ...]  # epoch, stamp [ns], number among those of the stamp; number in the topic


@dataclass(frozen=True)
class Difference:
    """A field that two messages of one stamp do not have in common.

    Attributes:
        index: of the message among those that both logs have, in the order of the first one.
        stamp_ns: of its header [ns], None where it has none.
        field: name, with the place in it where it is an array.
        first: value in the first log.
        second: value in the second log.
    """

    index: int
    stamp_ns: int | None
    field: str
    first: Any
    second: Any


@dataclass(frozen=True)
class Deviation:
    """The largest deviation of a numeric field over all messages of a topic.

    Attributes:
        absolute: largest |a − b|; infinite where only one of the two is a number.
        relative: the same over the largest |a| of that field in the first log.
    """

    absolute: float
    relative: float


@dataclass(eq=False)
class TopicComparison:
    """What two logs have of a topic.

    Attributes:
        topic: its name.
        types: its type in each log, empty where it is not there.
        messages: number in each log, repeats included.
        distinct: number in each log without the repeats.
        only: of these, how many have no counterpart in the other log.
        different: number of messages that differ by more than the tolerance.
        first: the first of these differences.
        deviations: of each numeric field that deviates at all.
    """

    topic: str
    types: tuple[str, str]
    messages: tuple[int, int]
    distinct: tuple[int, int] = (0, 0)
    only: tuple[int, int] = (0, 0)
    different: int = 0
    first: Difference | None = None
    deviations: dict[str, Deviation] = field(default_factory=dict)

    @property
    def is_equal(self) -> bool:
        """Whether both logs have the same, up to the tolerance and to repeats."""
        return self.types[0] == self.types[1] and not any(self.only) and not self.different


@dataclass(frozen=True, eq=False)
class Comparison:
    """What two logs have in common and what not.

    Attributes:
        topics: of either log, by name.
        parameters: values in each log of the parameters that differ, None where one is not there.
        metadata: the same for keys of the other records of keys and values.
    """

    topics: list[TopicComparison]
    parameters: dict[str, tuple[Any, Any]]
    metadata: dict[str, tuple[str | None, str | None]]

    @property
    def is_equal(self) -> bool:
        """Whether the same ran: all messages, and all parameters but those of the recorder."""
        nodes = {name.partition('.')[0].rpartition('/')[2] for name in self.parameters}
        return all(topic.is_equal for topic in self.topics) and nodes <= {_RECORDER}


def compare(
    first: str | Path, second: str | Path, tolerance: float = 0.0, progress: bool = False
) -> Comparison:
    """Hold two logs against each other.

    A message that says the one before again, bit for bit, is left out. Of the others those of the
    same epoch, header stamp and number among those of that stamp belong together; those without a
    header are counted through. An epoch ends where a stamp falls back. Which controller a force
    comes from does not count: each process of one draws a new id. One topic of the first log at a
    time is held in memory.

    Args:
        first: folder of a bag, or an MCAP file.
        second: likewise.
        tolerance: deviation of a number that counts as none, relative to the largest magnitude of
            its field in the first log.
        progress: show a bar.

    Raises:
        BagError: one of them can't be read.
        ValueError: the tolerance is negative.
    """
    if not tolerance >= 0:
        raise ValueError(f'tolerance: expected a number ≥ 0, got {tolerance}')
    contents = read_contents(first), read_contents(second)
    names = sorted({*contents[0].types, *contents[1].types})
    topics = [
        _compare_topic(name, (first, second), contents, tolerance)
        for name in tqdm(names, desc='comparing', delay=2, disable=not progress, leave=False)
    ]
    parameters = _parameters(contents[0]), _parameters(contents[1])
    records = _records(contents[0]), _records(contents[1])
    return Comparison(topics, _different(*parameters), _different(*records))


def _compare_topic(
    name: str,
    paths: tuple[str | Path, str | Path],
    contents: tuple[Contents, Contents],
    tolerance: float,
) -> TopicComparison:
    result = TopicComparison(
        topic=name,
        types=(contents[0].types.get(name, ''), contents[1].types.get(name, '')),
        messages=(contents[0].messages.get(name, 0), contents[1].messages.get(name, 0)),
    )
    logged = {key: _fields(message) for key, message in _distinct(paths[0], name)}
    scales = _scales(logged.values())
    order = {key: index for index, key in enumerate(logged)}
    common = set()
    count = 0
    for key, message in _distinct(paths[1], name):
        count += 1
        if key not in logged:
            continue
        common.add(key)
        found = _compare_message(logged[key], _fields(message), scales, tolerance, result)
        if found is not None:
            result.different += 1
            if result.first is None or order[key] < result.first.index:
                stamp = stamp_ns(message.content)
                result.first = Difference(order[key], stamp, *found)
    result.distinct = len(logged), count
    result.only = len(logged) - len(common), count - len(common)
    return result


def _distinct(path: str | Path, topic: str) -> Iterator[tuple[_Key, Message]]:
    """Yield the messages of a topic without repeats, each with what it is found by."""
    epoch, last, said = 0, 0, b''
    counts: Counter[int] = Counter()  # of each stamp of the epoch
    for number, message in enumerate(read_messages(path, [topic])):
        stamp = stamp_ns(message.content)
        if stamp is None:
            yield (number,), message
            continue
        saying = _said(message)
        if saying == said:
            continue
        if stamp < last:
            epoch += 1
            counts.clear()
        last, said = stamp, saying
        yield (epoch, stamp, counts[stamp]), message
        counts[stamp] += 1


def _said(message: Message) -> bytes:
    """Return the bytes of a message with a header without the controller that it names."""
    frame_id = getattr(message.content.header, 'frame_id', '')
    controller = frame_id.removeprefix(without_controller(frame_id))
    return message.cdr.replace(controller.encode(), b'', 1) if controller else message.cdr


def _fields(message: Message) -> dict[str, Any]:
    found = fields(message.content)
    if isinstance(found.get(_FRAME), str):
        found[_FRAME] = without_controller(found[_FRAME])
    return found


def _scales(messages: Any) -> dict[str, float]:
    scales: dict[str, float] = {}
    for message in messages:
        for name, value in message.items():
            if _is_numeric(value) and np.size(value):
                magnitude = np.abs(np.asarray(value, dtype=float))
                largest = magnitude.max(initial=0.0, where=np.isfinite(magnitude))
                scales[name] = max(scales.get(name, 0.0), float(largest))
    return scales


def _compare_message(
    first: dict[str, Any],
    second: dict[str, Any],
    scales: dict[str, float],
    tolerance: float,
    result: TopicComparison,
) -> tuple[str, Any, Any] | None:
    """Note the deviations of a message and return its first field that differs, if there is one."""
    different: tuple[str, Any, Any] | None = None
    for name in dict.fromkeys((*first, *second)):
        a: Any = first.get(name)
        b: Any = second.get(name)
        if not (_is_numeric(a) and _is_numeric(b)):
            if _plain(a) != _plain(b):
                different = different or (name, a, b)
            continue
        if np.shape(a) != np.shape(b):
            sizes = f'{np.size(a)} values', f'{np.size(b)} values'
            different = different or (name, *sizes)
            continue
        deviation = _deviation(a, b)
        largest = float(deviation.max(initial=0.0))
        if largest == 0:
            continue
        scale = scales.get(name, 0.0)
        relative = largest / scale if scale else np.inf
        known = result.deviations.get(name, Deviation(0.0, 0.0))
        result.deviations[name] = Deviation(
            max(known.absolute, largest), max(known.relative, relative)
        )
        if relative > tolerance and different is None:
            place = int(np.argmax(deviation > tolerance * scale))
            where = f'{name}[{place}]' if np.ndim(a) else name
            different = where, np.ravel(a)[place].item(), np.ravel(b)[place].item()
    return different


def _plain(value: Any) -> Any:
    """Return a list for an array: an empty list of texts can't be told from one of numbers."""
    return value.tolist() if isinstance(value, np.ndarray) else value


def _is_numeric(value: Any) -> bool:
    return np.asarray(value).dtype.kind in 'biuf' if value is not None else False


def _deviation(a: Any, b: Any) -> np.ndarray:
    """Return |a − b| of each element: 0 where both are no number, infinite where one is none."""
    first, second = np.ravel(a), np.ravel(b)
    if first.dtype.kind in 'biu' and second.dtype.kind in 'biu':
        # Exact beyond 2⁵³, too.
        return np.abs(first.astype(object) - second.astype(object)).astype(float)
    first, second = first.astype(float), second.astype(float)
    with np.errstate(all='ignore'):
        deviation = np.abs(first - second)
    deviation[np.isnan(deviation)] = np.inf
    deviation[(first == second) | (np.isnan(first) & np.isnan(second))] = 0.0
    return deviation


def _parameters(contents: Contents) -> dict[str, Any]:
    """Return every parameter that a log holds, by node and name."""
    texts = [contents.metadata.get(PARAMETERS_RECORD, {}).get('yaml', '')]
    texts += contents.metadata.get(NODE_PARAMETERS_RECORD, {}).values()
    found: dict[str, Any] = {}
    for text in texts:
        try:
            sections = yaml.safe_load(text) or {}
            for section, content in sections.items():
                node = section.strip('/*') or section
                _flatten(content[_PARAMETERS_KEY], node, found)
        # What another recorder wrote there: it is compared as a text.
        except (yaml.YAMLError, AttributeError, LookupError, TypeError, RecursionError):
            found[PARAMETERS_RECORD] = text
    return found


def _flatten(content: Any, name: str, found: dict[str, Any]) -> None:
    if isinstance(content, dict):
        for key, value in content.items():
            _flatten(value, f'{name}.{key}', found)
    else:
        found[name] = content


def _records(contents: Contents) -> dict[str, str]:
    return {
        f'{record}.{key}': value
        for record, content in contents.metadata.items()
        if record not in (PARAMETERS_RECORD, NODE_PARAMETERS_RECORD)
        for key, value in content.items()
    }


def _different(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    return {
        name: (first.get(name), second.get(name))
        for name in dict.fromkeys((*first, *second))
        if first.get(name) != second.get(name)
    }
