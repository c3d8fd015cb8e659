"""The fields of a message by their names: `wrench.force.x`, `position`, `markers[0].ns`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dpc_ros.bag.topic import NANOSECONDS

_LARGEST = np.iinfo(np.int64).max
_TIME = ('sec', 'nanosec')  # fields of builtin_interfaces' Time and Duration


def stamp_ns(content: Any) -> int | None:
    """Return the stamp of a message's header [ns], None where it has no header."""
    stamp = getattr(getattr(content, 'header', None), 'stamp', None)
    return None if stamp is None else _nanoseconds(stamp)


def fields(content: Any) -> dict[str, Any]:
    """Return the fields of a decoded message that hold no other message.

    Times are whole nanoseconds, lists of numbers and bytes are arrays; the stamp is left out.
    """
    found: dict[str, Any] = {}
    _collect(content, '', found)
    found.pop('header.stamp', None)
    return found


def number_array(numbers: Sequence[float]) -> np.ndarray:
    """Return numbers of one field as an array, whole ones with all their digits."""
    # numpy makes doubles of whole numbers of which only some are beyond int64.
    is_beyond = len(numbers) and isinstance(numbers[0], int) and max(numbers) > _LARGEST
    return np.array(numbers, dtype=np.uint64 if is_beyond else None)


def _collect(value: Any, name: str, found: dict[str, Any]) -> None:
    slots = getattr(value, '__slots__', None)
    if slots is not None and tuple(slots) == _TIME:
        found[name] = _nanoseconds(value)
    elif slots is not None:
        for slot in slots:
            _collect(getattr(value, slot), f'{name}.{slot}' if name else slot, found)
    elif isinstance(value, bytes | bytearray):
        found[name] = np.frombuffer(value, dtype=np.uint8)
    elif isinstance(value, list | tuple) and value and hasattr(value[0], '__slots__'):
        for place, item in enumerate(value):
            _collect(item, f'{name}[{place}]', found)
    elif isinstance(value, list | tuple) and not (value and isinstance(value[0], str)):
        found[name] = number_array(value)
    else:
        found[name] = value


def _nanoseconds(time: Any) -> int:
    return int(time.sec * NANOSECONDS + time.nanosec)
