"""The convergence of a bag, with the models that the bag itself names."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from dpc_ros.autoencoder import Autoencoder, Checkpoint, load_checkpoint, with_encoder
from dpc_ros.bag.convergence import Convergence, analyse
from dpc_ros.bag.metadata import NODE_PARAMETERS_RECORD, PARAMETERS_RECORD
from dpc_ros.bag.reader import Run, read_run
from dpc_ros.network import Gravity, MassSpringNetwork, Mechanics, load_network


def converge(
    bag: str | Path,
    network: str | Path | None = None,
    checkpoint: str | Path | None = None,
    namespace: str | None = None,
    progress: bool = False,
) -> tuple[Convergence, list[str]]:
    """Measure the convergence of a logged run.

    Args:
        bag: folder or MCAP file.
        network: name or path; the shipped one that the log names where left out.
        checkpoint: name or path; likewise.
        namespace: of the topics, the only one in the log where left out.
        progress: show a bar.

    Returns:
        the convergence, and a line for each thing that could not be measured.

    Raises:
        BagError: the bag can't be read.
        ValueError: a given network or checkpoint is not the one of the log.
    """
    run = read_run(bag, namespace, progress)
    notes: list[str] = []
    mechanics = _mechanics(run, network, notes)
    autoencoder = _autoencoder(run, checkpoint, notes)
    decodable = tuple(target for target in run.targets if target.latent is None)
    if autoencoder is None and len(decodable) < len(run.targets):
        notes.append('no nMSE of latent targets: they need the checkpoint, too')
        run = replace(run, targets=decodable)
    return analyse(run, mechanics, autoencoder), notes


def _mechanics(run: Run, name: str | Path | None, notes: list[str]) -> Mechanics | None:
    logged_name, _, digest = run.network_identifier.partition('@')
    body: MassSpringNetwork | None = None
    try:
        body = load_network(name or logged_name)
    except (OSError, ValueError):
        if name is not None:
            raise
    if body is None or (name is None and body.digest != digest):
        notes.append(f'no energies: {run.network_identifier} is not shipped, name it by --network')
        return None
    gravity = _gravity(run)
    if gravity is None:
        notes.append('the log does not say the gravity: energies are without it')
    return Mechanics(body, gravity or Gravity())


def _autoencoder(run: Run, name: str | Path | None, notes: list[str]) -> Autoencoder | None:
    logged_name, at, digest = run.autoencoder_identifier.partition('@')
    found: Checkpoint | None = None
    try:
        if name or logged_name:
            found = load_checkpoint(name or logged_name)
    except (OSError, ValueError):
        if name is not None:
            raise
    if found is None or (name is None and found.digest != digest):
        notes.append(
            f'no latent error: {run.autoencoder_identifier or "the checkpoint"} is not shipped, '
            'name it by --checkpoint'
        )
        return None
    if at and found.digest != digest:
        raise ValueError(
            f'checkpoint: expected that of the log, {run.autoencoder_identifier}, got '
            f'{found.identifier}: name the one that the run was made with'
        )
    parameters = run_parameters(run, 'encoder')
    encoder, iterations = parameters.get('encoder'), parameters.get('projection_iterations')
    if encoder == 'projection' and isinstance(iterations, int):
        return with_encoder(found.autoencoder(), encoder, iterations)
    return found.autoencoder()


def _gravity(run: Run) -> Gravity | None:
    """Return the field that the simulator's parameters in the log name, if they are there."""
    parameters = run_parameters(run, 'simulator')
    try:
        return Gravity(
            parameters['gravity_magnitude'], parameters.get('gravity_angle', Gravity.angle)
        )
    except (KeyError, TypeError, ValueError):
        return None


def run_parameters(run: Run, node: str) -> dict[str, Any]:
    """Return the parameters of a node that the log holds, empty where it holds none.

    What the node answered when the recorder asked it wins over the parameter file of the run.
    """
    full_name = f'{run.namespace}/{node}'
    of_file = run.metadata.get(PARAMETERS_RECORD, {}).get('yaml', '')
    answered = run.metadata.get(NODE_PARAMETERS_RECORD, {}).get(full_name, '')
    names = ('/**', node, f'/{node}', f'/**/{node}', full_name)
    return _sections(of_file, names) | _sections(answered, names)


def _sections(text: str, names: Iterable[str]) -> dict[str, Any]:
    parameters: dict[str, Any] = {}
    try:
        sections = yaml.safe_load(text)
        for name in names:
            parameters |= sections.get(name, {}).get('ros__parameters', {})
    # Whatever another recorder wrote there, it is not the parameters of a node.
    except (yaml.YAMLError, AttributeError, TypeError, ValueError, RecursionError):
        return {}
    return parameters
