"""What of a log is replayed, and in which order, without ROS."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from dpc_ros.bag.mcap_file import RawMessage, read_contents, read_raw
from dpc_ros.bag.splits import BagError
from dpc_ros.bag.topic import NANOSECONDS

# Behind the encapsulation header: seconds and nanoseconds of the stamp, where a message begins with
# a std_msgs/Header; the lowest bit of the second byte says that they are little-endian.
_STAMPS = {0: struct.Struct('>4xiI'), 1: struct.Struct('<4xiI')}


@dataclass(frozen=True)
class Excerpt:
    """Which part of a log is replayed.

    Attributes:
        path: folder of the bag, or an MCAP file.
        topics: names of the topics.
        latched: those of which the newest message before the start is replayed, too.
        start_time: recorded time from the log's first message on that is passed over [s].
        duration: recorded time that is replayed [s]; 0 means to the end.
    """

    path: str | Path
    topics: frozenset[str]
    latched: frozenset[str] = frozenset()
    start_time: float = 0.0
    duration: float = 0.0

    def span_ns(self) -> tuple[int, int]:
        """Return the log times of its first and behind its last message [ns].

        Raises:
            BagError: the path is no bag, or the log ends before the start.
        """
        contents = read_contents(self.path)
        start = contents.start_ns + round(self.start_time * NANOSECONDS)
        if start > contents.end_ns:
            length = (contents.end_ns - contents.start_ns) / NANOSECONDS
            raise BagError(
                f'{self.path}: expected a start_time within the log of {length:g} s, got '
                f'{self.start_time:g} s'
            )
        end = start + round(self.duration * NANOSECONDS) if self.duration else contents.end_ns + 1
        return start, end

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Read its messages, or those of some of its topics, in the order of their log times.

        Of equal log times the one that was recorded first comes first.
        """
        start, end = self.span_ns()
        before: dict[str, RawMessage] = {}
        for message in read_raw(self.path, self.topics if topics is None else topics):
            if message.log_time_ns < start:
                if message.topic in self.latched:
                    before[message.topic] = message
                continue
            yield from before.values()
            before.clear()
            if message.log_time_ns >= end:
                return
            yield message
        yield from before.values()


@dataclass(frozen=True, eq=False)
class Step:
    """What is replayed in one step of lockstep.

    Attributes:
        stamp: of the configuration, which `control_force` answers [ns].
        before: messages of other topics that come before it.
        configuration: the message.
    """

    stamp: int
    before: tuple[RawMessage, ...]
    configuration: RawMessage


def lockstep_steps(excerpt: Excerpt, configuration: str, force: str) -> Iterator[Step]:
    """Read the steps of a log that is replayed in lockstep.

    A configuration that was published several times is there once. Where the log has forces, a
    configuration without one is left out: nobody answered it then. What was sent before the force
    of a step comes before its configuration: whatever counted for that force does so again.

    Args:
        excerpt: what is replayed.
        configuration: name of its topic in the log.
        force: likewise of `control_force`.
    """
    others = excerpt.topics - {configuration, force}
    rest = iter(sorted(excerpt.messages(others), key=lambda message: message.publish_time_ns))
    following = next(rest, None)
    answered: dict[int, list[int]] = {}  # by stamp when the forces were sent; a new epoch adds one
    for message in read_raw(excerpt.path, {force}):
        answered.setdefault(stamp_of_header(message), []).append(message.publish_time_ns)
    last: int | None = None
    for message in excerpt.messages({configuration}):
        stamp = stamp_of_header(message)
        times = [time for time in answered.get(stamp, ()) if time >= message.publish_time_ns]
        if stamp == last or (answered and not times):
            continue
        last = stamp
        until = min(times, default=message.publish_time_ns)
        before = []
        while following is not None and following.publish_time_ns <= until:
            before.append(following)
            following = next(rest, None)
        yield Step(stamp, tuple(before), message)


def stamp_of_header(message: RawMessage) -> int:
    """Return the stamp of a message that begins with a `std_msgs/Header` [ns].

    Raises:
        BagError: it is too short to have one.
    """
    try:
        seconds, rest = _STAMPS[message.cdr[1] & 1].unpack_from(message.cdr)
    except (struct.error, IndexError) as error:
        raise BagError(
            f'{message.topic}: expected a message with a header, got {len(message.cdr)} bytes'
        ) from error
    return int(seconds * NANOSECONDS + rest)
