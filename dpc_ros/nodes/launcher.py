"""Launcher: wires the nodes of the loop, shows the run, ends it cleanly and reports convergence."""

from __future__ import annotations

import argparse
import datetime
import os
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from rclpy.context import Context
from rclpy.executors import Executor

from dpc_ros.bag import draw, table
from dpc_ros.nodes.by_hand import commands_by_hand
from dpc_ros.nodes.executor import make_executor
from dpc_ros.nodes.hosts import check_hosts
from dpc_ros.nodes.launch_plan import LOOP, RECORDER, LaunchPlan, make_plan
from dpc_ros.nodes.loop_node import LoopNode, finish, spared_by_collections, spin_until
from dpc_ros.nodes.monitor import Monitor
from dpc_ros.nodes.processes import STOP_TIMEOUT, NodeProcesses
from dpc_ros.nodes.stop import StopRequest
from dpc_ros.nodes.supervision import Supervision
from dpc_ros.parameters import parse_overrides
from dpc_ros.resources import config_path
from dpc_ros.threads import single_threaded_algebra

_ACTING = ('controller', 'encoder')  # what gives the body its force
_STEPS_AT_REST = 10  # under no force, before a simulator that goes by the wall clock is ended
_INTERRUPTED = 130  # exit code after Ctrl-C, as shells have it


def main(arguments: list[str] | None = None) -> None:
    """Run the launcher as a process."""
    try:
        sys.exit(_main(_parser().parse_args(arguments)))
    except KeyboardInterrupt:
        sys.exit(_complain('stopped', _INTERRUPTED))


def _main(options: argparse.Namespace) -> int:
    if options.composed and options.companions:
        return _complain(
            f'--{options.companions[0]} with --composed: drawing in the process of the loop would '
            f'hold it up; start `{options.companions[0]}_node` by itself, in another terminal',
            2,
        )
    if options.composed and options.by_hand:
        return _complain('--by-hand with --composed: nodes that are one process start as one', 2)
    try:
        plan = make_plan(
            Path(options.config),
            _overrides(options),
            Path(options.output or f'runs/{datetime.datetime.now():%Y%m%d_%H%M%S}'),
            options.namespace,
            options.record,
            0 if options.composed else options.restarts,
            options.silence,
            options.companions,
            monitored=not options.by_hand,
        )
        if plan.hosts and options.composed:
            raise ValueError('--composed: nodes that are one process are on one host')
        check_hosts(plan.hosts, os.environ, reach=not options.by_hand)
        plan.write()
    except (ValueError, OSError) as error:
        return _complain(str(error), 2)
    if options.by_hand:
        print(commands_by_hand(plan))
        return 0
    return launch(plan, options.composed)


def launch(plan: LaunchPlan, composed: bool) -> int:
    """Run a plan to its end and report.

    Args:
        plan: what to start.
        composed: all nodes in this process rather than one process each.

    Returns:
        exit code: 0, that of the node that failed, or 130 after Ctrl-C.
    """
    arguments = plan.ros_arguments() if composed else namespace_arguments(plan)
    with StopRequest(arguments) as stop:
        run = _run_composed if composed else run_processes
        outcome = run(plan, stop)
        interrupted = bool(stop)
    started_anew = f'; restarts: {_list_restarts(outcome)}' if outcome.restarts else ''
    if outcome.failure:
        return _complain(outcome.failure + started_anew, outcome.exit_code)
    if interrupted:
        kept = f'what was recorded is in {plan.folder}'
        return _complain(f'stopped; {kept}{started_anew}', _INTERRUPTED)
    return report(plan, outcome)


@dataclass
class Outcome:
    """How a run went.

    Attributes:
        failure: why it failed; empty if it did not.
        exit_code: for it.
        restarts: how often nodes were started anew.
        bags: folders of the log.
    """

    failure: str = ''
    exit_code: int = 0
    restarts: Mapping[str, int] = field(default_factory=dict)
    bags: Sequence[Path] = ()


def run_processes(plan: LaunchPlan, stop: StopRequest) -> Outcome:
    """Run each node of a plan in a process."""
    executor = make_executor('kept_wait_set', context=stop.context)
    monitor = Monitor(plan, stop.context)
    executor.add_node(monitor)
    processes = NodeProcesses(plan)
    supervision = Supervision(plan, processes, monitor)
    try:
        processes.start()
        spin_until(executor, lambda: bool(stop) or supervision.is_over())
        if supervision.failure:
            _bring_to_rest(plan, processes, monitor, executor)
    finally:
        try:
            monitor.close()
        finally:  # whatever becomes of the bar, as where nobody reads it any more
            failed_at_the_end = processes.stop()
            executor.shutdown()
            monitor.destroy_node()
    return Outcome(
        supervision.failure or failed_at_the_end,
        supervision.exit_code or int(bool(failed_at_the_end)),
        processes.restarts,
        processes.bags,
    )


