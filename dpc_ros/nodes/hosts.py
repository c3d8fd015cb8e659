"""Which nodes of a run are on other hosts, and how these are reached."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from dpc_ros.parameters import ParameterError

SECTION = 'hosts'  # of a parameter file for the launcher
# Without a terminal, and with an end for who waits in vain: for a password, or for a dead link.
_SSH = (
    'ssh',
    '-T',
    '-o',
    'BatchMode=yes',
    '-o',
    'ConnectTimeout=10',
    '-o',
    'ServerAliveInterval=5',
)
_KEYS = ('nodes', 'ssh', 'command', 'python', 'folder', 'environment')
_FORWARDED = ('ROS_DOMAIN_ID', 'RMW_IMPLEMENTATION')  # in which all nodes of a run must agree
_RANGE, _PEERS = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS'
_TOO_NEAR = ('LOCALHOST', 'OFF')


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
    environment = entry.get('environment', {})
    if not isinstance(environment, dict):
        raise ParameterError(
            f'{origin}: environment: expected names and values, got {environment!r}'
        )
    return Host(
        name,
        _texts(entry.get('nodes', []), f'{origin}: nodes'),
        command=command,
        environment={str(key): str(value) for key, value in environment.items()},
        **texts,
    )


def _texts(content: Any, origin: str) -> tuple[str, ...]:
    if not isinstance(content, list) or not all(isinstance(each, str) for each in content):
        raise ParameterError(f'{origin}: expected a list of texts, got {content!r}')
    return tuple(content)


def environment_there(host: Host, here: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of the nodes on a host: its own, and those that all must agree in.

    Args:
        host: where.
        here: the variables of the launcher.
    """
    return {name: here[name] for name in _FORWARDED if name in here} | dict(host.environment)


def check_discovery(hosts: Mapping[str, Host], here: Mapping[str, str]) -> None:
    """Make sure that no side is told to keep to its own host.

    Args:
        hosts: by kind of node.
        here: the variables of the launcher.

    Raises:
        ParameterError: one is, and how to change it.
    """
    sides = {'here': here, **{host.name: host.environment for host in hosts.values()}}
    for name, variables in sides.items() if hosts else ():
        reach = variables.get(_RANGE, '')
        if reach == 'OFF' or (reach in _TOO_NEAR and not _finds_others(sides)):
            raise ParameterError(
                f'{_RANGE}={reach} ({name}) keeps the nodes of the run from each other: '
                f'unset it, or list the addresses of the other hosts in {_PEERS}'
            )


def _finds_others(sides: Mapping[str, Mapping[str, str]]) -> bool:
    """Return whether anyone is told where the others are: one side's word is enough for both."""
    return any(_PEERS in variables for variables in sides.values())
