"""A body in a viser scene: its springs by their strain, ghosts of it, and the forces."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from dpc_ros.network import MassSpringNetwork
from dpc_ros.view.colours import strain_colours
from dpc_ros.view.frame import Frame
from dpc_ros.view.server import extent

if TYPE_CHECKING:
    from viser import SceneApi

_LINE, _GHOST_LINE = 2.0, 1.5  # pixels
_RECONSTRUCTION, _TARGET, _PREVIEW = (204, 121, 167), (0, 158, 115), (230, 159, 0)
_FORCE, _HAND, _FIXED = (34, 34, 34), (213, 94, 0), (34, 34, 34)
# m towards the viewer: what lies above what
_DEPTH = {'target': -0.03, 'reconstruction': -0.02, 'preview': -0.01, 'body': 0.0, 'force': 0.03}
METRES_PER_NEWTON = 0.1  # of the arrow of a force
_WEAKEST_FORCE = 0.01  # N that has an arrow
_SHAFT, _HEAD, _HEAD_LENGTH = 0.02, 0.06, 0.15  # m, of arrows
_FIXED_SIZE = 0.012  # of the body's extent


class BodyScene:
    """Draws a planar body, its x to the right and its y upward.

    Args:
        scene: of a viser server.
        network: the body.
        actuated_mass: number of the mass that carries the control force.
    """

    def __init__(self, scene: SceneApi, network: MassSpringNetwork, actuated_mass: int) -> None:
        self._network = network
        self._actuated_mass = actuated_mass
        rest = network.rest_configuration
        self._body = scene.add_line_segments(
            '/body',
            self._segments(rest, 'body'),
            self._colours(rest),
            thickness=_LINE,
            thickness_units='screen',
        )
        self._ghosts = {
            name: scene.add_line_segments(
                f'/{name}',
                self._segments(rest, name),
                colour,
                thickness=_GHOST_LINE,
                thickness_units='screen',
                visible=False,
            )
            for name, colour in (
                ('target', _TARGET),
                ('reconstruction', _RECONSTRUCTION),
                ('preview', _PREVIEW),
            )
        }
        fixed = np.zeros((len(network.fixed), 3))
        fixed[:, :2] = network.rest_position[network.fixed]
        scene.add_point_cloud(
            '/fixed',
            fixed,
            np.array(_FIXED),
            point_size=_FIXED_SIZE * extent(network),
            precision='float32',
        )
        nowhere = np.zeros((1, 2, 3), dtype=np.float32)
        self._arrows = {
            name: scene.add_arrows(
                f'/{name}',
                nowhere,
                colour,
                shaft_radius=_SHAFT,
                head_radius=_HEAD,
                head_length=_HEAD_LENGTH,
                visible=False,
            )
            for name, colour in (('force', _FORCE), ('hand', _HAND))
        }
        self._known: set[str] = set()  # of what can be hidden
        self._hidden: set[str] = set()

    def show(self, frame: Frame) -> None:
        """Draw a frame."""
        self._body.points = self._segments(frame.configuration, 'body')
        self._body.colors = self._colours(frame.configuration)
        self._show_ghost('target', frame.target)
        self._show_ghost('reconstruction', frame.reconstruction)
        mass = self._actuated_mass if frame.mass is None else frame.mass
        tail = self._network.positions(frame.configuration)[mass]
        force = np.zeros(2) if frame.force is None else frame.force
        self._show_arrow('force', tail, tail + METRES_PER_NEWTON * force)

    def show_preview(self, configuration: Float[np.ndarray, ' n'] | None) -> None:
        """Draw what a target would be; nothing where there is none."""
        self._show_ghost('preview', configuration)

    def show_hand(
        self, tail: Float[np.ndarray, ' 2'] | None, head: Float[np.ndarray, ' 2'] | None
    ) -> None:
        """Draw what pulls at the body from one point to another [m]; nothing where nothing does."""
        if tail is None or head is None:
            self._set_known('hand', False)
        else:
            self._show_arrow('hand', tail, head)

    def hide(self, name: str, hidden: bool) -> None:
        """Show or hide `target`, `reconstruction` or `force` from now on."""
        if hidden:
            self._hidden.add(name)
        else:
            self._hidden.discard(name)
        self._set_known(name, name in self._known)

    def _set_known(self, name: str, known: bool) -> None:
        """Show what is known and not hidden."""
        if known:
            self._known.add(name)
        else:
            self._known.discard(name)
        drawn = self._ghosts[name] if name in self._ghosts else self._arrows[name]
        drawn.visible = known and name not in self._hidden

    def _show_ghost(self, name: str, configuration: np.ndarray | None) -> None:
        self._set_known(name, configuration is not None)
        if configuration is not None:
            self._ghosts[name].points = self._segments(configuration, name)

    def _show_arrow(self, name: str, tail: np.ndarray, head: np.ndarray) -> None:
        is_long = np.linalg.norm(head - tail) > METRES_PER_NEWTON * _WEAKEST_FORCE
        self._set_known(name, bool(is_long))
        if is_long:
            depth = _DEPTH['force']
            points = np.array([[[*tail, depth], [*head, depth]]], dtype=np.float32)
            self._arrows[name].points = points

    def _segments(
        self, configuration: Float[np.ndarray, ' n'], name: str
    ) -> Float[np.ndarray, 'springs 2 3']:
        segments = np.full((len(self._network.springs), 2, 3), _DEPTH[name], dtype=np.float32)
        segments[..., :2] = self._network.positions(configuration)[self._network.springs]
        return segments

    def _colours(self, configuration: Float[np.ndarray, ' n']) -> np.ndarray:
        colours = strain_colours(self._network.strains(configuration))
        return np.repeat(colours[:, np.newaxis, :], 2, axis=1)
