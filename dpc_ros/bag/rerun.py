"""Running a log again: its configurations through encoder and controller, without ROS.

The regression test of a law or a checkpoint: the same inputs, are the answers still the same?
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from dpc_ros.bag.metadata import MACHINE_RECORD, NODE_PARAMETERS_RECORD, PARAMETERS_RECORD
from dpc_ros.bag.signals import Announcement, Deviation, Key, Signals, deviation, read_signals
from dpc_ros.bag.splits import BagError
from dpc_ros.control import Answers, OnlineController, OnlineEncoder, Target, TargetError
from dpc_ros.machine import describe_machine
from dpc_ros.parameters import ParameterError, declarations, node_parameters, read_sections
from dpc_ros.threads import single_threaded_algebra

TOLERANCE = 1e-9  # relative, where the same bits can't be expected
RERUN_NODES = ('encoder', 'controller')
_LOGGED_NODES = ('simulator', *RERUN_NODES)

Overrides = Mapping[str, Mapping[str, Any]]
Columns = Mapping[str, Mapping[Key, np.ndarray]]


@dataclass(frozen=True)
class Rerun:
    """What came out of running a log again.

    Attributes:
        deviations: of latent states, their velocities and forces.
        is_exact: whether the same bits were asked for, else a relative tolerance of 1e-9.
        reason: why so.
        notes: what else there is to know.
    """

    deviations: tuple[Deviation, ...]
    is_exact: bool
    reason: str
    notes: tuple[str, ...] = ()

    @property
    def is_identical(self) -> bool:
        """Whether every bit is the same."""
        return all(each.is_identical for each in self.deviations)

    @property
    def passed(self) -> bool:
        """Whether all is the same, as closely as was asked for."""
        if self.is_exact:
            return self.is_identical
        return all(each.is_within(TOLERANCE) for each in self.deviations)


def rerun(
    bag: str | Path,
    overrides: Overrides | None = None,
    namespace: str | None = None,
    progress: bool = False,
) -> Rerun:
    """Feed the configurations of a log through its encoder and controller again.

    What was answered then is answered now, and nothing else: a configuration without a latent
    state in the log, or a latent state without a force, did not reach the node in time.

    Args:
        bag: folder of the bag, or its MCAP file.
        overrides: parameters by node that win over those of the log.
        namespace: of the topics, the only one in the log where left out.
        progress: show a bar.

    Raises:
        BagError: the bag can't be read, holds no answers, does not say its parameters, or belongs
            to other models than the parameters name.
        ValueError: a parameter, network or checkpoint can't be used.
    """
    overrides = overrides or {}
    signals = read_signals(bag, namespace)
    check_answers(signals)
    parameters = logged_parameters(signals, overrides)
    encoder = OnlineEncoder(parameters['encoder'])
    controller = OnlineController(parameters['controller'])
    notes = parameter_notes(signals) + _check_models(signals, encoder, controller, overrides)
    if parameters['encoder']['measure_delay']:
        notes += ('the log does not say the delays that were measured: none is foreseen',)
    kept = overrides.get('controller', {})
    with single_threaded_algebra():
        latents = _encode(signals, encoder, progress)
        forces, problems = _control(
            signals, controller, parameters['controller'], kept, latents, progress
        )
    repeated = {
        'latent': {key: latent for key, (latent, _) in latents.items()},
        'latent_velocity': {key: velocity for key, (_, velocity) in latents.items()},
        'force': forces,
    }
    return judge(signals, repeated, parameters, (*notes, *problems))


def check_answers(signals: Signals) -> None:
    """Make sure that a log has something to compare with.

    Raises:
        BagError: it holds no latent states or no forces.
    """
    for name, signal in (('latent states', signals.latent), ('forces', signals.force)):
        if not signal.samples:
            raise BagError(
                f'{signals.path}: expected a log of a closed loop, but it holds no {name}: nothing '
                'to compare, record latent_state and control_force, too'
            )


def judge(
    signals: Signals,
    repeated: Columns,
    parameters: Overrides,
    notes: tuple[str, ...] = (),
) -> Rerun:
    """Compare what was computed again with a log, as closely as that log allows."""
    is_exact, reason = _criterion(signals, parameters)
    deviations = tuple(
        deviation(name, recorded, repeated[name]) for name, recorded in signals.columns().items()
    )
    return Rerun(deviations, is_exact, reason, notes)


def logged_parameters(signals: Signals, overrides: Overrides) -> dict[str, dict[str, Any]]:
    """Return the parameters of simulator, encoder and controller that a log was made with.

    What a node answered when the recorder asked it wins over the parameter file of the run.

    Args:
        signals: of the log.
        overrides: values by node that win over them.

    Raises:
        BagError: the log does not say them.
        ParameterError: a value is of the wrong type or out of range, or an override is for another
            node or unknown.
    """
    for node, values in overrides.items():
        known = declarations(node) if node in RERUN_NODES else {}
        for name in values:
            if name not in known:
                raise ParameterError(
                    f'no parameter {node}.{name}: expected one of '
                    f'{", ".join(RERUN_NODES)} (config/nodes/ lists them)'
                )
    of_file, answered = _of_file(signals), _answered(signals)
    missing = [node for node in _LOGGED_NODES if node not in answered]
    if of_file is None and missing:
        raise BagError(
            f'{signals.path}: expected a log that holds its parameters ({PARAMETERS_RECORD}, or '
            f'{NODE_PARAMETERS_RECORD} of each node), got none of {", ".join(missing)} in '
            f'{signals.namespace or "/"}: record with the launcher, with `parameters_file`, or '
            'start the recorder first'
        )
    return {
        node: node_parameters(
            node,
            (of_file or {}).get(node, {}),
            answered.get(node, {}),
            overrides.get(node, {}),
        )
        for node in _LOGGED_NODES
    }


def parameter_notes(signals: Signals) -> tuple[str, ...]:
    """Return where what the nodes of a log answered is not what its parameter file says.

    Raises:
        ParameterError: a record of parameters can't be read, or a value can't be used.
    """
    of_file, answered = _of_file(signals), _answered(signals)
    if of_file is None:
        return ('the log holds no parameter file: its nodes said their parameters',)
    notes = []
    for node, values in answered.items():
        expected = node_parameters(node, of_file[node])
        for name, value in node_parameters(node, of_file[node], values).items():
            if value != expected[name]:
                notes.append(
                    f'{node}.{name} is {value}, as the node said, not {expected[name]}, as the '
                    'parameter file of the log'
                )
    return tuple(notes)


def _of_file(signals: Signals) -> dict[str, dict[str, Any]] | None:
    """Return the values by node of a log's parameter file, None where it has none."""
    text = signals.metadata.get(PARAMETERS_RECORD, {}).get('yaml')
    if text is None:
        return None
    sections = read_sections(text, f'{signals.path}: {PARAMETERS_RECORD}')
    common = sections.get('/**', {})
    return {node: {**common, **sections.get(node, {})} for node in _LOGGED_NODES}


