"""What the launcher starts: parameters of each node, merged and checked before anything runs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from rclpy.exceptions import InvalidNamespaceException
from rclpy.validate_namespace import validate_namespace

from dpc_ros.nodes.hosts import SECTION, Host, read_hosts
from dpc_ros.nodes.topic_selection import TopicSelection
from dpc_ros.parameters import ParameterError, declarations, node_parameters, read_sections

LOOP = ('simulator', 'encoder', 'controller')
RECORDER = 'recorder'
COMPANIONS = ('markers', 'viewer')  # that only look on: the run is the same with or without them
NODES = (*LOOP, RECORDER, *COMPANIONS)
LAUNCHER = 'launcher'
# What a companion is not given it has of the controller.
_OF_A_MODEL = (
    'encoder',
    'projection_iterations',
    'actuated_mass',
    'gravity_magnitude',
    'gravity_angle',
    'largest_force',
)
_STARTUP_TIMEOUT = 120.0  # s, for nodes that compile their kernels on the first start
_OUTPUTS = {'simulator': 'configuration', 'encoder': 'latent_state', 'controller': 'control_force'}
MONITORED = ('configuration', 'control_force')  # topics that the launcher itself reads


@dataclass(frozen=True)
class LaunchPlan:
    """Parameters by node, and where the run is kept.

    Attributes:
        parameters: of each node that is started, every value given explicitly.
        folder: of the run: parameters, logs of the nodes, bag, figure.
        namespace: of all nodes and topics.
        leader: kind of the node whose end is the end of the run.
        remappings: of each kind of node, `from:=to`.
        restarts: how often in the run a node that has crashed is started anew.
        silence: time [s] without a report of a node after which it is unresponsive; 0 is never.
        companions: kinds of those nodes that only look on; what happens to them ends no run.
        hosts: of the nodes that run on another one.
    """

    parameters: Mapping[str, Mapping[str, Any]]
    folder: Path
    namespace: str
    leader: str = 'simulator'
    remappings: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    restarts: int = 0
    silence: float = 0.0
    companions: tuple[str, ...] = ()
    hosts: Mapping[str, Host] = field(default_factory=dict)

    @property
    def nodes(self) -> tuple[str, ...]:
        """Kinds of the nodes, the recorder first: it misses nothing."""
        return tuple(self.parameters)

    @property
    def duration(self) -> float:
        """Simulated time of the run [s], infinite where it has no end."""
        return self.parameters[self.leader]['duration'] or math.inf

    @property
    def parameters_file(self) -> Path:
        """The parameter file that every node is given."""
        return self.folder / 'parameters.yaml'

    @property
    def bag(self) -> Path | None:
        """Folder of the log, none without a recorder."""
        return Path(self.parameters[RECORDER]['bag']) if RECORDER in self.parameters else None

    def where(self, bag: Path) -> str:
        """Return where a bag of the run is: on another host as `<host>:<path>`."""
        host = self.hosts.get(RECORDER)
        if host is None:
            return str(bag)
        return f'{host.ssh or host.name}:{host.moved(str(bag), self.folder)}'

    def records(self, topic: str) -> bool:
        """Return whether a topic of the loop is in the log, and that on this host."""
        return (
            RECORDER in self.parameters
            and RECORDER not in self.hosts
            and _selects(self.parameters[RECORDER], self.namespace, topic)
        )

    def write(self) -> None:
        """Make the run's folder with its parameter file.

        Raises:
            FileExistsError: the folder exists.
        """
        self.folder.mkdir(parents=True)
        content = {
            f'/**/{node}': {'ros__parameters': dict(values)}
            for node, values in self.parameters.items()
        }
        self.parameters_file.write_text(yaml.safe_dump(content, sort_keys=False))

    def ros_arguments(self, node: str = '') -> list[str]:
        """Return the arguments that hand parameters and remappings to the process of a node."""
        arguments = ['--ros-args', '--params-file', str(self.parameters_file)]
        if node == RECORDER and node in self.hosts:  # by name, where their host can move them
            arguments += [
                '-p',
                f'bag:={self.bag}',
                '-p',
                f'parameters_file:={self.parameters_file}',
            ]
        for remapping in self.remappings.get(node, ()):
            arguments += ['-r', remapping]
        return [*arguments, '-r', f'__ns:={self.namespace}'] if self.namespace != '/' else arguments


def make_plan(
    config: Path,
    overrides: Mapping[str, Mapping[str, Any]],
    folder: Path,
    namespace: str = '/',
    record: bool = True,
    restarts: int = 0,
    silence: float = 0.0,
    companions: Iterable[str] = (),
    monitored: bool = True,
) -> LaunchPlan:
    """Merge a parameter file with overrides and check every value.

    Args:
        config: a ROS 2 parameter file with the sections `/**`, `simulator`, `encoder`, ….
        overrides: values by node that win over the file.
        folder: of the run; must not exist yet.
        namespace: of all nodes, with or without the leading `/`.
        record: whether a recorder is started.
        restarts: see `LaunchPlan`; with any, a lockstep simulator waits longer for an answer.
        silence: see `LaunchPlan`.
        companions: some of `COMPANIONS`, to be started beside the loop; network and checkpoint are
            those of simulator and encoder where they are given no others.
        monitored: whether the launcher reads along, which the nodes then wait for.

    Raises:
        FileExistsError: the folder exists.
        FileNotFoundError: there is no such parameter file.
        ParameterError: a section or parameter is unknown, of the wrong type or out of range.
    """
    namespace = '/' + namespace.strip('/')
    try:
        validate_namespace(namespace)
    except InvalidNamespaceException as error:
        raise ParameterError(f'namespace {namespace!r}: {str(error).splitlines()[0]}') from error
    if folder.exists():
        raise FileExistsError(f'{folder} exists already: choose another --output')
    if not config.is_file():
        raise FileNotFoundError(f'no parameter file {config}')
    text = config.read_text(errors='replace')
    sections = read_sections(text, str(config), others=(SECTION,))
    nodes = ((RECORDER,) if record else ()) + LOOP
    _check_known(config, sections, overrides)
    folder = folder.resolve()
    if restarts < 0 or not silence >= 0:
        raise ParameterError(
            f'expected restarts and silence of 0 or more, got {restarts} and {silence:g}'
        )
    simulator = {'startup_timeout': _STARTUP_TIMEOUT}
    if restarts:  # a node that is started anew needs as long as at first
        simulator['response_timeout'] = _STARTUP_TIMEOUT
    defaults: dict[str, dict[str, Any]] = {
        'simulator': simulator,
        RECORDER: {
            'bag': str(folder / 'bag'),
            'parameters_file': str(folder / 'parameters.yaml'),
        },
    }
    given = {
        node: {
            **defaults.get(node, {}),
            **sections.get('/**', {}),
            **sections.get(node, {}),
            **overrides.get(node, {}),
        }
        for node in nodes
    }
    parameters = {node: node_parameters(node, given[node]) for node in nodes}
    if 'solve_in_background' not in given['controller']:
        realtime = parameters['simulator']['time_mode'] == 'realtime'
        parameters['controller']['solve_in_background'] = realtime
    observes = parameters['encoder']['observer'] != 'none'
    _check_observer(parameters['encoder'], parameters['simulator'])
    for node, output in _OUTPUTS.items():
        if 'expected_subscribers' not in given[node]:
            readers = [*declarations(node)['expected_subscribers'].default]
            if RECORDER in nodes and _selects(parameters[RECORDER], namespace, output):
                readers.append(RECORDER)
            if monitored and output in MONITORED:
                readers.append(LAUNCHER)
            if node == 'controller' and observes:
                readers.append('encoder')
            parameters[node]['expected_subscribers'] = readers
    models = {
        **{name: parameters['controller'][name] for name in _OF_A_MODEL},
        'network': parameters['simulator']['network'],
        'checkpoint': parameters['encoder']['checkpoint'],
    }
    companions = tuple(dict.fromkeys(companions))
    for kind in companions:
        own = sections.get(kind, {}), overrides.get(kind, {})
        parameters[kind] = node_parameters(kind, sections.get('/**', {}), models, *own)
    return LaunchPlan(
        parameters,
        folder,
        namespace,
        restarts=restarts,
        silence=silence,
        companions=companions,
        hosts=_hosts(text, str(config), tuple(parameters)),
    )


def _hosts(text: str, origin: str, kinds: tuple[str, ...]) -> dict[str, Host]:
    """Return the hosts that a parameter file names, of the kinds of nodes that are started.

    Raises:
        ParameterError: the section has another form, or is unreasonable.
    """
    hosts = read_hosts((yaml.safe_load(text) or {}).get(SECTION, {}), f'{origin}: {SECTION}', NODES)
    return {kind: host for kind, host in hosts.items() if kind in kinds}


def _check_observer(encoder: Mapping[str, Any], simulator: Mapping[str, Any]) -> None:
    """Make sure that an encoder with an observer models the body that the simulator moves.

    Raises:
        ParameterError: it does not, or it is to measure a delay where there is none.
    """
    if encoder['measure_delay'] and simulator['time_mode'] != 'realtime':
        raise ParameterError(
            'encoder: measure_delay: expected a simulator with time_mode realtime; in lockstep a '
            'force acts at once'
        )
    if encoder['observer'] == 'none':
        return
    for name in ('actuated_mass', 'gravity_magnitude', 'gravity_angle'):
        if encoder[name] != simulator[name]:
            raise ParameterError(
                f'encoder: {name}: expected that of the simulator, {simulator[name]}, got '
                f'{encoder[name]}: an observer has to know the body'
            )


def _selects(recorder: Mapping[str, Any], namespace: str, topic: str) -> bool:
    try:
        selection = TopicSelection(recorder['topics'], recorder['exclude'], namespace)
    except ValueError as error:
        raise ParameterError(f'{RECORDER}: {error}') from error
    return selection.selects(f'{namespace.rstrip("/")}/{topic}')


def _check_known(
    config: Path,
    sections: Mapping[str, Mapping[str, Any]],
    overrides: Mapping[str, Mapping[str, Any]],
) -> None:
    every = {name for node in NODES for name in declarations(node)}
    for origin, part in ((str(config), sections), ('the command line', overrides)):
        for section, values in part.items():
            if section != '/**' and section not in NODES:
                raise ParameterError(
                    f'{origin}: unknown node {section!r}, expected one of {", ".join(NODES)}'
                )
            known = every if section == '/**' else declarations(section).keys()
            for name in values:
                if name not in known:
                    raise ParameterError(
                        f'{origin}: unknown parameter {name!r}; {section} has '
                        f'{", ".join(sorted(known))}'
                    )
