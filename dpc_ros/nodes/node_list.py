"""What the nodes have reported, as a table of a web page."""

from __future__ import annotations

import re
from collections.abc import Sequence

from dpc_ros.nodes.reports import Report

_COLUMNS = {
    'rate [Hz]': 'Hz',
    'processing p99 [ms]': 'p99 ms',
    'lost': 'lost',
    'rejected': 'rejected',
}
_NOTHING = '–'
_SPECIAL = re.compile(r'([\\`*_{}\[\]<>()#+!|~&])')
_LONGEST = 300  # characters of what is wrong


def node_list(reports: Sequence[Report], now: float) -> str:
    """Return a row for each node, and below them what is wrong, in Markdown.

    Args:
        reports: of the nodes.
        now: time [s], of the clock by which they came.
    """
    if not reports:
        return 'no node has reported so far'
    titles = ('node', 'state', *_COLUMNS.values())
    lines = [_row(titles), _row(['---'] * len(titles))]
    for report in reports:
        state = 'silent' if report.is_silent(now) else _value(report, 'state')
        lines.append(_row([plain(report.node), state, *(_value(report, key) for key in _COLUMNS)]))
    problems = [
        f'{plain(report.node)}: {plain(report.problem[:_LONGEST])}'
        for report in reports
        if report.problem
    ]
    return '\n'.join(lines) + ''.join(f'\n\n{problem}' for problem in problems)


def plain(text: str) -> str:
    """Return a text in which Markdown reads nothing but letters: it may come from anyone."""
    return _SPECIAL.sub(r'\\\1', ' '.join(text.split()))


def _value(report: Report, key: str) -> str:
    value = report.values.get(key, 'nan')
    return _NOTHING if value == 'nan' else plain(value)


def _row(cells: Sequence[str]) -> str:
    return f'| {" | ".join(cells)} |'