def _bring_to_rest(
    plan: LaunchPlan, processes: NodeProcesses, monitor: Monitor, executor: Executor
) -> None:
    """End those who act on the body, and let it go on until it is under the force of nobody.

    In lockstep it stands still without them. By the wall clock the simulator is left to replace the
    force that has become stale (`force_timeout`), so that the log shows it.
    """
    processes.ask_to_stop(_ACTING)
    given_up_at = time.monotonic() + STOP_TIMEOUT
    spin_until(
        executor,
        lambda: not processes.are_running(_ACTING) or time.monotonic() > given_up_at,
    )
    for node in _ACTING:
        if processes.are_running([node]):
            processes.kill(node)
    simulator = plan.parameters.get('simulator', {})
    if simulator.get('time_mode') != 'realtime':
        return
    stale_after = simulator['force_timeout'] * simulator['real_time_factor']
    at_rest = monitor.seconds + stale_after + _STEPS_AT_REST / simulator['rate']
    given_up_at = time.monotonic() + STOP_TIMEOUT
    spin_until(
        executor,
        lambda: (
            monitor.seconds > at_rest
            or not processes.are_running(['simulator'])
            or time.monotonic() > given_up_at
        ),
    )


def _run_composed(plan: LaunchPlan, stop: StopRequest) -> Outcome:
    executor = make_executor('kept_wait_set', context=stop.context)
    monitor = Monitor(plan, stop.context)
    executor.add_node(monitor)
    nodes: dict[str, LoopNode] = {}
    classes = {kind: _node_class(kind) for kind in plan.nodes}
    single_threaded_algebra()  # of the libraries that these have loaded
    crash = ''
    try:
        for kind in plan.nodes:
            nodes[kind] = classes[kind](stop.context)
            executor.add_node(nodes[kind])
            nodes[kind].start()

        def is_over() -> bool:
            for node in nodes.values():
                if node.failure:
                    return True
            return nodes['simulator'].finished or bool(stop)

        with spared_by_collections():
            spin_until(executor, is_over)
        finish(executor, [nodes[kind] for kind in (*LOOP, RECORDER) if kind in nodes])
    except Exception as error:  # of any node: it takes the others with it, but not the log
        traceback.print_exc()
        crash = f'unexpected {type(error).__name__}: {error}'
    finally:
        try:
            monitor.close()
        finally:
            executor.shutdown()
            monitor.destroy_node()
            for node in nodes.values():
                node.close()
    failures = [f'{kind}: {node.failure}' for kind, node in nodes.items() if node.failure]
    failure = crash or (failures[0] if failures else '')
    return Outcome(failure, 1 if failure else 0, bags=[plan.bag] if plan.bag else [])


def _node_class(kind: str) -> Callable[[Context], LoopNode]:
    """Return what the module of a node has; who starts processes need not wait for it."""
    module = import_module(f'dpc_ros.nodes.{kind}_node')
    return getattr(module, f'{kind.capitalize()}Node')


def report(plan: LaunchPlan, outcome: Outcome) -> int:
    """Show how a run that went to its end converged, and where everything is.

    Returns:
        exit code: 0, or 1 where it can't be shown.
    """
    began_anew = {plan.leader, RECORDER} & outcome.restarts.keys()
    if plan.records('configuration') and not began_anew:
        try:
            figure = _show_convergence(plan)
        except (ValueError, OSError) as error:
            return _complain(str(error), 1)
        print()
        print(f'figure      {figure}')
    for bag in outcome.bags:
        print(f'log         {plan.where(bag)}')
    print(f'parameters  {plan.parameters_file}')
    if outcome.restarts:
        print(f'restarts    {_list_restarts(outcome)}')
    return 0


def _show_convergence(plan: LaunchPlan) -> Path:
    # These take a second, in which the nodes have started.
    from dpc_ros.bag.information import inform
    from dpc_ros.bag.report import converge
    from dpc_ros.view.report import FILE_NAME, write_report

    convergence, notes = converge(
        plan.bag,
        plan.parameters['simulator']['network'],
        plan.parameters['encoder']['checkpoint'],
    )
    page, figure = plan.folder / FILE_NAME, plan.folder / 'convergence.png'
    try:
        write_report(convergence, inform(plan.bag), notes, page)
        print(f'report      {page.resolve().as_uri()}\n')
    finally:  # a full disk takes the page, not the table
        print(table(convergence))
        for note in notes:
            print(note)
    draw(convergence, figure)
    return figure


def _list_restarts(outcome: Outcome) -> str:
    return ', '.join(f'{node} {count}' for node, count in sorted(outcome.restarts.items()))


def _overrides(options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    overrides = parse_overrides(options.set)
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


def namespace_arguments(plan: LaunchPlan) -> list[str]:
    """Return the ROS arguments of a process that is in the namespace of a plan, and no more."""
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
        '--by-hand',
        action='store_true',
        help='start nothing: write the parameters, and show the commands for each host',
    )
    parser.add_argument(
        '--restarts',
        type=int,
        default=3,
        metavar='N',
        help='in the run, over all nodes, after crashes; none with --composed; default 3',
    )
    parser.add_argument(
        '--silence',
        type=float,
        default=5.0,
        metavar='SECONDS',
        help='without a report after which a node is said to be unresponsive, and started anew '
        'after three times as long; 0 for never; default 5',
    )
    parser.add_argument(
        '--no-record', dest='record', action='store_false', help='write no log, show no table'
    )
    parser.add_argument(
        '--markers',
        dest='companions',
        action='append_const',
        const='markers',
        default=[],
        help='draw the run for RViz and Foxglove, in a process beside the loop',
    )
    parser.add_argument(
        '--viewer',
        dest='companions',
        action='append_const',
        const='viewer',
        help='show the run on a web page, in a process beside the loop',
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
