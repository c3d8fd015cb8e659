"""Viewer node: a web page of the running loop, on which people see it and take part in it."""

from __future__ import annotations

import contextlib
import datetime
import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from dpc_ros.bag.topic import NANOSECONDS
from dpc_ros.control import EquilibriumError, pulled_equilibrium
from dpc_ros.control.online import load_system
from dpc_ros.network import Mechanics
from dpc_ros.nodes.commands import Commands
from dpc_ros.nodes.executor import RareCallbackGroup
from dpc_ros.nodes.health import ADDRESS_READING, DIAGNOSTICS, PAUSED_READING, REPORT_DEPTH
from dpc_ros.nodes.loop_node import LoopNode, run_node, set_period
from dpc_ros.nodes.messages import MessageError
from dpc_ros.nodes.newest import NewestMessages
from dpc_ros.nodes.node_list import node_list
from dpc_ros.nodes.onlooker import Onlooker, Sight
from dpc_ros.nodes.recording import Recording
from dpc_ros.nodes.refusals import Refusals
from dpc_ros.nodes.reports import Report, Reports
from dpc_ros.parameters import declarations
from dpc_ros.view import Frame, LivePage, address, open_server

if TYPE_CHECKING:
    from viser import ViserServer

_LOOK_PERIOD = 0.2  # s between two looks whether anyone watches
_LIST_PERIOD = 1.0  # s between two lists of the nodes
_UNSEEN = 0.5  # s after which a target has been in force for some time


