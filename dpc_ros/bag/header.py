"""Stamp and frame_id of a serialised message, without decoding the rest of it."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

from dpc_ros.bag.topic import NANOSECONDS

_HEADER_FIELD = re.compile(r'(std_msgs/)?(msg/)?Header\s+header\b')
_LITTLE_ENDIAN = 1  # in the second byte of the encapsulation header
_STAMP_START = 4  # bytes, of the encapsulation header
_STAMP_SIZE = 12  # bytes, with the length of the frame_id


@dataclass(frozen=True)
class Header:
    """What std_msgs/Header holds.

    Attributes:
        stamp_ns: the stamp [ns].
        frame_id: the frame.
    """

    stamp_ns: int
    frame_id: str


def starts_with_header(definition: str) -> bool:
    """Return whether the first field of a message definition is its header."""
    for line in definition.splitlines():
        content = line.partition('#')[0].strip()
        if content:
            return _HEADER_FIELD.match(content) is not None
    return False


def read_header(cdr: bytes) -> Header | None:
    """Return the header that a message starts with, None where the bytes are none."""
    if len(cdr) < _STAMP_START + _STAMP_SIZE:
        return None
    order = '<' if cdr[1] & _LITTLE_ENDIAN else '>'
    seconds, rest, size = struct.unpack_from(f'{order}iII', cdr, _STAMP_START)
    start = _STAMP_START + _STAMP_SIZE
    # The length counts the zero at the end.
    text = cdr[start : start + size - 1] if size else b''
    return Header(seconds * NANOSECONDS + rest, text.decode(errors='replace'))
