"""The files behind the parameters `network` and `checkpoint`, as attachments of a log."""

from __future__ import annotations

from dataclasses import dataclass

from dpc_ros.resources import find_resource

# Folder below config/, and the suffixes of what belongs together.
_KINDS = {
    'network': ('systems', ('.json',)),
    'checkpoint': ('checkpoints', ('.json', '.safetensors')),
}
_MEDIA_TYPES = {'.json': 'application/json', '.safetensors': 'application/octet-stream'}


@dataclass(frozen=True)
class ModelFile:
    """A whole file: its name in the log, `network/paper_2.json`, media type and content."""

    name: str
    media_type: str
    data: bytes


def model_files(kind: str, name_or_path: str) -> list[ModelFile]:
    """Read the files of a network or checkpoint that a parameter names.

    Args:
        kind: `network` or `checkpoint`.
        name_or_path: of a shipped one, or the path of its JSON file.

    Raises:
        OSError: a file is missing or can't be read.
    """
    folder, suffixes = _KINDS[kind]
    path = find_resource(name_or_path, folder, '.json')
    files = [path.with_suffix(suffix) for suffix in suffixes]
    return [
        ModelFile(f'{kind}/{file.name}', _MEDIA_TYPES[file.suffix], file.read_bytes())
        for file in files
    ]