def _answered(signals: Signals) -> dict[str, dict[str, Any]]:
    """Return the values by node that the nodes in the namespace of a run answered."""
    texts = signals.metadata.get(NODE_PARAMETERS_RECORD, {})
    found = {}
    for node in _LOGGED_NODES:
        name = f'{signals.namespace}/{node}'
        if name in texts:
            sections = read_sections(texts[name], f'{signals.path}: {NODE_PARAMETERS_RECORD}')
            found[node] = sections.get(name.lstrip('/'), {})
    return found


def _criterion(signals: Signals, parameters: Overrides) -> tuple[bool, str]:
    machine, here = signals.metadata.get(MACHINE_RECORD), describe_machine()
    if parameters['simulator']['time_mode'] != 'lockstep':
        return False, 'no lockstep log'
    if machine is None:
        return False, 'the log does not say its machine'
    other = [f'{name} {machine.get(name)}' for name in here if machine.get(name) != here[name]]
    if other:
        return False, f'a log of another machine: {", ".join(other)}'
    return True, 'a lockstep log of this machine'


def _check_models(
    signals: Signals, encoder: OnlineEncoder, controller: OnlineController, overrides: Overrides
) -> tuple[str, ...]:
    network = encoder.network.identifier
    if controller.network.identifier != network:
        raise BagError(
            f'expected one network, got {network} for the encoder and '
            f'{controller.network.identifier} for the controller'
        )
    if signals.configuration.frame_id != network:
        raise BagError(
            f'{signals.path}: its configurations are those of {signals.configuration.frame_id}, '
            f'not of {network}: name the network by --set encoder.network=… and '
            '--set controller.network=…'
        )
    notes = []
    for node, model in (('encoder', encoder), ('controller', controller)):
        expected, found = signals.latent.frame_id, model.checkpoint.identifier
        if not expected or found == expected:
            continue
        if 'checkpoint' not in overrides.get(node, {}):
            raise BagError(
                f'{signals.path}: its latent states are those of {expected}, but the checkpoint of '
                f'the {node} is now {found}: name one by --checkpoint'
            )
        notes.append(f'the {node} has the checkpoint {found}, the log {expected}')
    if encoder.checkpoint.identifier != controller.checkpoint.identifier:
        raise BagError(
            f'expected one checkpoint, got {encoder.checkpoint.identifier} for the encoder and '
            f'{controller.checkpoint.identifier} for the controller'
        )
    counts = {signals.configuration.epochs, signals.latent.epochs, signals.force.epochs}
    if len(counts) > 1:
        notes.append(f'the topics have different numbers of epochs, {sorted(counts)}')
    if signals.force.samples and not signals.in_force:
        notes.append('the log has no target_in_force: from when on targets counted is a guess')
    return tuple(notes)


