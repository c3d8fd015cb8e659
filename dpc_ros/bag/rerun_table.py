"""What came out of running a log again, as a table for the terminal."""

from __future__ import annotations

from dpc_ros.bag.rerun import TOLERANCE, Rerun
from dpc_ros.bag.signals import Deviation
from dpc_ros.bag.topic import NANOSECONDS

_WIDTHS = (16, 7, 8, 10, 12, 12, 12)
_COLUMNS = ('signal', 'stamps', 'missing', 'differing', 'first [s]', 'largest', 'relative')
_NOTHING = '–'


def table(rerun: Rerun) -> str:
    """Return deviations, the criterion and the verdict in lines of text."""
    if rerun.is_exact:
        asked = f'bit for bit: {rerun.reason}'
    else:
        asked = f'within {TOLERANCE:g} relative to the largest recorded value: {rerun.reason}'
    verdict = 'the same' if rerun.passed else 'DIFFERENT'
    if rerun.is_identical:
        verdict = 'identical, bit for bit'
    lines = [
        _line(_COLUMNS),
        *(_line(_cells(each)) for each in rerun.deviations),
        '',
        f'criterion  {asked}',
        *(f'note       {note}' for note in rerun.notes),
        f'result     {verdict}',
    ]
    return '\n'.join(lines)


def _cells(deviation: Deviation) -> tuple[str, ...]:
    first = deviation.first_stamp_ns
    return (
        deviation.signal,
        str(deviation.stamps),
        str(deviation.missing),
        str(deviation.differing),
        _NOTHING if first is None else f'{first / NANOSECONDS:g}',
        f'{deviation.absolute:.3g}',
        f'{deviation.relative:.3g}',
    )


def _line(cells: tuple[str, ...]) -> str:
    name, *numbers = (
        (f'{cell:<{width}}' if i == 0 else f'{cell:>{width}}')
        for i, (cell, width) in enumerate(zip(cells, _WIDTHS, strict=True))
    )
    return ''.join([name, *numbers]).rstrip()
