"""A hand on the body: it pulls a mass toward the pointer, as an elastic band would."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from dpc_ros.control.saturation import shorten
from dpc_ros.network import MassSpringNetwork
from dpc_ros.view.actions import Actions
from dpc_ros.view.scene import BodyScene
from dpc_ros.view.server import extent

if TYPE_CHECKING:
    from viser import ViserServer

_STIFFNESS = 5.0  # N/m, of the band
_SHEET = 4.0  # side of what can be touched, in extents of the body
_NEAR = 0.1  # extents of the body, within which a mass is taken hold of
_BEHIND = -0.05  # m, where it lies
_LONGEST_REST = 5.0  # s without a move of the pointer, after which the hand lets go


class Hand:
    """Pushes a mass while the pointer drags it, by a bounded force.

    A pointer that is not heard of for some seconds has let go: its browser may hang.

    Args:
        server: of viser.
        scene: draws the band.
        network: the body.
        largest_push: bound on the force [N].
        actions: of the loop.
    """

    def __init__(
        self,
        server: ViserServer,
        scene: BodyScene,
        network: MassSpringNetwork,
        largest_push: float,
        actions: Actions,
    ) -> None:
        self._scene, self._network = scene, network
        self._largest_push, self._actions = largest_push, actions
        self._lock = threading.Lock()
        self._positions = network.rest_position
        self._mass: int | None = None
        self._client: int | None = None
        self._pointer = self._grip = np.zeros(2)
        self._moved_at = 0.0
        side = _SHEET * extent(network)
        x, y = network.rest_position.mean(axis=0)
        # A sheet behind the body that is not seen: lines can't be touched.
        sheet = server.scene.add_box(
            '/sheet', dimensions=(side, side, 1e-3), opacity=0.0, position=(x, y, _BEHIND)
        )
        sheet.on_drag('left')(self._drag)
        server.on_client_disconnect(lambda client: self._let_go(client.client_id))

    def show(self, configuration: Float[np.ndarray, ' n']) -> None:
        """Follow the body: the band pulls from where the mass is now."""
        with self._lock:
            self._positions = self._network.positions(configuration)
        self.hold()

    def hold(self) -> None:
        """Go on pulling; one push lasts for a moment only."""
        with self._lock:
            if self._mass is not None and time.monotonic() - self._moved_at > _LONGEST_REST:
                self._release()
            self._pull()

    async def _drag(self, event: Any) -> None:
        # A coroutine: those of a drag run in its order, functions in any.
        with self._lock:
            if event.phase == 'start' and self._mass is None:
                self._take_hold(np.array(event.start_position[:2]), event.client_id)
            if self._mass is None or event.client_id != self._client:
                return
            self._pointer, self._moved_at = np.array(event.end_position[:2]), time.monotonic()
            if event.phase == 'end':
                self._release()
            self._pull()

    def _take_hold(self, position: np.ndarray, client: int) -> None:
        """Take hold of the mass that is nearest to a position, if one is near."""
        mobile = self._network.mobile
        distances = np.linalg.norm(self._positions[mobile] - position, axis=1)
        nearest = int(np.argmin(distances))
        if distances[nearest] <= _NEAR * extent(self._network):
            self._mass, self._client = int(mobile[nearest]), client
            self._grip = position - self._positions[self._mass]

    def _let_go(self, client: int) -> None:
        with self._lock:
            if client == self._client:
                self._release()

    def _pull(self) -> None:
        if self._mass is None:
            return
        tail = self._positions[self._mass] + self._grip
        force = shorten(_STIFFNESS * (self._pointer - tail), self._largest_push)
        self._actions.push(self._mass, force)
        self._scene.show_hand(tail, self._pointer)

    def _release(self) -> None:
        if self._mass is not None:
            self._actions.push(self._mass, np.zeros(2))
            self._scene.show_hand(None, None)
        self._mass = self._client = None
