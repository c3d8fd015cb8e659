"""The MCAP files of a bag: one, or several in the order in which the recorder split it."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

from dpc_ros.bag.metadata import FILE_NAME, file_names

_SPLIT_NAME = re.compile(r'(.*)_(\d+)\.mcap')
_SHOWN = 5  # files listed in an error


class BagError(ValueError):
    """A bag that can't be read: what was expected, what came, what to do."""


def find_files(path: str | Path) -> tuple[Path, ...]:
    """Return the MCAP files that a path means: the file itself, or those of the folder in order.

    The order is that of `metadata.yaml`; without one, that of the numbers in the names.

    Raises:
        BagError: nothing is there, the folder holds no file, files of several bags or not all of
            one.
    """
    path = Path(path)
    if path.is_file():
        return (path,)
    files = find_splits(path)
    listed = _listed(path)
    if listed is None:
        numbers = [_number(file) for file in files]
        if any(later != earlier + 1 for earlier, later in pairwise(numbers)):
            raise BagError(
                f'{path}: expected files with successive numbers, but one is missing between '
                f'{_some(files)}: name one of them'
            )
        return files
    missing = [file.name for file in listed if not file.is_file()]
    if missing:
        raise BagError(
            f'{path}: expected the files that {FILE_NAME} names, but {missing[0]} is missing: '
            '`dpc bag repair` makes a bag of the others'
        )
    unlisted = [file for file in files if file not in listed]
    if unlisted and _stem(unlisted[0]) == _stem(listed[0]):
        raise BagError(
            f'{path}: expected the files that {FILE_NAME} names, but there is {unlisted[0].name}, '
            'too: the recorder did not finish, `dpc bag repair` makes a bag of them all'
        )
    return listed


def find_splits(folder: Path) -> tuple[Path, ...]:
    """Return the MCAP files in a folder in the order of their numbers, whatever is missing.

    Raises:
        BagError: there is no folder, or it holds no file or files of several bags.
    """
    if not folder.is_dir():
        raise BagError(
            f'{folder}: expected the folder of a bag or an .mcap file, but nothing is there: '
            'check the path'
        )
    files = sorted(folder.glob('*.mcap'), key=lambda file: (_number(file), file.name))
    if not files:
        raise BagError(
            f'{folder}: expected a folder with an .mcap file, but it holds '
            f'{_some(sorted(folder.iterdir())) or "nothing"}: name the folder of a bag'
        )
    if len({_stem(file) for file in files}) == 1:
        return tuple(files)
    listed = [file for file in _listed(folder) or () if file.is_file()]
    if not listed:
        raise BagError(
            f'{folder}: expected a folder with the .mcap files of one bag, but it holds '
            f'{len(files)}: name one of them, {_some(files)}'
        )
    stems = {_stem(file) for file in listed}
    others = [file for file in files if file not in listed and _stem(file) in stems]
    return (*listed, *others)


def _listed(folder: Path) -> tuple[Path, ...] | None:
    if not (folder / FILE_NAME).is_file():
        return None
    try:
        names = file_names(folder)
    except (OSError, ValueError) as error:
        raise BagError(
            f'{folder / FILE_NAME}: expected the table of contents of a bag, got {error}: '
            'name a single .mcap file, or take the table away to read all of them'
        ) from error
    return tuple(folder / name for name in names)


def _stem(file: Path) -> str:
    match = _SPLIT_NAME.fullmatch(file.name)
    return match.group(1) if match else file.name


def _number(file: Path) -> int:
    match = _SPLIT_NAME.fullmatch(file.name)
    return int(match.group(2)) if match else 0


def _some(files: tuple[Path, ...] | list[Path]) -> str:
    names = [file.name for file in files[:_SHOWN]]
    return ', '.join(names) + (', …' if len(files) > _SHOWN else '')
