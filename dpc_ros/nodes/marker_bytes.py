"""Markers as the bytes that DDS carries: laid out by rclpy once, then overwritten in place.

A marker of rclpy holds an object for each point and each colour. To fill those of some hundred
springs and to take them apart again costs milliseconds; to copy their numbers, microseconds.
"""

from __future__ import annotations

from collections.abc import Iterable
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from jaxtyping import Float, Int
from rclpy.serialization import serialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from dpc_ros.bag.topic import NANOSECONDS

# What no marker holds by itself, by which rclpy's bytes show where these stand.
_STAMP = np.array([0x5EC5EC5E, 0x5A5A5A5A], '<i4')
_ACTION = np.array([0x0AC710A0], '<i4')
_POINT = np.array([1.25, 2.5, 5.0], '<f8')
_COLOUR = np.array([1.25, 2.5, 5.0, 10.0], '<f4')


@dataclass(frozen=True)
class Outline:
    """A marker that is to be overwritten.

    Attributes:
        marker: all of it that stays, without points and colours.
        points: how many it has.
        coloured: whether each has a colour of its own.
    """

    marker: Marker
    points: int
    coloured: bool = False


@dataclass(frozen=True)
class Place:
    """Where a marker stands among the bytes; what is written into the arrays is in the message.

    Attributes:
        stamp: seconds and nanoseconds.
        action: `Marker.ADD` or `Marker.DELETE`, in one element.
        points: x, y and z of each [m].
        colours: red, green, blue and alpha of each, from 0 to 1; of none where it has one for all.
    """

    stamp: Int[np.ndarray, ' 2']
    action: Int[np.ndarray, ' 1']
    points: Float[np.ndarray, 'points 3']
    colours: Float[np.ndarray, 'colours 4']

    def show(self, stamp: int) -> None:
        """Let the marker be drawn, with a stamp [ns]."""
        self.stamp[:] = divmod(stamp, NANOSECONDS)
        self.action[:] = Marker.ADD

    def hide(self) -> None:
        """Let the marker be removed where it is drawn."""
        self.action[:] = Marker.DELETE


class MarkerBytes:
    """A MarkerArray with a fixed number of markers, points and colours; all are hidden at first.

    Args:
        outlines: of its markers.

    Attributes:
        places: of the markers, in their order.
    """

    def __init__(self, outlines: Iterable[Outline]) -> None:
        filled = [_fill(outline) for outline in outlines]
        array = MarkerArray(markers=[marker for marker, _, _ in filled])
        self._buffer = bytearray(serialize_message(array))
        self._end = 0  # of what has been found
        self.places = [
            Place(*map(self._find, (_STAMP, _ACTION, points, colours)))
            for _, points, colours in filled
        ]
        for place in self.places:
            for numbers in (place.stamp, place.points, place.colours):
                numbers[...] = 0
            place.hide()

    def message(self) -> bytes:
        """Return the bytes of the message as it is now."""
        return bytes(self._buffer)

    def _find(self, numbers: np.ndarray) -> np.ndarray:
        """Return the next place that holds some numbers, as an array of their shape."""
        begin = self._buffer.index(numbers.tobytes(), self._end)
        self._end = begin + numbers.nbytes
        found = np.frombuffer(self._buffer, numbers.dtype, numbers.size, begin)
        return found.reshape(numbers.shape)


def _fill(outline: Outline) -> tuple[Marker, np.ndarray, np.ndarray]:
    """Return a marker with numbers to be found by, and its points and colours."""
    marker, points = deepcopy(outline.marker), outline.points
    colours = points if outline.coloured else 0
    marker.header.stamp = Time(sec=int(_STAMP[0]), nanosec=int(_STAMP[1]))
    marker.action = int(_ACTION[0])
    marker.points = [Point(**dict(zip('xyz', _POINT.tolist(), strict=True)))] * points
    marker.colors = [ColorRGBA(**dict(zip('rgba', _COLOUR.tolist(), strict=True)))] * colours
    return marker, np.tile(_POINT, (points, 1)), np.tile(_COLOUR, (colours, 1))
