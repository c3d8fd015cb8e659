"""The controls of a run: pause, step, reset, record, and what to draw."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from dpc_ros.view.actions import Actions
from dpc_ros.view.frame import Frame
from dpc_ros.view.scene import BodyScene

if TYPE_CHECKING:
    from viser import GuiApi

_PAUSE, _GO_ON = 'Pause', 'Go on'
_RECORD, _END_RECORD = 'Record', 'End recording'


class RunPanel:
    """Buttons of the run and a line about its state.

    Args:
        gui: of a viser server, within the container that they are to stand in.
        scene: whose ghosts can be hidden.
        actions: of the loop.
    """

    def __init__(self, gui: GuiApi, scene: BodyScene, actions: Actions) -> None:
        self._actions = actions
        self._paused = self._recording = False
        self._state = gui.add_markdown('waiting for a configuration')
        self._pause = gui.add_button(_PAUSE)
        step = gui.add_button('Step', hint='of a paused body')
        reset = gui.add_button('Reset')
        self._record = gui.add_button(_RECORD)
        self._pause.on_click(lambda _: self._actions.pause(not self._paused))
        step.on_click(lambda _: self._actions.step())
        reset.on_click(lambda _: self._actions.reset())
        self._record.on_click(lambda _: self._actions.record(not self._recording))
        add_visibility(gui, scene)

    def show(self, frame: Frame) -> None:
        """Say how the run is going."""
        self._state.content = describe(frame)

    def show_paused(self, paused: bool) -> None:
        """Show whether the body stands still because it was told to."""
        self._paused = paused
        self._pause.label = _GO_ON if paused else _PAUSE

    def show_recording(self, recording: bool) -> None:
        """Show whether a log is being written."""
        self._recording = recording
        self._record.label = _END_RECORD if recording else _RECORD


def describe(frame: Frame) -> str:
    """Return time, error and force of a frame in Markdown."""
    parts = [f'**{frame.time:.2f} s**']
    if np.isfinite(frame.nmse):
        parts.append(f'nMSE {frame.nmse:.3g}')
    if frame.force is not None:
        parts.append(f'|u| {np.hypot(*frame.force):.2f} N')
    return ' &nbsp; '.join(parts)


def add_visibility(gui: GuiApi, scene: BodyScene) -> None:
    """Add a box for each of what can be hidden."""
    for name in ('target', 'reconstruction', 'force'):
        box = gui.add_checkbox(name.capitalize(), True)
        box.on_update(partial(_hide, scene, name))


def _hide(scene: BodyScene, name: str, event: Any) -> None:
    scene.hide(name, not event.target.value)
