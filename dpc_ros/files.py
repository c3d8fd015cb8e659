"""Files and folders that are written whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give a partial file beside a path, which takes its place once all has been written.

    The folder is made where it is missing. When anything is raised meanwhile, Ctrl-C included, the
    partial file goes and what was at the path stays.

    Raises:
        OSError: the file can't be written; the message names it.
    """
    path = Path(path)
    partial = path.parent / f'{path.name}.partial'
    try:
        # A device, /dev/null say, must not give way to a file.
        if path.exists() and not path.is_file():
            raise FileExistsError('what stands there is no file')
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        os.replace(partial, path)
    except BaseException as error:
        with suppress(OSError):
            partial.unlink()
        if isinstance(error, OSError):
            reason = error.strerror or error
            raise OSError(f"{path} can't be written ({reason}): name another place") from error
        raise


@contextmanager
def new_folder(path: str | Path) -> Iterator[Path]:
    """Give a partial folder beside a path where nothing is, which takes its place at the end.

    When anything is raised meanwhile, Ctrl-C included, the partial folder goes.

    Raises:
        OSError: something is at the path, or the folder can't be made.
    """
    path = Path(path)
    partial = path.parent / f'{path.name}.partial'
    try:
        if os.path.lexists(path):
            raise FileExistsError('something stands there')
        partial.mkdir(parents=True)
    except OSError as error:
        reason = error.strerror or error
        raise OSError(f"{path} can't be written ({reason}): name another place") from error
    try:
        yield partial
        partial.rename(path)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