def _encode(
    signals: Signals, encoder: OnlineEncoder, progress: bool
) -> dict[Key, tuple[np.ndarray, np.ndarray]]:
    latents: dict[Key, tuple[np.ndarray, np.ndarray]] = {}
    forces = iter(signals.force.samples.items())
    following = next(forces, None)
    answers = Answers()
    for key in _shown(signals.latent.samples, 'encoding', progress):
        answer, question = signals.latent.samples[key], signals.configuration.samples.get(key)
        # An observer knows the forces that had come when it estimated.
        while following is not None and following[1].publish_ns <= answer.publish_ns:
            (_, stamp), force = following
            if encoder.observer is not None:
                encoder.observer.acted(stamp, force.values[0])
            following = next(forces, None)
        if question is None:
            continue
        if answers.begins_anew(key[1]) or answer.from_restarted:
            encoder.restart()
        answers.remember(key[1], None, None)
        configuration, velocity = question.values
        latents[key] = encoder.encode(configuration, velocity, key[1])
    return latents


def _control(
    signals: Signals,
    controller: OnlineController,
    parameters: Mapping[str, Any],
    kept: Mapping[str, Any],
    latents: Mapping[Key, tuple[np.ndarray, np.ndarray]],
    progress: bool,
) -> tuple[dict[Key, np.ndarray], tuple[str, ...]]:
    """Return the forces, with what went wrong on the way.

    Args:
        signals: of the log.
        controller: that answers.
        parameters: of the controller, until the log says that others came in force.
        kept: those of them that stay, whatever the log says.
        latents: what is answered.
        progress: show a bar.
    """
    forces: dict[Key, np.ndarray] = {}
    problems: dict[str, None] = {}
    changes = list(signals.parameters)
    due = list(signals.in_force or _targets_as_sent(signals))
    controller.restart()
    epoch = 0
    for key in _shown(signals.force.samples, 'controlling', progress):
        sample = signals.force.samples[key]
        if key[0] != epoch:
            controller.begin_epoch()
        elif sample.from_restarted:
            controller.restart()
        epoch = key[0]
        while changes and changes[0].publish_ns <= sample.publish_ns:
            parameters = node_parameters('controller', parameters, changes.pop(0).values, kept)
            controller.change(parameters)
        while due and due[0].publish_ns <= sample.publish_ns:
            target = due.pop(0).target
            try:
                controller.add_target(target.stamp_ns, Target(target.configuration, target.latent))
            except TargetError as error:
                problems[f'target or control law: {error}'] = None
        if key not in latents:
            continue
        for change in controller.bring_in_force(key[1]):
            if change.problem:
                problems[f'target or control law: {change.problem}'] = None
        if not controller.has_target:
            continue
        try:
            forces[key] = controller.force(*latents[key], key[1])
        except Exception as error:  # whatever goes wrong in a law that is not ours
            forces[key] = np.zeros(2)  # as the node commands then
            problems[f'target or control law: {error}'] = None
    return forces, tuple(problems)


def _targets_as_sent(signals: Signals) -> Iterator[Announcement]:
    """Return the targets of a log without `target_in_force`, the first in time for all forces."""
    for place, each in enumerate(signals.targets):
        yield each if place else Announcement(each.target, 0)


def _shown(keys: Mapping[Key, Any], what: str, progress: bool) -> Iterator[Key]:
    yield from tqdm(keys, desc=what, disable=not progress, leave=False, delay=1.0)
