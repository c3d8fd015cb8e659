"""Processes of a benchmark: those of a run, each node one, and the end of all of them."""

import contextlib
import os
import subprocess
import sys

from dpc_ros.nodes.launch_plan import make_plan
from dpc_ros.resources import config_path

ENVIRONMENT = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
READERS = {'simulator': 'encoder', 'encoder': 'controller', 'controller': 'simulator'}


def start(*arguments, **options):
    """Start Python on something of ours; what it says is of no interest unless it is asked for."""
    quiet = {'stdout': subprocess.DEVNULL, 'stderr': subprocess.DEVNULL}
    return subprocess.Popen([sys.executable, *arguments], env=ENVIRONMENT, **(quiet | options))


def plan_of(folder, record=True, companions=(), **parameters):
    """Return the plan of a run of the demonstration without a launcher.

    Args:
        folder: of the run, new.
        record: whether there is a recorder.
        companions: what looks on.
        parameters: by kind of node, that differ from the demonstration's; `all` for every node.
    """
    of_all = parameters.pop('all', {})
    recorder = ['recorder'] if record else []
    overrides = {
        kind: {'expected_subscribers': [reader, *recorder], **of_all, **parameters.get(kind, {})}
        for kind, reader in READERS.items()
    }
    if record:
        overrides['recorder'] = {**of_all, **parameters.get('recorder', {})}
    plan = make_plan(
        config_path('demo.yaml'), overrides, folder, record=record, companions=companions
    )
    plan.write()
    return plan


@contextlib.contextmanager
def nodes_of(plan, **programs):
    """Start each node of a plan, and end them, the recorder last.

    Args:
        plan: of the run.
        programs: by kind of node, arguments of Python for another program than the node's own.
    """
    nodes = {}
    try:
        for kind in plan.nodes:
            program = programs.get(kind, ['-m', f'dpc_ros.nodes.{kind}_node'])
            nodes[kind] = start(*program, *plan.ros_arguments())
        yield nodes
    finally:
        end([nodes[kind] for kind in reversed(plan.nodes) if kind in nodes])


def end(processes):
    """Let processes end, one after the other."""
    for process in processes:
        process.terminate()
        process.wait()
