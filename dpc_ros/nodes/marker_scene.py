"""What is drawn of a run, as markers: the body, what holds it, what the encoder saw, the target."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from dpc_ros.network import MassSpringNetwork
from dpc_ros.nodes.marker_bytes import MarkerBytes, Outline, Place
from dpc_ros.view import strain_colours

BODY, FIXED, RECONSTRUCTION, TARGET, FORCE = NAMESPACES = (
    *('body', 'fixed', 'reconstruction', 'target', 'force'),
)

# Of the median length of a spring at rest.
_LINE, _GHOST, _THIN, _CUBE = 0.1, 0.06, 0.03, 0.3
_SHAFT, _HEAD, _HEAD_LENGTH = 0.2, 0.5, 0.7
# The plane of each: who looks from above sees the force before the body, the target behind it.
_PLANES = {TARGET: -0.2, BODY: 0.0, FIXED: 0.0, RECONSTRUCTION: 0.1, FORCE: 0.2}
_SHORTEST = 0.1  # m, for a body whose springs have no length

# Told apart by those who see no red or green, too, and from the colours of strain.
_COLOURS = {
    BODY: (150, 150, 150, 1.0),  # each spring has its own
    FIXED: (230, 159, 0, 1.0),
    RECONSTRUCTION: (0, 158, 115, 0.8),
    TARGET: (86, 180, 233, 0.35),
    FORCE: (204, 121, 167, 1.0),
}
_SHAPES = {
    BODY: (Marker.LINE_LIST, (_LINE, 0.0, 0.0)),
    FIXED: (Marker.CUBE_LIST, (_CUBE, _CUBE, _CUBE)),
    RECONSTRUCTION: (Marker.LINE_LIST, (_THIN, 0.0, 0.0)),  # the colours below it stay in sight
    TARGET: (Marker.LINE_LIST, (_GHOST, 0.0, 0.0)),
    FORCE: (Marker.ARROW, (_SHAFT, _HEAD, _HEAD_LENGTH)),
}


class MarkerScene:
    """A MarkerArray with one marker in each of `NAMESPACES`; only the fixed masses show at first.

    Lengths that are no one's positions are measured by the springs, so that bodies of any size look
    alike. Positions are the numbers that are given, bit for bit.

    Args:
        network: the body.
        frame: `frame_id` of the markers.
        largest_strain: magnitude from which on a spring has its full colour, > 0.
    """

    def __init__(self, network: MassSpringNetwork, frame: str, largest_strain: float) -> None:
        self._network = network
        self._largest_strain = largest_strain
        self._ends = network.springs.ravel()  # the masses of one spring after the other
        counts = dict.fromkeys(NAMESPACES, len(self._ends)) | {FIXED: len(network.fixed), FORCE: 2}
        unit = _spring_length(network)
        self._bytes = MarkerBytes(
            Outline(_marker(namespace, frame, unit), counts[namespace], namespace == BODY)
            for namespace in NAMESPACES
        )
        self._places: dict[str, Place] = dict(zip(NAMESPACES, self._bytes.places, strict=True))
        for namespace, place in self._places.items():
            place.points[:, 2] = _PLANES[namespace] * unit
        self._places[BODY].colours[:, 3] = 1.0
        self._places[FIXED].points[:, :2] = network.rest_position[network.fixed]
        self._places[FIXED].show(0)

    def message(self) -> bytes:
        """Return the MarkerArray, as rclpy publishes bytes."""
        return self._bytes.message()

    def show_springs(
        self, namespace: str, configuration: Float[np.ndarray, ' n'], stamp: int
    ) -> None:
        """Draw q [m] of a stamp [ns], as the body each spring in the colour of its strain."""
        place = self._places[namespace]
        place.points[:, :2] = self._network.positions(configuration)[self._ends]
        if namespace == BODY:
            strain = self._network.strains(configuration)
            colours = strain_colours(strain, self._largest_strain) / np.float32(255)
            place.colours[:, :3] = np.repeat(colours, 2, axis=0)
        place.show(stamp)

    def show_force(
        self, origin: Float[np.ndarray, ' 2'], arrow: Float[np.ndarray, ' 2'], stamp: int
    ) -> None:
        """Draw an arrow [m] from a point on."""
        place = self._places[FORCE]
        place.points[:, :2] = (origin, origin + arrow)
        place.show(stamp)

    def hide(self, namespace: str) -> None:
        """Draw one of `NAMESPACES` no more."""
        self._places[namespace].hide()


def _marker(namespace: str, frame: str, unit: float) -> Marker:
    shape, scale = _SHAPES[namespace]
    *colour, alpha = _COLOURS[namespace]
    marker = Marker(ns=namespace, type=shape)
    marker.header.frame_id = frame
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = (unit * each for each in scale)
    red, green, blue = (each / 255 for each in colour)
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    return marker


def _spring_length(network: MassSpringNetwork) -> float:
    """Return the median length of the springs where all masses are at rest [m]."""
    ends = network.rest_position[network.springs]
    length = float(np.median(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=-1)))
    return length or _SHORTEST
