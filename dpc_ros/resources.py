"""Where the resource files (`config/…`) are: in a source tree, a wheel or a colcon tree."""

import os
from pathlib import Path

from dpc_ros import __version__

_PACKAGE = Path(__file__).resolve().parent


def share_directory() -> Path:
    """Return the folder that holds `config/`.

    A source tree (also an editable or `--symlink-install` one) keeps it beside the package. A
    wheel and a colcon tree both install it to `<prefix>/share/dpc_ros`, where the package itself
    lies somewhere below `<prefix>`. No environment variable is needed for either.

    Raises:
        FileNotFoundError: the installation has no such folder.
    """
    source_tree = _PACKAGE.parent
    if (source_tree / 'package.xml').is_file() and (source_tree / 'config').is_dir():
        return source_tree
    for prefix in _PACKAGE.parents:
        candidate = prefix / 'share' / 'dpc_ros'
        if (candidate / 'config').is_dir():
            return candidate
    raise FileNotFoundError(
        f'dpc_ros {__version__} at {_PACKAGE} has no share/dpc_ros/config above it: '
        'the installation is incomplete, install the package again'
    )


def config_path(*parts: str) -> Path:
    """Return the path of a file or folder below the package's `config/`."""
    return share_directory().joinpath('config', *parts)


def find_resource(name_or_path: str | Path, folder: str, suffix: str) -> Path:
    """Return the file that a user means by the name of a shipped resource or by a path.

    A shipped name (`paper_2`) is looked up as `config/<folder>/<name><suffix>`; anything with a
    separator or the suffix is a path.

    Raises:
        FileNotFoundError: neither exists; the message lists the shipped names.
    """
    text = str(name_or_path)
    if text.endswith(suffix) or '/' in text:
        path = Path(os.path.expanduser(text))  # leaves the `~` of an unknown user
    else:
        path = config_path(folder, text + suffix)
    if path.is_file():
        return path
    shipped = sorted(p.name.removesuffix(suffix) for p in config_path(folder).glob('*' + suffix))
    raise FileNotFoundError(
        f'no {folder} file {text!r}: expected a path ending in {suffix} or one of the shipped '
        f'names {", ".join(shipped) or "(none)"}'
    )
