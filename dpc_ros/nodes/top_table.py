"""What the nodes have reported, as a table for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from dpc_ros.nodes.health import HOST_READING, NO_WATCHDOG, WATCHDOG_OK
from dpc_ros.nodes.reports import Report

_NOTHING = '–'
_LONGEST_NAME = 40  # characters


class _Column(NamedTuple):
    title: str
    unit: str
    key: str  # of the report
    width: int


_COLUMNS = (
    _Column('rate', '[Hz]', 'rate [Hz]', 9),
    _Column('jitter', 'p99 [ms]', 'jitter p99 [ms]', 10),
    _Column('processing', 'p50 [ms]', 'processing p50 [ms]', 12),
    _Column('', 'p99 [ms]', 'processing p99 [ms]', 10),
    _Column('age', 'p99 [ms]', 'age p99 [ms]', 10),
    _Column('round trip', 'p99 [ms]', 'round trip p99 [ms]', 12),
    _Column('lost', '', 'lost', 8),
    _Column('rejected', '', 'rejected', 10),
)


def table(reports: Sequence[Report], now: float) -> str:
    """Return a row for each node, with its host where there are several, and below what is wrong.

    Args:
        reports: of the nodes.
        now: time [s], of the clock by which they came.
    """
    names = [_printable(report.node)[:_LONGEST_NAME] for report in reports]
    width = max(len('node'), *map(len, names), 0)
    titles = [f'{"node":<{width}}  {"state":<12}']
    units = [' ' * len(titles[0])]
    for column in _COLUMNS:
        titles.append(f'{column.title:>{column.width}}')
        units.append(f'{column.unit:>{column.width}}')
    titles.append(f'{"watchdog":>10}{"heard":>9}')
    units.append(f'{"":>10}{"[s] ago":>9}')
    hosts = [_value(report, HOST_READING)[:_LONGEST_NAME] for report in reports]
    are_several = len({*hosts} - {_NOTHING}) > 1
    if are_several:
        titles.append('  host')
    lines = [''.join(titles), ''.join(units)]
    for name, host, report in zip(names, hosts, reports, strict=True):
        cells = [f'{_value(report, column.key):>{column.width}}' for column in _COLUMNS]
        state = 'silent' if report.is_silent(now) else _value(report, 'state')
        heard = f'{now - report.time:.1f}' if report.values else _NOTHING
        row = f'{name:<{width}}  {state[:12]:<12}{"".join(cells)}{_watchdog(report):>10}{heard:>9}'
        lines.append(f'{row}  {host}' if are_several else row)
    problems = [
        f'{name}: {_printable(report.problem)}'
        for name, report in zip(names, reports, strict=True)
        if report.problem
    ]
    return '\n'.join([*lines, *([''] if problems else []), *problems])


def _value(report: Report, key: str) -> str:
    value = report.values.get(key, 'nan')
    return _NOTHING if value == 'nan' else _printable(value)


def _watchdog(report: Report) -> str:
    watchdog = report.values.get('watchdog', NO_WATCHDOG)
    short = {NO_WATCHDOG: _NOTHING, WATCHDOG_OK: WATCHDOG_OK}
    return short.get(watchdog, 'stale')


def _printable(text: str) -> str:
    """Return a text without what would move the cursor or end the line."""
    return ''.join(letter if letter.isprintable() else '?' for letter in text)
