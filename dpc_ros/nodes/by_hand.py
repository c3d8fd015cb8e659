"""The commands that start the nodes of a plan, for people who start them themselves."""

from __future__ import annotations

import os
import shlex
import sys

from dpc_ros.nodes.hosts import Host, agreed, environment_there
from dpc_ros.nodes.launch_plan import LaunchPlan


def commands_by_hand(plan: LaunchPlan) -> str:
    """Return what to type here: what takes the parameters to a host, and a line for each node.

    Args:
        plan: what to start; its parameter file must have been written.
    """
    here = [kind for kind in plan.nodes if kind not in plan.hosts]
    lines = ['# here', *(_command(plan, kind) for kind in here)] if here else []
    for host in {host.name: host for host in plan.hosts.values()}.values():
        folder = shlex.quote(host.run_folder(plan.folder))
        take = host.typed(f'mkdir -p {folder} && cat > {folder}/parameters.yaml', terminal=False)
        lines += ['', f'# {host.name}', f'{take} < {shlex.quote(str(plan.parameters_file))}']
        lines += [
            host.typed(_command(plan, kind, host))
            for kind in plan.nodes
            if plan.hosts.get(kind) == host
        ]
    return '\n'.join(lines).lstrip('\n')


def _command(plan: LaunchPlan, kind: str, host: Host | None = None) -> str:
    """Return the command of a node as a shell on its own host takes it."""
    arguments = ['-m', f'dpc_ros.nodes.{kind}_node', *plan.ros_arguments(kind)]
    if host is not None:
        variables = environment_there(host, os.environ)
        moved = [host.moved(argument, plan.folder) for argument in arguments]
        return shlex.join([*_setting(variables), host.python, *moved])
    variables = agreed(os.environ) if plan.hosts else {}  # which a terminal of its own may lack
    return shlex.join([*_setting(variables), sys.executable, *arguments])


def _setting(variables: dict[str, str]) -> list[str]:
    assignments = [f'{name}={value}' for name, value in variables.items()]
    return ['env', *assignments] if assignments else []
