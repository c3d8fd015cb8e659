"""The page of a running loop: its body, its plots, its nodes, and what may be done to it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from dpc_ros.reduction import CompressedSystem
from dpc_ros.view.actions import Actions
from dpc_ros.view.frame import Frame
from dpc_ros.view.hand import Hand
from dpc_ros.view.history import History
from dpc_ros.view.law_panel import LawPanel
from dpc_ros.view.plots import DRAWING_PERIOD, add_plots
from dpc_ros.view.run_panel import RunPanel
from dpc_ros.view.scene import BodyScene
from dpc_ros.view.server import notify, quiet
from dpc_ros.view.target_panel import TargetPanel

if TYPE_CHECKING:
    from viser import ViserServer

_SPAN = 10.0  # s of the plots


class LivePage:
    """Shows frames as they come, and hands on what people want.

    `show…` are to be called from one thread; what is wanted comes from others.

    Args:
        server: of viser, empty.
        system: the compressed body.
        largest_force: with which a target may be held [N].
        largest_push: of a hand on the body [N].
        actions: of the loop.
    """

    def __init__(
        self,
        server: ViserServer,
        system: CompressedSystem,
        largest_force: float,
        largest_push: float,
        actions: Actions,
    ) -> None:
        self._server = server
        network = system.mechanics.network
        self._scene = BodyScene(server.scene, network, system.actuated_mass)
        self._hand = Hand(server, self._scene, network, largest_push, actions)
        gui = server.gui
        tabs = gui.add_tab_group()
        with tabs.add_tab('Run'):
            self._run = RunPanel(gui, self._scene, actions)
        with tabs.add_tab('Target'):
            self._target = TargetPanel(server, self._scene, system, largest_force, actions)
        with tabs.add_tab('Law'):
            self._law = LawPanel(gui, actions)
        with tabs.add_tab('Nodes'):
            self._nodes = gui.add_markdown('no node has reported so far')
        self._plots = add_plots(server, system.latent_size)
        self._history = History(system.latent_size, _SPAN)
        self._drawn_at = 0.0

    def show(self, frame: Frame) -> None:
        """Show the newest frame."""
        self._history.add(frame)
        with self._server.atomic():
            self._scene.show(frame)
            self._hand.show(frame.configuration)
            self._run.show(frame)
            self._target.show(frame.target)
            now = time.monotonic()
            if now - self._drawn_at >= DRAWING_PERIOD:
                self._drawn_at = now
                self._plots.show(self._history)

    def hold(self) -> None:
        """Go on with what is being done by hand, where there is no new frame to show."""
        self._hand.hold()

    def show_nodes(self, table: str) -> None:
        """Show the state of the nodes, in Markdown."""
        self._nodes.content = table

    def show_parameters(self, parameters: Mapping[str, Any]) -> None:
        """Show the parameters of the law in force, whose bound holds for targets, too."""
        self._law.show(parameters)
        self._target.largest_force = parameters.get('largest_force', self._target.largest_force)

    def show_paused(self, paused: bool) -> None:
        """Show whether the body was told to stand still."""
        self._run.show_paused(paused)

    def show_recording(self, recording: bool) -> None:
        """Show whether a log is being written."""
        self._run.show_recording(recording)

    def tell(self, text: str, problem: bool = False) -> None:
        """Show a line to all who look."""
        notify(self._server, text, problem)

    def close(self) -> None:
        """End the server and what solves for it."""
        self._target.close()
        with quiet():
            self._server.stop()
