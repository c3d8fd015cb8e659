"""Check sums of an MCAP file that its reader leaves unchecked: summary and whole data.

The layout is that of the MCAP specification: data, DataEnd record, summary, footer, magic.
"""

from __future__ import annotations

import os
import struct
import zlib
from typing import BinaryIO

MAGIC = b'\x89MCAP0\r\n'  # the first and the last bytes of a file
_FOOTER = struct.Struct('<BQQQI')  # opcode, length, start of summary and of its offsets, check sum
_DATA_END = struct.Struct('<BQI')  # opcode, length, check sum
_CHECK_SUM_SIZE = 4  # bytes
_BLOCK = 1 << 20  # bytes


def verify(stream: BinaryIO) -> None:
    """Compare a whole file with its check sums; one that is 0 was not computed.

    Raises:
        ValueError: the file does not end as a complete one does, or a check sum is wrong.
    """
    data_end = verify_summary(stream)
    stream.seek(data_end)
    _, _, expected = _DATA_END.unpack(stream.read(_DATA_END.size))
    if expected and _sum(stream, 0, data_end) != expected:
        raise ValueError('the check sum of its data is wrong')
    stream.seek(0)


def verify_summary(stream: BinaryIO) -> int:
    """Compare the summary of a file with its check sum and return where the data before it end.

    Raises:
        ValueError: the file does not end as a complete one does, or the check sum is wrong.
    """
    size = stream.seek(0, os.SEEK_END)
    footer_start = size - len(MAGIC) - _FOOTER.size
    if footer_start < len(MAGIC):
        raise ValueError(f'it has {size} bytes')
    stream.seek(footer_start)
    footer = stream.read(_FOOTER.size)
    if stream.read() != MAGIC:
        raise ValueError('its end is missing')
    _, _, summary_start, _, expected = _FOOTER.unpack(footer)
    if not len(MAGIC) + _DATA_END.size <= summary_start <= footer_start:
        raise ValueError('it has no summary')
    found = _sum(stream, summary_start, footer_start)
    if expected and zlib.crc32(footer[:-_CHECK_SUM_SIZE], found) != expected:
        raise ValueError('the check sum of its summary is wrong')
    return summary_start - _DATA_END.size


def _sum(stream: BinaryIO, start: int, end: int) -> int:
    stream.seek(start)
    total = 0
    while stream.tell() < end:
        total = zlib.crc32(stream.read(min(_BLOCK, end - stream.tell())), total)
    return total
