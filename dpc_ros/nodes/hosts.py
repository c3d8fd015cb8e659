"""Which nodes of a run are on other hosts, and how these are reached."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dpc_ros.nodes.discovery import LOCAL_VARIABLE, PEERS_VARIABLE, RANGE_VARIABLE
from dpc_ros.parameters import ParameterError

SECTION = 'hosts'  # of a parameter file for the launcher
# Without a terminal; a connection for each node, with an end for who waits in vain: for a password,
# or for a dead link.
_SSH = (
    *('ssh', '-T', '-o', 'BatchMode=yes', '-o', 'ControlMaster=no', '-o', 'ControlPath=none'),
    *('-o', 'ConnectTimeout=10', '-o', 'ServerAliveInterval=5', '-o', 'ServerAliveCountMax=3'),
)
_KEYS = ('nodes', 'ssh', 'command', 'python', 'folder', 'environment')
# In which all nodes of a run must agree, and what they are where they are not set.
_FORWARDED = {'ROS_DOMAIN_ID': '0', 'RMW_IMPLEMENTATION': ''}


@dataclass(frozen=True)
class Host:
    """A host that is not this one.

    Attributes:
        name: what the run calls it.
        nodes: kinds of the nodes that run there.
        ssh: what ssh calls it, `user@address`; empty where it is reached by a command.
        command: what runs a command there in place of ssh, as `docker exec -i <container>`.
        python: the interpreter there, one that has this package.
        folder: there, for runs; where it is relative, from where a command begins (ssh: home).
        environment: variables of the nodes there.
    """

    name: str
    nodes: tuple[str, ...]
    ssh: str = ''
    command: tuple[str, ...] = ()
    python: str = 'python3'
    folder: str = 'dpc_ros_runs'
    environment: Mapping[str, str] = field(default_factory=dict)

    def reaching(self, *command: str) -> list[str]:
        """Return the command here that runs a command there."""
        if self.command:
            return [*self.command, *command]
        return [*_SSH, self.ssh, shlex.join(command)]  # a shell there takes it apart

    def typed(self, line: str, terminal: bool = True) -> str:
        """Return what to type here so that a shell there runs a line.

        Args:
            line: for the shell.
            terminal: whether it gets this terminal, and with it a Ctrl-C.
        """
        if self.command:
            return shlex.join([*self.command, 'sh', '-c', line])
        return shlex.join(['ssh', *(['-t'] if terminal else []), self.ssh, line])

    def moved(self, text: str, run: Path) -> str:
        """Return a text with the folder of a run there where it has that of the run here."""
        return text.replace(f'{run}/', f'{self.run_folder(run)}/')

    def run_folder(self, run: Path) -> str:
        """Return the folder of a run there, by its folder here."""
        return f'{self.folder}/{run.name}'


def read_hosts(content: Any, origin: str, kinds: tuple[str, ...]) -> dict[str, Host]:
    """Return the host of each kind of node that a section names.

    Args:
        content: of the section: names of hosts, and what is known of each.
        origin: what to call it in an error.
        kinds: of the nodes that can run on another host.

    Raises:
        ParameterError: it has another form, names what there is none of, or a node twice.
    """
    found: dict[str, Host] = {}
    if not isinstance(content, dict):
        raise ParameterError(f'{origin}: expected hosts by name, got {content!r}')
    for name, entry in content.items():
        host = _read_host(str(name), entry, f'{origin}: {name}')
        for kind in host.nodes:
            if kind not in kinds:
                raise ParameterError(
                    f'{origin}: {name}: unknown node {kind!r}, expected some of {", ".join(kinds)}'
                )
            if kind in found:
                raise ParameterError(
                    f'{origin}: expected {kind} on one host, got {found[kind].name} and {name}'
                )
            found[kind] = host
    return found


def _read_host(name: str, entry: Any, origin: str) -> Host:
    if not isinstance(entry, dict):
        raise ParameterError(f'{origin}: expected {", ".join(_KEYS)}, got {entry!r}')
    for key in entry:
        if key not in _KEYS:
            raise ParameterError(f'{origin}: unknown {key!r}, expected some of {", ".join(_KEYS)}')
    command = _texts(entry.get('command', []), f'{origin}: command')
    if command and 'ssh' in entry:
        raise ParameterError(f'{origin}: expected ssh or command, got both')
    texts = {key: entry[key] for key in ('ssh', 'python', 'folder') if key in entry}
    if not command:
        texts.setdefault('ssh', name)
    for key, text in texts.items():
        if not isinstance(text, str) or not text or text.startswith('-'):
            raise ParameterError(f'{origin}: {key}: expected a text, got {text!r}')
        if text.startswith('~'):
            raise ParameterError(
                f'{origin}: {key}: expected no ~, got {text!r}: without it, ssh begins at home'
            )
    return Host(
        name,
        _texts(entry.get('nodes', []), f'{origin}: nodes'),
        command=command,
        environment=_variables(entry.get('environment', {}), f'{origin}: environment'),
        **texts,
    )


def _texts(content: Any, origin: str) -> tuple[str, ...]:
    if not isinstance(content, list) or not all(isinstance(each, str) for each in content):
        raise ParameterError(f'{origin}: expected a list of texts, got {content!r}')
    return tuple(content)


def _variables(content: Any, origin: str) -> dict[str, str]:
    if not isinstance(content, dict):
        raise ParameterError(f'{origin}: expected names and values, got {content!r}')
    for name, value in content.items():
        if type(value) not in (str, int):  # YAML has made true of `on`, a number of `1e3`
            raise ParameterError(
                f'{origin}: {name}: expected a text, got {value!r}: put it in quotes'
            )
    return {str(name): str(value) for name, value in content.items()}


def environment_there(host: Host, here: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of the nodes on a host: its own, and those that all must agree in.

    Args:
        host: where.
        here: the variables of the launcher.
    """
    return agreed(here) | dict(host.environment)


