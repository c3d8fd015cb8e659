"""The topics of a log as tables: CSV, NPZ or Parquet."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from dpc_ros.bag.fields import fields, number_array, stamp_ns
from dpc_ros.bag.mcap_file import Message, read_contents, read_messages
from dpc_ros.files import new_folder, replacing
from dpc_ros.network import MassSpringNetwork, load_network

_WHOLE = 'biu'  # kinds of numpy types that have no NaN


@dataclass(eq=False)
class Table:
    """The messages of a topic, a row each, in the order of their log times.

    Attributes:
        fields: `stamp_ns` (where there is a header), `log_time_ns` and each field of the messages:
            one value a row, or an array of one length. What is missing, as at the end of a shorter
            array, is NaN, an empty text, or masked among whole numbers, which keep all digits.
        names: of the elements of an array field, where they have names.
    """

    fields: dict[str, np.ndarray] = field(default_factory=dict)
    names: dict[str, list[str]] = field(default_factory=dict)

    def columns(self) -> dict[str, np.ndarray]:
        """Return one column for each element of each field, `position[0]` or `position.x`."""
        columns: dict[str, np.ndarray] = {}
        for name, values in self.fields.items():
            if values.ndim == 1:
                columns[name] = values
                continue
            labels = self.names.get(name)
            for place in range(values.shape[1]):
                label = f'[{place}]' if labels is None else f'.{labels[place]}'
                columns[f'{name}{label}'] = values[:, place]
        return columns


def export(
    source: str | Path,
    target: str | Path,
    network: str | Path | None = None,
    progress: bool = False,
) -> list[str]:
    """Write each topic of a log as a table.

    Args:
        source: folder of a bag, or an MCAP file.
        target: `<name>.csv` or `<name>.parquet`, a folder with a file for each topic, or
            `<name>.npz`, where `configuration/position` is an array with a row for each message.
        network: name or path of the one that names the coordinates; the shipped one that the log
            names where left out.
        progress: show a bar.

    Returns:
        a line about each topic.

    Raises:
        BagError: the log can't be read.
        FileExistsError: the target exists.
        ValueError: the suffix is none of these, a package is missing, or the network is unknown.
    """
    target = Path(target)
    if target.suffix not in _WRITERS:
        raise ValueError(f'{target}: expected a name that ends in one of {", ".join(_WRITERS)}')
    if os.path.lexists(target):
        raise FileExistsError(f'{target}: expected a new place, but it exists: name another')
    write = _WRITERS[target.suffix]()
    body = load_network(network) if network is not None else None
    contents = read_contents(source)
    names = [name for name in sorted(contents.messages) if contents.messages[name]]
    lines = []

    def tables() -> Iterator[tuple[str, Table]]:
        for name in tqdm(names, desc='exporting', delay=2, disable=not progress, leave=False):
            table = make_table(read_messages(source, [name]), body)
            rows, columns = contents.messages[name], len(table.columns())
            lines.append(f'{name}: {rows} rows, {columns} columns')
            yield name.strip('/'), table

    write(target, tables())
    return [*lines, f'written to {target}']


def make_table(messages: Iterator[Message], body: MassSpringNetwork | None = None) -> Table:
    """Return the table of the messages of one topic.

    Args:
        messages: of it.
        body: names the coordinates of arrays of its size; where it is None, the shipped network
            that the frame_id names.
    """
    collected: dict[str, list[Any]] = {}
    stamps, log_times = [], []
    for message in messages:
        stamps.append(stamp_ns(message.content))
        log_times.append(message.log_time_ns)
        for name, value in fields(message.content).items():
            # A field of a list that was shorter before is missing in the rows before.
            column = collected.setdefault(name, [None] * (len(log_times) - 1))
            column.append(value)
        for column in collected.values():
            column.extend([None] * (len(log_times) - len(column)))
    table = Table()
    if stamps and None not in stamps:
        table.fields['stamp_ns'] = np.array(stamps, dtype=np.int64)
    table.fields['log_time_ns'] = np.array(log_times, dtype=np.int64)
    labels = _element_names(collected, body)
    for name, values in collected.items():
        array = _array(values)
        if array is None:
            continue
        table.fields[name] = array
        if array.ndim == 2 and array.shape[1] == len(labels):
            table.names[name] = labels
    return table


def _element_names(collected: dict[str, list[Any]], body: MassSpringNetwork | None) -> list[str]:
    """Return the names of the elements of arrays: the messages' own, or those of the network."""
    own = collected.get('name', [])
    if own and isinstance(own[0], list) and own[0] and all(names == own[0] for names in own):
        del collected['name']
        return list(own[0])
    frames = collected.get('header.frame_id', [])
    if body is None and frames and isinstance(frames[0], str):
        logged, at, digest = frames[0].partition('@')
        try:
            shipped = load_network(logged) if at else None
        except (OSError, ValueError):
            shipped = None
        body = shipped if shipped is not None and shipped.digest == digest else None
    return body.coordinate_names if body is not None else []