class ViewerNode(LoopNode):
    """Shows what the loop publishes while a browser is there; else it does not even listen.

    What people want comes from the threads of the web server, and is carried out in this one.
    """

    niceness = 5  # below the nodes of the loop

    def __init__(self, context: Context | None = None) -> None:
        super().__init__('viewer', context)
        self._timer: Timer | None = None
        self._page: LivePage | None = None
        self._server: ViserServer | None = None
        self._commands: Commands | None = None
        self._newest: NewestMessages | None = None
        self._recording: Recording | None = None
        self._reported: Subscription | None = None
        self._simulator = self.resolve_service_name('simulator')
        self._controller = self.resolve_service_name('controller')

    def configure(self) -> None:
        settings = self.settings
        network, checkpoint, self._system = load_system(settings)
        self._onlooker = Onlooker(settings, network, checkpoint, self._system.autoencoder)
        self._newest = NewestMessages(self, self._onlooker.topics, self.health.arrived)
        self._reports = Reports(self.get_namespace())
        self._refusals = Refusals('target', 'parameters')
        self._reported = self.create_subscription(
            DiagnosticArray,
            DIAGNOSTICS,
            self._hear,
            REPORT_DEPTH,
            callback_group=RareCallbackGroup(),
        )
        self.create_input('parameters_in_force', self._see_parameters)
        self._commands = Commands(self, network.identifier, self._tell, self._record)
        self._warm_up()
        self._server = open_server(settings['host'], settings['port'], self.get_name(), network)
        self._page = LivePage(
            self._server,
            self._system,
            settings['largest_force'],
            settings['largest_push'],
            self._commands,
        )
        where = address(self._server)
        self.health.readings |= {**self._onlooker.models, ADDRESS_READING: where}
        self.get_logger().info(f'the page is at {where}')

    def activate(self) -> None:
        assert self._commands is not None
        self._commands.accepts = True
        self._listed_at = -math.inf
        self._ticked_at = time.process_time()
        self._look_away()
        self._timer = self.create_timer(_LOOK_PERIOD, self._tick, clock=self._steady_clock)

    def deactivate(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
        self._timer = None
        if self._commands is not None:
            self._commands.accepts = False
        if self._newest is not None:
            self._newest.close()

    def clean_up(self) -> None:
        self.deactivate()
        with contextlib.ExitStack() as stack:  # each is let go, whatever becomes of the others
            if self._reported is not None:
                stack.callback(self.destroy_subscription, self._reported)
            if self._page is None and self._server is not None:
                stack.callback(self._server.stop)
            for each in (self._recording, self._page, self._commands):
                if each is not None:
                    stack.callback(each.close)
            self._reported = self._recording = self._newest = None
            self._page = self._server = self._commands = None

    def _warm_up(self) -> None:
        """Compile what compiles at its first call."""
        system = self._system
        rest = system.mechanics.network.rest_configuration
        _energies(system.mechanics, rest, np.zeros_like(rest))
        latent = system.autoencoder.encode(rest)
        with contextlib.suppress(EquilibriumError):
            position = system.full_input_field.T @ system.autoencoder.decode(latent)
            pulled_equilibrium(system, position, latent)

    def _tick(self) -> None:
        """Show what is new, if anyone watches, and be back when the next picture is due."""
        assert self._newest is not None
        assert self._commands is not None
        assert self._page is not None
        assert self._server is not None
        assert self._timer is not None
        now = self.steady_time()
        self._commands.carry_out()
        self._look_after_recording()
        if not self._server.get_clients():
            self._newest.close()
            self._look_away()
            set_period(self._timer, _LOOK_PERIOD)
            return
        self._newest.listen()
        if self._read(now) and self._onlooker.body is not None:
            self._commands.stamp = self._onlooker.body.stamp
            self._page.show(self._frame(self._onlooker.body))
            self.health.sent()
        else:
            self._page.hold()
        if now - self._listed_at >= _LIST_PERIOD:
            self._listed_at = now
            self._page.show_nodes(node_list(self._reports.newest(now), now))
        ticked_at, self._ticked_at = self._ticked_at, time.process_time()
        spent = self._ticked_at - ticked_at  # what the server sends and solves among it
        self.health.processed(spent)
        settings = self.settings
        set_period(
            self._timer, max(1 / settings['largest_rate'], spent / settings['largest_share'])
        )

    def _read(self, now: float) -> bool:
        """Read what has come; return whether there is anything new to show."""
        assert self._newest is not None
        assert self._commands is not None
        messages = self._newest.take()
        for topic, data in messages.items():
            try:
                self._onlooker.read(topic, data, now)
            except MessageError as error:
                self.reject(topic, error)
        target = self._onlooker.target
        if 'target_in_force' in messages and target is not None:
            value = target.configuration if target.latent is None else target.latent
            self._commands.in_force(value)
        return self._onlooker.pass_time(now) or bool(messages)

    def _look_away(self) -> None:
        """Forget what was seen: who looks next sees what there is then."""
        self._onlooker.forget()
        self._goal: Sight | None = None  # of which the error is normalised
        self._goal_latent: np.ndarray | None = None
        self._first_error = math.nan

    def _frame(self, body: Sight) -> Frame:
        """Return what is known, with the error of the body and its energies."""
        known = self._onlooker
        target, reconstruction, push = known.target, known.reconstruction, known.push
        if target is not self._goal:
            self._take_goal(body, target)
        error = math.nan
        if target is not None and self._first_error:
            error = _mean_square(body.configuration - target.configuration) / self._first_error
        return Frame(
            time=body.stamp / NANOSECONDS,
            configuration=body.configuration,
            latent=None if reconstruction is None else reconstruction.latent,
            reconstruction=None if reconstruction is None else reconstruction.configuration,
            target=None if target is None else target.configuration,
            target_latent=self._goal_latent,
            force=None if push is None else push.force,
            mass=None if push is None else push.mass,
            nmse=error,
            energies=_energies(self._system.mechanics, body.configuration, body.velocity),
        )

    def _take_goal(self, body: Sight, target: Sight | None) -> None:
        """Note a target that is new: its latent coordinates, and how far it is."""
        self._goal, self._goal_latent = target, None
        if target is None:
            return
        self._first_error = self._begin_error(body, target)
        self._goal_latent = target.latent
        if target.latent is None:
            with contextlib.suppress(ValueError):  # an encoder that knows no such body
                self._goal_latent = self._system.autoencoder.encode(target.configuration)

    def _begin_error(self, body: Sight, target: Sight) -> float:
        """Return the error with which the way to a target began, or might have.

        Of one that was in force before anyone looked nobody knows: it is that at rest.
        """
        if body.stamp - target.stamp <= _UNSEEN * NANOSECONDS:
            return _mean_square(body.configuration - target.configuration)
        rest = self._onlooker.network.rest_configuration
        return _mean_square(rest - target.configuration)

    def _hear(self, message: DiagnosticArray) -> None:
        now = self.steady_time()
        for status in message.status:
            report = self._reports.take(status, now)
            if report is not None and self._page is not None:
                self._see_report(self._page, report)

    def _see_report(self, page: LivePage, report: Report) -> None:
        """Show whether the body is held, and what the controller begins to refuse."""
        if report.node == self._simulator and PAUSED_READING in report.values:
            page.show_paused(report.values[PAUSED_READING] == 'true')
        elif report.node == self._controller:
            refusal = self._refusals.newest(report)
            if refusal:
                page.tell(f'controller: {refusal}', problem=True)

    def _see_parameters(self, message: ParameterEvent) -> None:
        if self._page is None:
            return
        declared = declarations('controller')
        try:
            if message.node != self._controller:
                raise ValueError(f'expected the node {self._controller}, got {message.node}')
            given = [
                Parameter.from_parameter_msg(each)
                for each in (*message.new_parameters, *message.changed_parameters)
            ]
            known = [each for each in given if each.name in declared]
            values = {each.name: declared[each.name].check(each.value) for each in known}
        except ValueError as error:  # a type that there is none of, or a value that does not fit
            self.reject('parameters_in_force', MessageError(str(error)))
            return
        self._page.show_parameters(values)

    def _tell(self, text: str, problem: bool) -> None:
        if self._page is not None:
            self._page.tell(text, problem)

    def _record(self, recording: bool) -> None:
        """Begin a log, or ask the one that is being written to end."""
        assert self._page is not None
        if not recording:
            if self._recording is not None:
                self._recording.end()
            return
        if self._recording is None:
            name = f'viewer_{datetime.datetime.now():%Y%m%d_%H%M%S_%f}'
            bag = Path(self.settings['recordings']).resolve() / name
            try:
                self._recording = Recording(bag, self.get_namespace())
            except OSError as error:
                self._tell(str(error), problem=True)
                return
            self._page.show_recording(True)

    def _look_after_recording(self) -> None:
        if self._recording is None or not self._recording.has_ended:
            return
        assert self._page is not None
        problem, bag = self._recording.problem, self._recording.bag
        self._recording.close()
        self._recording = None
        self._page.show_recording(False)
        self._page.tell(problem or f'recorded in {bag}', bool(problem))


def _energies(
    mechanics: Mechanics, configuration: np.ndarray, velocity: np.ndarray | None
) -> tuple[float, float, float]:
    """Return kinetic, elastic and gravitational energy [J]."""
    with np.errstate(over='ignore'):  # of what moves faster than anything is plotted nothing
        kinetic = math.nan if velocity is None else mechanics.kinetic_energy(velocity)
    elastic = mechanics.elastic_energy(configuration)
    return kinetic, elastic, mechanics.gravitational_energy(configuration)


def _mean_square(values: np.ndarray) -> float:
    return float(np.mean(values**2))


def main(arguments: list[str] | None = None) -> None:
    """Run the node as a process."""
    sys.exit(run_node(ViewerNode, arguments))


if __name__ == '__main__':
    main()
