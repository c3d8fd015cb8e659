"""Checkpoints: a trained autoencoder as safetensors plus JSON. No pickle is ever loaded."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from dpc_ros.autoencoder.architecture import Architecture
from dpc_ros.autoencoder.base import Autoencoder
from dpc_ros.autoencoder.kinds import KindError, load_kind
from dpc_ros.files import replacing
from dpc_ros.network import MassSpringNetwork
from dpc_ros.resources import find_resource

FORMAT = 'dpc_ros.checkpoint'
VERSION = 1
_DIGEST_LENGTH = 12


class CheckpointError(ValueError):
    """A checkpoint that can't be used: what was expected, what came, what to do."""


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A trained autoencoder and where it comes from.

    Attributes:
        name: of the checkpoint.
        architecture: sizes and kind of the networks.
        tensors: weights and normalisation, by the names that the torch module gives them.
        network: name and digest of the body that it belongs to.
        provenance: recipe, data, scores, versions.
        digest: twelve hexadecimal digits of the stored tensors; empty before it is saved.
    """

    name: str
    architecture: Architecture
    tensors: dict[str, np.ndarray]
    network: dict[str, str]
    provenance: dict[str, Any] = field(default_factory=dict)
    digest: str = ''

    @property
    def identifier(self) -> str:
        """`<name>@<digest>`, the `frame_id` of its latent states."""
        return f'{self.name}@{self.digest}'

    def autoencoder(self) -> Autoencoder:
        """Return it for online use, in float64."""
        return load_kind(self.architecture.kind).autoencoder(self.architecture, self.tensors)

    def check_network(self, network: MassSpringNetwork) -> None:
        """Make sure that the checkpoint was trained on this network.

        Raises:
            CheckpointError: it belongs to another.
        """
        if self.network['digest'] != network.digest:
            raise CheckpointError(
                f'checkpoint {self.name} was trained on '
                f'{self.network["name"]}@{self.network["digest"]}, not on {network.identifier}: '
                'choose a checkpoint of this network, or train one with `dpc train`'
            )


def save_checkpoint(checkpoint: Checkpoint, folder: str | Path) -> Path:
    """Write `<name>.safetensors` and `<name>.json` into a folder and return the JSON's path."""
    tensors = save({name: np.asarray(v, order='C') for name, v in checkpoint.tensors.items()})
    content = {
        'format': FORMAT,
        'version': VERSION,
        'name': checkpoint.name,
        'kind': checkpoint.architecture.kind,
        'architecture': asdict(checkpoint.architecture),
        'network': checkpoint.network,
        'sha256': hashlib.sha256(tensors).hexdigest(),
        **checkpoint.provenance,
    }
    path = Path(folder) / f'{checkpoint.name}.json'
    # The tensors, entered last, take their place first.
    with replacing(path) as text, replacing(path.with_suffix('.safetensors')) as data:
        data.write_bytes(tensors)
        text.write_text(json.dumps(content, indent=2) + '\n')
    return path


def load_checkpoint(name_or_path: str | Path) -> Checkpoint:
    """Read a checkpoint by the path of its JSON file, or a shipped one by its name.

    Raises:
        FileNotFoundError: there is no such file.
        CheckpointError: a file is truncated, altered, of an unknown kind or version.
    """
    path = find_resource(name_or_path, 'checkpoints', '.json')
    content = _read_json(path)
    tensors_path = path.with_suffix('.safetensors')
    if not tensors_path.is_file():
        raise CheckpointError(f'{path}: its tensors {tensors_path.name} are missing beside it')
    data = tensors_path.read_bytes()
    sha256 = hashlib.sha256(data).hexdigest()
    if sha256 != content['sha256']:
        raise CheckpointError(
            f'{tensors_path}: truncated or altered, expected SHA-256 {content["sha256"]}, '
            f'got {sha256}: copy or train the checkpoint again'
        )
    try:
        kind = load_kind(content['kind'])
        architecture = kind.architecture(**content['architecture'])
        tensors = load(data)
        if not all(np.isfinite(value).all() for value in tensors.values()):
            raise CheckpointError(f'{tensors_path}: holds values that are not finite')
        kind.autoencoder(architecture, tensors)
    except CheckpointError:
        raise
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f'{path}: architecture and tensors do not fit, {error}') from error
    known = ('format', 'version', 'name', 'kind', 'architecture', 'network', 'sha256')
    return Checkpoint(
        name=content['name'],
        architecture=architecture,
        tensors=tensors,
        network=content['network'],
        provenance={key: value for key, value in content.items() if key not in known},
        digest=sha256[:_DIGEST_LENGTH],
    )


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text())
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise CheckpointError(
            f'{path}: expected a checkpoint as JSON (truncated?), but {error}'
        ) from error
    if not isinstance(content, dict) or content.get('format') != FORMAT:
        raise CheckpointError(f'{path}: expected a checkpoint, "format" should be {FORMAT!r}')
    if content.get('version') != VERSION:
        raise CheckpointError(
            f'{path}: version {content.get("version")!r}; this dpc_ros reads version {VERSION}: '
            'use the dpc_ros that wrote it or train anew'
        )
    try:
        load_kind(content.get('kind', ''))
    except KindError as error:
        raise CheckpointError(f'{path}: {error}') from error
    missing = {'name', 'architecture', 'network', 'sha256'} - content.keys()
    if missing:
        raise CheckpointError(f'{path}: expected the keys {sorted(missing)}, which are missing')
    if not isinstance(content['name'], str):
        raise CheckpointError(f'{path}: name: expected a text, got {content["name"]!r}')
    network = content['network']
    if not isinstance(network, dict) or not {'name', 'digest'} <= network.keys():
        raise CheckpointError(f'{path}: network: expected its name and digest, got {network!r}')
    return content
