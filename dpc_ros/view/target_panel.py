"""Targets: chosen by name, by latent coordinates, or by dragging the actuated mass."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from dpc_ros.control import Target, TargetError, load_target, pulled_equilibrium
from dpc_ros.reduction import CompressedSystem
from dpc_ros.view.actions import Actions
from dpc_ros.view.newest_job import NewestJob
from dpc_ros.view.plots import subscripted
from dpc_ros.view.scene import BodyScene
from dpc_ros.view.server import extent, notify

if TYPE_CHECKING:
    from viser import ClientHandle, ViserServer

_LARGEST_LATENT = 4.0  # standard deviations of the training data
_STEP = 0.01  # of a slider
_BALL = 0.015  # radius, in extents of the body
_BALL_COLOUR = (230, 159, 0)
_NAMES = 'rest, or a state of a simulation of the training or validation data, simulation:4@100'


class TargetPanel:
    """Offers a target as a preview, and sends it.

    Args:
        server: of viser; the panel is added to the container that is open.
        scene: shows the preview.
        system: the compressed body, whose decoder the preview is of.
        largest_force: with which a dragged mass may be held [N].
        actions: of the loop.

    Attributes:
        largest_force: as above; the bound of the law in force, where that is known.
    """

    def __init__(
        self,
        server: ViserServer,
        scene: BodyScene,
        system: CompressedSystem,
        largest_force: float,
        actions: Actions,
    ) -> None:
        self._server, self._scene, self._system = server, scene, system
        self.largest_force, self._actions = largest_force, actions
        self._network = system.mechanics.network
        self._job = NewestJob(lambda reason: notify(server, reason, problem=True))
        self._candidate: Target | None = None
        self._dragging: int | None = None  # the client that drags the ball
        server.on_client_disconnect(self._forget)
        self._rest = system.autoencoder.encode(self._network.rest_configuration)
        self._held = self._rest  # equilibrium that the last drag came to
        self._add_fields(server.gui)
        self._ball = self._add_ball()

    def show(self, target: Float[np.ndarray, ' n'] | None) -> None:
        """Put the ball to where the target in force has the actuated mass."""
        if self._candidate is None and self._dragging is None:
            self._place_ball(self._network.rest_configuration if target is None else target)

    def close(self) -> None:
        """Stop solving."""
        self._job.close()

    def _add_fields(self, gui: Any) -> None:
        gui.add_markdown('Drag the orange ball, or')
        self._name = gui.add_text('By name', 'simulation:4@100', hint=_NAMES)
        preview = gui.add_button('Preview')
        preview.on_click(lambda _: self._job.ask(self._load))
        self._sliders = [
            gui.add_slider(
                subscripted('ξ', i),
                -_LARGEST_LATENT,
                _LARGEST_LATENT,
                _STEP,
                _within_sliders(value),
            )
            for i, value in enumerate(self._rest)
        ]
        for slider in self._sliders:
            slider.on_update(self._slide)
        self._send = gui.add_button('Send', disabled=True)
        self._send.on_click(lambda _: self._send_candidate())

    def _add_ball(self) -> Any:
        ball = self._server.scene.add_icosphere(
            '/ball', radius=_BALL * extent(self._network), color=_BALL_COLOUR
        )
        ball.on_drag('left')(self._drag)
        return ball

    async def _drag(self, event: Any) -> None:
        # A coroutine: those of a drag run in its order, functions in any.
        if event.phase == 'start' and self._dragging is None:
            self._dragging = event.client_id
        if event.client_id != self._dragging:
            return
        x, y, _ = event.end_position
        position, is_end = np.array([x, y]), event.phase == 'end'
        self._ball.position = (x, y, 0.0)
        if is_end:
            self._dragging = None
            if event.client_id not in self._server.get_clients():
                self._job.ask(self._withdraw, must=True)  # not let go, its browser has gone
                return
        self._job.ask(lambda: self._pull(position, is_end), must=is_end)

    def _forget(self, client: ClientHandle) -> None:
        """Drop the preview of a browser that goes in the middle of a drag."""
        if client.client_id == self._dragging:
            self._dragging = None
            self._job.ask(self._withdraw, must=True)  # after what is being solved for it

    def _pull(self, position: np.ndarray, is_end: bool) -> None:
        try:
            held = pulled_equilibrium(self._system, position, self._held, self.largest_force)
        except ValueError:
            self._held = self._rest  # the next one begins from there
            if is_end:
                self._withdraw()
                notify(self._server, 'no equilibrium was found with the mass there', problem=True)
            return
        self._held = held.latent
        self._offer(Target(latent=held.latent))
        if is_end:
            self._send_candidate()

    def _load(self) -> None:
        name = self._name.value.strip()
        try:
            if name != 'rest' and not name.startswith('simulation:'):
                raise TargetError(f'target {name!r}: expected {_NAMES}')
            self._offer(load_target(name, self._network))
        except ValueError as error:
            notify(self._server, str(error), problem=True)

    def _slide(self, event: Any) -> None:
        if event.client_id is None:  # moved by `_offer`
            return
        latent = np.array([slider.value for slider in self._sliders])
        self._job.ask(lambda: self._offer(Target(latent=latent), from_sliders=True))

    def _offer(self, target: Target, from_sliders: bool = False) -> None:
        """Show a target as a preview, ready to be sent."""
        autoencoder = self._system.autoencoder
        if target.latent is not None:
            latent, configuration = target.latent, autoencoder.decode(target.latent)
        else:
            assert target.configuration is not None
            latent, configuration = autoencoder.encode(target.configuration), target.configuration
        if not (np.isfinite(latent).all() and np.isfinite(configuration).all()):
            raise TargetError(
                'target: expected one that the autoencoder knows, got infinite numbers'
            )
        self._candidate = target
        with self._server.atomic():
            self._scene.show_preview(configuration)
            self._place_ball(configuration)
            self._send.disabled = False
            if not from_sliders:
                for slider, value in zip(self._sliders, latent, strict=True):
                    slider.value = _within_sliders(value)

    def _send_candidate(self) -> None:
        candidate, self._candidate = self._candidate, None
        if candidate is None:
            return
        self._withdraw()
        self._actions.aim(candidate)

    def _withdraw(self) -> None:
        """Offer nothing any more."""
        self._candidate = None
        self._send.disabled = True
        self._scene.show_preview(None)

    def _place_ball(self, configuration: np.ndarray) -> None:
        x, y = self._network.positions(configuration)[self._system.actuated_mass]
        self._ball.position = (x, y, 0.0)


def _within_sliders(value: float) -> float:
    return float(np.clip(value, -_LARGEST_LATENT, _LARGEST_LATENT))
