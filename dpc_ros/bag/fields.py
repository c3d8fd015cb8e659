"""The fields of a message by their names: `wrench.force.x`, `position`, `markers[0].ns`."""

from __future__ import annotations

from typing import Any

import numpy as np

from dpc_ros.bag.topic import NANOSECONDS

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
        found[name] = np.array(value)
    else:
        found[name] = value


def _nanoseconds(time: Any) -> int:
    return int(time.sec * NANOSECONDS + time.nanosec)
