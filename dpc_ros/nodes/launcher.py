"""Launcher: wires the nodes of the loop, shows the run, ends it cleanly and reports convergence."""

from __future__ import annotations

import argparse
import datetime
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.context import Context

from dpc_ros.bag import draw, table
from dpc_ros.bag.report import converge
from dpc_ros.nodes.controller_node import ControllerNode
from dpc_ros.nodes.encoder_node import EncoderNode
from dpc_ros.nodes.executor import make_executor
from dpc_ros.nodes.launch_plan import LOOP, NODES, RECORDER, LaunchPlan, make_plan
from dpc_ros.nodes.loop_node import LoopNode, finish, spin_until
from dpc_ros.nodes.monitor import Monitor
from dpc_ros.nodes.parameters import ParameterError, declarations
from dpc_ros.nodes.processes import NodeProcesses
from dpc_ros.nodes.recorder_node import RecorderNode
from dpc_ros.nodes.simulator_node import SimulatorNode
from dpc_ros.nodes.stop import StopRequest
from dpc_ros.resources import config_path
from dpc_ros.threads import single_threaded_algebra

_NODE_CLASSES: dict[str, Callable[[Context], LoopNode]] = {
    'simulator': SimulatorNode,
    'encoder': EncoderNode,
    'controller': ControllerNode,
    'recorder': RecorderNode,
}
_INTERRUPTED = 130  # exit code after Ctrl-C, as shells have it


def main(arguments: list[str] | None = None) -> None:
    """Run the launcher as a process."""
    try:
        sys.exit(_main(_parser().parse_args(arguments)))
    except KeyboardInterrupt:
        sys.exit(_complain('stopped', _INTERRUPTED))


def _main(options: argparse.Namespace) -> int:
    try:
        plan = make_plan(
            Path(options.config),
            _overrides(options),
            Path(options.output or f'runs/{datetime.datetime.now():%Y%m%d_%H%M%S}'),
            options.namespace,
            options.record,
        )
        plan.write()
    except (ValueError, OSError) as error:
        return _complain(str(error), 2)
    return launch(plan, options.composed)


def launch(plan: LaunchPlan, composed: bool) -> int:
    """Run a plan to its end and report.

    Args:
        plan: what to start.
        composed: all nodes in this process rather than one process each.

    Returns:
        exit code: 0, that of the node that failed, or 130 after Ctrl-C.
    """
    arguments = plan.ros_arguments() if composed else _namespace_arguments(plan)
    with StopRequest(arguments) as stop:
        run = _run_composed if composed else _run_processes
        failure, code = run(plan, stop)
        interrupted = bool(stop)
    if failure:
        return _complain(failure, code)
    if interrupted:
        return _complain(f'stopped; what was recorded is in {plan.folder}', _INTERRUPTED)
    return _report(plan)


def _run_processes(plan: LaunchPlan, stop: StopRequest) -> tuple[str, int]:
    executor = make_executor('kept_wait_set', context=stop.context)
    monitor = Monitor(plan, stop.context)
    executor.add_node(monitor)
    processes = NodeProcesses(plan)
    try:
        processes.start()
        spin_until(executor, lambda: bool(stop) or processes.is_over())
    finally:
        monitor.close()
        processes.stop()
        executor.shutdown()
        monitor.destroy_node()
    return processes.failure, processes.exit_code


def _run_composed(plan: LaunchPlan, stop: StopRequest) -> tuple[str, int]:
    executor = make_executor('kept_wait_set', context=stop.context)
    monitor = Monitor(plan, stop.context)
    executor.add_node(monitor)
    nodes: dict[str, LoopNode] = {}
    single_threaded_algebra()
    try:
        for kind in plan.nodes:
            nodes[kind] = _NODE_CLASSES[kind](stop.context)
            executor.add_node(nodes[kind])
            nodes[kind].start()

        def is_over() -> bool:
            failed = any(node.failure for node in nodes.values())
            return bool(stop) or failed or nodes['simulator'].finished

        spin_until(executor, is_over)
        finish(executor, [nodes[kind] for kind in (*LOOP, RECORDER) if kind in nodes])
    finally:
        monitor.close()
        executor.shutdown()
        monitor.destroy_node()
        for node in nodes.values():
            node.close()
    failures = [f'{kind}: {node.failure}' for kind, node in nodes.items() if node.failure]
    return (failures[0], 1) if failures else ('', 0)


def _report(plan: LaunchPlan) -> int:
    if not plan.records('configuration'):
        print(f'parameters  {plan.parameters_file}')
        return 0
    try:
        convergence, notes = converge(
            plan.bag,
            plan.parameters['simulator']['network'],
            plan.parameters['encoder']['checkpoint'],
        )
        figure = plan.folder / 'convergence.png'
        print(table(convergence))
        for note in notes:
            print(note)
        draw(convergence, figure)
    except (ValueError, OSError) as error:
        return _complain(str(error), 1)
    print()
    print(f'figure      {figure}')
    print(f'log         {plan.bag}')
    print(f'parameters  {plan.parameters_file}')
    return 0


def _overrides(options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    overrides: dict[str, dict[str, Any]] = {}
    for item in options.set:
        name, equals, value = item.partition('=')
        node, dot, parameter = name.partition('.')
        if not (equals and dot and parameter):
            raise ValueError(f'--set {item}: expected <node>.<parameter>=<value>')
        known = declarations(node) if node in NODES else {}
        try:
            parsed = known[parameter].parse(value) if parameter in known else value
        except ParameterError as error:
            raise ParameterError(f'{node}: {error}') from error
        overrides.setdefault(node, {})[parameter] = parsed
    if options.target is not None:
        overrides.setdefault('controller', {})['target'] = options.target
    if options.law is not None:
        overrides.setdefault('controller', {})['law'] = options.law
    if options.mass is not None:
        for node in LOOP:
            overrides.setdefault(node, {})['actuated_mass'] = options.mass
    if options.duration is not None:
        overrides.setdefault('simulator', {})['duration'] = options.duration
    if options.realtime:
        overrides.setdefault('simulator', {})['time_mode'] = 'realtime'
    return overrides


def _namespace_arguments(plan: LaunchPlan) -> list[str]:
    if plan.namespace == '/':
        return []
    return ['--ros-args', '-r', f'__ns:={plan.namespace}']


def _complain(text: str, code: int) -> int:
    print(f'error: {text}', file=sys.stderr)
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='launcher', description=__doc__)
    parser.add_argument(
        '--config', default=str(config_path('demo.yaml')), help='ROS 2 parameter file of the run'
    )
    parser.add_argument(
        '--target', help='simulation:<number>@<step>, rest, or a JSON file with a target'
    )
    parser.add_argument('--law', help='lqr, reduced_equilibrium, transpose, paper, or your own')
    parser.add_argument('--mass', type=int, help='number of the actuated mass')
    parser.add_argument('--duration', type=float, help='simulated time [s]; 0 runs until Ctrl-C')
    parser.add_argument('--realtime', action='store_true', help='by the wall clock, not lockstep')
    parser.add_argument('--output', help='folder of the run, new; default runs/<date>_<time>')
    parser.add_argument('--composed', action='store_true', help='all nodes in one process')
    parser.add_argument(
        '--no-record', dest='record', action='store_false', help='write no log, show no table'
    )
    parser.add_argument('--namespace', default='/', help='of all nodes and topics, as /body_2')
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NODE.PARAMETER=VALUE',
        help='override one parameter; may be given several times',
    )
    return parser


if __name__ == '__main__':
    main()
