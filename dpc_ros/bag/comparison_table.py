"""The comparison of two logs in lines of text."""

from __future__ import annotations

from typing import Any

import numpy as np

from dpc_ros.bag.comparison import Comparison, TopicComparison
from dpc_ros.bag.topic import NANOSECONDS

_LONGEST = 60  # characters of a value


def comparison_table(comparison: Comparison) -> str:
    """Return what two logs have not in common: topics, then parameters, then other records."""
    lines = [line for topic in comparison.topics for line in _topic(topic)]
    for title, values in (
        ('parameters', comparison.parameters),
        ('metadata', comparison.metadata),
    ):
        if values:
            lines += ['', title]
            lines += [f'  {name}: {_value(a)} → {_value(b)}' for name, (a, b) in values.items()]
    return '\n'.join(lines)


def _topic(topic: TopicComparison) -> list[str]:
    if topic.types[0] != topic.types[1]:
        a, b = (type_name or 'not there' for type_name in topic.types)
        return [f'{topic.topic}  {a} → {b}']
    verdict = 'equal' if topic.is_equal else 'DIFFERENT'
    lines = [f'{topic.topic}  {verdict}: {topic.distinct[0]} and {topic.distinct[1]} messages']
    if topic.messages != topic.distinct:
        repeats = (logged - n for logged, n in zip(topic.messages, topic.distinct, strict=True))
        lines[0] += ', {} and {} repeats'.format(*repeats)
    for which, count in zip(('first', 'second'), topic.only, strict=True):
        if count:
            lines.append(f'  {count} in the {which} log only')
    if topic.first is not None:
        first = topic.first
        at = '' if first.stamp_ns is None else f' at {first.stamp_ns / NANOSECONDS:.9g} s'
        lines.append(
            f'  {topic.different} differ, the first is number {first.index}{at}, '
            f'{first.field}: {_value(first.first)} → {_value(first.second)}'
        )
    for name, deviation in topic.deviations.items():
        lines.append(
            f'  {name}: deviates by up to {deviation.absolute:.4g}, '
            f'{deviation.relative:.4g} of its largest magnitude'
        )
    return lines


def _value(value: Any) -> str:
    plain = value.tolist() if isinstance(value, np.ndarray) else value
    text = '–' if plain is None else str(plain)
    return text if len(text) <= _LONGEST else f'{text[: _LONGEST - 1]}…'