def agreed(here: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of the launcher in which all nodes of a run must agree."""
    every = {name: here.get(name, default) for name, default in _FORWARDED.items()}
    return {name: value for name, value in every.items() if value}


def check_hosts(hosts: Mapping[str, Host], here: Mapping[str, str], reach: bool = True) -> None:
    """Make sure that hosts can be reached, and that no side is told to keep to itself.

    Args:
        hosts: by kind of node.
        here: the variables of the launcher.
        reach: whether they are to be reached from here.

    Raises:
        ParameterError: there is no such program here, or one side is told to, and how to change it.
    """
    sides = {'here': here, **{host.name: host.environment for host in hosts.values()}}
    for host in hosts.values():
        program = host.reaching()[0]
        if reach and shutil.which(program) is None:
            raise ParameterError(f'{SECTION}: {host.name}: there is no program {program!r} here')
    for name, variables in sides.items() if hosts else ():
        knows_peers = any(each.get(PEERS_VARIABLE) for each in sides.values())
        told = _keeps_to_itself(variables, knows_peers)
        if told:
            way = f', or list the addresses of the hosts in {PEERS_VARIABLE}'
            raise ParameterError(
                f'{told} ({name}) keeps the nodes of the run from each other: unset it'
                + (way if RANGE_VARIABLE in told else '')
            )


def _keeps_to_itself(variables: Mapping[str, str], knows_peers: bool) -> str:
    """Return which variable lets nodes find none on other hosts; empty where none does.

    Args:
        variables: of the nodes.
        knows_peers: whether any side is told where the others are: one's word is enough for both.
    """
    if variables.get(LOCAL_VARIABLE) == '1':
        return f'{LOCAL_VARIABLE}=1'
    reach = variables.get(RANGE_VARIABLE, '')
    if reach == 'OFF' or (reach == 'LOCALHOST' and not knows_peers):
        return f'{RANGE_VARIABLE}={reach}'
    return ''
