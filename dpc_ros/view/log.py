"""The page of a log: the same view as that of a running loop, with its time in hand."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from dpc_ros.bag import Convergence, goals_in_force
from dpc_ros.network import MassSpringNetwork, Mechanics, NetworkError
from dpc_ros.view.frame import Frame
from dpc_ros.view.history import History
from dpc_ros.view.plots import DRAWING_PERIOD, add_plots
from dpc_ros.view.run_panel import add_visibility, describe
from dpc_ros.view.scene import BodyScene
from dpc_ros.view.server import quiet

if TYPE_CHECKING:
    from viser import ViserServer

_PERIOD = 1 / 30  # s between two pictures
_MOST_FRAMES = 400  # of the curves
_RESOLUTION = 0.001  # s, of the slider
_SPEEDS = ('0.1', '0.25', '0.5', '1', '2', '5')
_PLAY, _STOP = 'Play', 'Stop'


class LogPage:
    """Shows a moment of a log, and plays it.

    Args:
        server: of viser, empty.
        log: its frames.
    """

    def __init__(self, server: ViserServer, log: RecordedFrames) -> None:
        self._server, self._log = server, log
        gui, network = server.gui, self._log.mechanics.network
        self._scene = BodyScene(server.scene, network, self._log.actuated_mass)
        self._lock = threading.Lock()
        self._time = self._log.times[0]
        self._playing = False
        self._speed = 1.0
        self._state = gui.add_markdown('')
        self._play = gui.add_button(_PLAY)
        self._play.on_click(lambda _: self._set(playing=not self._playing))
        first, last = float(self._log.times[0]), float(self._log.times[-1])
        last = max(last, first + _RESOLUTION)
        self._slider = gui.add_slider('t [s]', first, last, _RESOLUTION, first)
        self._slider.on_update(self._scrub)
        speed = gui.add_dropdown('Speed', _SPEEDS, initial_value='1')
        speed.on_update(lambda event: self._set(speed=float(event.target.value)))
        add_visibility(gui, self._scene)
        self._plots = add_plots(server, self._log.latent_size, span=(first, last))

    def run(self, is_over: Callable[[], bool]) -> None:
        """Show and play until it is over; blocks."""
        shown = drawn = None
        drawn_at = before = time.monotonic()
        while not is_over():
            now = time.monotonic()
            moment = self._advance(now - before)
            before = now
            if moment != shown:
                shown = moment
                self._show(moment)
            if shown != drawn and now - drawn_at >= DRAWING_PERIOD:
                drawn, drawn_at = shown, now
                self._plots.show(self._log.history(moment))
            time.sleep(_PERIOD)

    def close(self) -> None:
        """End the server."""
        with quiet():
            self._server.stop()

    def _advance(self, seconds: float) -> float:
        """Return the moment to show, after so many seconds [s]."""
        with self._lock:
            if self._playing:
                self._time = min(self._time + seconds * self._speed, self._log.times[-1])
                if self._time == self._log.times[-1]:
                    self._playing = False
                    self._play.label = _PLAY
            return self._time

    def _show(self, moment: float) -> None:
        frame = self._log.frame(moment)
        with self._server.atomic():
            self._scene.show(frame)
            self._state.content = describe(frame)
            self._slider.value = float(np.clip(moment, self._slider.min, self._slider.max))  # type: ignore[misc]  # viser writes it

    def _scrub(self, event: Any) -> None:
        if event.client_id is not None:  # not one that `_show` has moved
            self._set(moment=event.target.value, playing=False)

    def _set(
        self,
        *,
        moment: float | None = None,
        playing: bool | None = None,
        speed: float | None = None,
    ) -> None:
        with self._lock:
            if playing and self._time == self._log.times[-1]:
                self._time = self._log.times[0]
            self._time = self._time if moment is None else moment
            self._speed = self._speed if speed is None else speed
            self._playing = self._playing if playing is None else playing
            self._play.label = _STOP if self._playing else _PLAY


class RecordedFrames:
    """The frames of a log by their time.

    Args:
        convergence: what the log shows.

    Attributes:
        times: of the configurations that are finite [s].
        mechanics: of the body.
        actuated_mass: number of the mass that the forces name.
        latent_size: m, 0 where no latent state is known.

    Raises:
        ValueError: the body is not known, or there is no finite configuration.
    """

    def __init__(self, convergence: Convergence) -> None:
        run = convergence.run
        if convergence.mechanics is None:
            raise ValueError(
                f'expected the network of the log, {run.network_identifier or "without a name"}, '
                'which is not shipped: name it by --network'
            )
        finite = np.isfinite(run.configuration).all(axis=1) & np.isfinite(run.velocity).all(axis=1)
        if not finite.any():
            raise ValueError(f'{run.path}: expected a finite configuration, got none')
        self._convergence = convergence
        self._frames = np.flatnonzero(finite)
        self._in_force = goals_in_force(run.configuration_stamp, convergence.goals)
        self.times = convergence.time[self._frames]
        self.mechanics: Mechanics = convergence.mechanics
        self.actuated_mass = _mass(self.mechanics.network, run.actuated_mass)
        autoencoder = convergence.autoencoder
        self.latent_size = run.latent.shape[1] if autoencoder is None else autoencoder.latent_size

    def frame(self, moment: float) -> Frame:
        """Return the newest frame at a time [s], the first before it."""
        place = int(np.searchsorted(self.times, moment + 0.5 * _RESOLUTION, side='right')) - 1
        return self._frame(int(self._frames[max(place, 0)]))

    def history(self, until: float) -> History:
        """Return the curves from the beginning until a time [s]."""
        history = History(self.latent_size)
        count = int(np.searchsorted(self.times, until + 0.5 * _RESOLUTION, side='right'))
        every = max(1, -(-len(self.times) // _MOST_FRAMES))
        for i in self._frames[:count:every]:
            history.add(self._frame(int(i), decodes=False))
        return history

    def _frame(self, i: int, decodes: bool = True) -> Frame:
        convergence, run = self._convergence, self._convergence.run
        stamp = run.configuration_stamp[i]
        latent = _at(stamp, run.latent_stamp, run.latent)
        force = _at(stamp, run.force_stamp, run.force)
        goal = convergence.goals[self._in_force[i]] if self._in_force[i] >= 0 else None
        energy = convergence.energy
        return Frame(
            time=float(convergence.time[i]),
            configuration=run.configuration[i],
            latent=latent,
            reconstruction=self._decoded(latent) if decodes else None,
            target=None if goal is None else goal.configuration,
            target_latent=None if goal is None else goal.latent,
            force=force,
            nmse=float(convergence.nmse[i]),
            energies=(
                (np.nan, np.nan, np.nan)
                if energy is None
                else (energy.kinetic[i], energy.elastic[i], energy.gravitational[i])
            ),
        )

    def _decoded(self, latent: np.ndarray | None) -> np.ndarray | None:
        autoencoder = self._convergence.autoencoder
        return None if latent is None or autoencoder is None else autoencoder.decode(latent)


def _mass(network: MassSpringNetwork, logged: int | None) -> int:
    """Return the mass that the forces name; where they name none that moves, the last one."""
    if logged is not None:
        with contextlib.suppress(NetworkError):
            network.mobile_index(logged)
            return logged
    return int(network.mobile[-1])


def _at(stamp: int, stamps: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """Return the newest value at a stamp, if there is one and it is finite."""
    place = int(np.searchsorted(stamps, stamp, side='right')) - 1
    if place < 0 or not np.isfinite(values[place]).all():
        return None
    return values[place]