def _array(values: Sequence[Any]) -> np.ndarray | None:
    """Return the values of a field as an array with a row each, None where it is always empty."""
    if any(isinstance(value, list) for value in values):  # of texts
        values = [' '.join(value) if isinstance(value, list) else '' for value in values]
    if any(isinstance(value, str) for value in values):
        return np.array([value or '' for value in values])
    if not any(isinstance(value, np.ndarray) for value in values):
        return _numbers(values)
    arrays = [np.zeros(0) if value is None else np.ravel(value) for value in values]
    return _padded(arrays) if any(len(array) for array in arrays) else None


def _numbers(values: Sequence[Any]) -> np.ndarray:
    """Return numbers as an array; one that is None is NaN, or masked among whole numbers."""
    missing = np.array([value is None for value in values])
    known = [value for value in values if value is not None]
    array = number_array([known[0] if value is None else value for value in values])
    if not missing.any():
        return array
    masked = np.ma.array(array, mask=missing)
    return masked if array.dtype.kind in _WHOLE else masked.filled(np.nan)


def _padded(arrays: list[np.ndarray]) -> np.ndarray:
    """Return arrays as rows; what the shorter ones lack is NaN, or masked among whole numbers."""
    size = max(len(array) for array in arrays)
    types = {array.dtype for array in arrays if len(array)}  # an empty one is no number
    is_whole = all(dtype.kind in _WHOLE for dtype in types)
    # Beside numbers beyond int64 there are no negative ones: they are of one field.
    largest = np.dtype(np.uint64)
    dtype = largest if is_whole and largest in types else np.result_type(*types)
    if all(len(array) == size for array in arrays):
        return np.array(arrays, dtype=dtype)
    padded = np.ma.masked_all((len(arrays), size), dtype)
    for row, array in enumerate(arrays):
        padded[row, : len(array)] = array
    return padded if is_whole else padded.filled(np.nan)


_Tables = Iterator[tuple[str, Table]]
_Writer = Callable[[Path, _Tables], None]


def _file_name(topic: str, suffix: str) -> str:
    return topic.replace('/', '.') + suffix  # a name in ROS has no dot


def _csv_writer() -> _Writer:
    def write(target: Path, tables: _Tables) -> None:
        with new_folder(target) as folder:
            for topic, table in tables:
                columns = table.columns()
                with (folder / _file_name(topic, '.csv')).open('w', newline='') as stream:
                    lines = csv.writer(stream)
                    lines.writerow(columns)
                    # Whole columns as Python's own numbers: they are written with all digits.
                    lines.writerows(zip(*(c.tolist() for c in columns.values()), strict=True))

    return write


def _npz_writer() -> _Writer:
    def write(target: Path, tables: _Tables) -> None:
        arrays = {
            f'{topic}/{name}': values
            for topic, table in tables
            for name, values in _npz_arrays(table).items()
        }
        with replacing(target) as partial, partial.open('wb') as stream:
            np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]

    return write


def _npz_arrays(table: Table) -> dict[str, np.ndarray]:
    """Return the fields of a table with what the format has no place for: names and masks."""
    arrays: dict[str, np.ndarray] = {}
    for name, values in table.fields.items():
        if isinstance(values, np.ma.MaskedArray):
            arrays[name] = values.filled(0)
            arrays[f'{name}.missing'] = np.ma.getmaskarray(values)
        else:
            arrays[name] = values
        if name in table.names:
            arrays[f'{name}.names'] = np.array(table.names[name])
    return arrays


def _parquet_writer() -> _Writer:
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError as error:
        raise ValueError(
            f"Parquet needs {error.name}, which is not installed: pip install 'dpc_ros[parquet]'"
        ) from error

    def write(target: Path, tables: _Tables) -> None:
        with new_folder(target) as folder:
            for topic, table in tables:
                content = pyarrow.table(table.columns())
                pyarrow.parquet.write_table(content, folder / _file_name(topic, '.parquet'))

    return write


_WRITERS: dict[str, Callable[[], _Writer]] = {
    '.csv': _csv_writer,
    '.npz': _npz_writer,
    '.parquet': _parquet_writer,
}
