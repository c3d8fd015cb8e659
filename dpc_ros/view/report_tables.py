"""The words of a run's page: header and tables. Whatever a log says is text, never markup."""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Mapping, Sequence
from html import escape

import numpy as np

from dpc_ros.bag import (
    COMMAND_RECORD,
    LOSSES_RECORD,
    MACHINE_RECORD,
    MODELS_RECORD,
    NODE_PARAMETERS_RECORD,
    PARAMETERS_RECORD,
    VERSIONS_RECORD,
    Convergence,
    Information,
)
from dpc_ros.bag.convergence_table import describe_outcome, describe_target
from dpc_ros.bag.information import TOPIC_COLUMNS, topic_rows
from dpc_ros.bag.report import run_parameters
from dpc_ros.bag.topic import NANOSECONDS

LARGEST_TEXT = 100_000  # characters of a value of a record that a page shows
_TOPIC_KINDS = ('text', 'text', *['number'] * (len(TOPIC_COLUMNS) - 2))
_WHOLE_WIDTH = ' class="whole"'
_TABLES = {
    MODELS_RECORD: 'Network and checkpoint',
    COMMAND_RECORD: 'Commands',
    VERSIONS_RECORD: 'Versions',
    MACHINE_RECORD: 'Machine',
}
_SHOWN_ELSEWHERE = (PARAMETERS_RECORD, NODE_PARAMETERS_RECORD, LOSSES_RECORD)


def run_name(convergence: Convergence) -> str:
    """Return what a run is called: the last two parts of its path."""
    return '/'.join(convergence.run.path.resolve().parts[-2:])


def header(convergence: Convergence, information: Information, notes: Sequence[str]) -> str:
    """Return what a run was and what it comes down to."""
    kind, verdict = _verdict(convergence)
    start = information.contents.start_ns / NANOSECONDS
    recorded = datetime.datetime.fromtimestamp(start, datetime.timezone.utc)
    names = [
        convergence.run.network_identifier or 'unnamed network',
        convergence.run.autoencoder_identifier or 'no checkpoint',
        f'target: {describe_target(convergence)}',
        f'recorded {recorded:%Y-%m-%d %H:%M} UTC',
    ]
    texts = {
        **describe_outcome(convergence),
        'simulated time': f'{convergence.time[-1]:.4g} s',
    }
    figures = ''.join(
        f'<div><dt>{escape(name)}</dt><dd>{escape(text)}</dd></div>\n'
        for name, text in texts.items()
    )
    lines = ''.join(f'<li>{escape(note)}</li>' for note in notes)
    return (
        f'<div class="outcome"><h1>{escape(run_name(convergence))}</h1>'
        f'<span class="verdict {kind}">{escape(verdict)}</span></div>\n'
        f'<p class="names">{escape(" · ".join(names))}</p>\n'
        f'<p class="story">{_text(_story(convergence))}</p>\n'
        f'<dl class="figures">{figures}</dl>\n'
        + (f'<ul class="notes">{lines}</ul>' if notes else '')
    )


def tables(information: Information) -> str:
    """Return what the log holds beside the run: topics, models, versions, commands, parameters."""
    contents = information.contents
    duration = (contents.end_ns - contents.start_ns) / NANOSECONDS
    files = [(file.name, f'{file.stat().st_size / 1e6:.3g} MB') for file in contents.files]
    files += [(each.name, f'{each.media_type}, {each.size} bytes') for each in contents.attachments]
    records = contents.metadata
    others = records.keys() - _TABLES.keys() - {*_SHOWN_ELSEWHERE}
    titles = _TABLES | {name: name for name in sorted(others)}
    parts = [
        _details('Topics', _topics(information), _WHOLE_WIDTH + ' open'),
        *(
            _details(title, _pairs(records[name].items()))
            for name, title in titles.items()
            if records.get(name)
        ),
        _details(f'Files: {information.size / 1e6:.3g} MB, {duration:.3f} s', _pairs(files)),
        _parameters(records),
    ]
    return '\n'.join(parts)


def _verdict(convergence: Convergence) -> tuple[str, str]:
    if convergence.target is None:
        return 'open', 'No target in force'
    if np.isnan(convergence.final_nmse):
        return 'bad', '✕ Failed: no finite state at the end'
    if convergence.failed:
        return 'bad', '✕ Failed: ended farther from its target than it began'
    if np.isnan(convergence.settling_time):
        return 'open', 'Has not settled'
    return 'good', f'✓ Settled at nMSE {convergence.final_nmse:.3g}'


def _story(convergence: Convergence) -> str:
    """Return in a sentence what latent control is, in the numbers of the run."""
    run = convergence.run
    size = run.configuration.shape[1]
    if not len(run.latent):
        return f'A body with {size} coordinates q.'
    compressed = f'the encoder compresses its state to {run.latent.shape[1]} coordinates ξ = E(q)'
    if not len(run.force):
        return f'A body with {size} coordinates q: {compressed}.'
    law = run_parameters(run, 'controller').get('law')
    controller = f'controller ({law})' if isinstance(law, str) else 'controller'
    mass = 'one mass' if run.actuated_mass is None else f'mass {run.actuated_mass}'
    return (
        f'A body with {size} coordinates q: {compressed}, the {controller} sees those alone and '
        f'answers with a force u on {mass}, so that ξ goes where the target has it.'
    )


def _parameters(metadata: Mapping[str, Mapping[str, str]]) -> str:
    answers = metadata.get(NODE_PARAMETERS_RECORD, {})
    texts = {
        **{f'{node}, as it answered': answers[node] for node in sorted(answers)},
        **{
            f'file of the run ({key})': each
            for key, each in metadata.get(PARAMETERS_RECORD, {}).items()
        },
    }
    parts = [_details(title, f'<pre>{_text(text)}</pre>') for title, text in texts.items()]
    return _details('Parameters', ''.join(parts), _WHOLE_WIDTH) if parts else ''


def _details(title: str, content: str, attributes: str = '') -> str:
    return f'<details{attributes}><summary>{_text(title)}</summary>{content}</details>'


def _pairs(rows: Iterable[tuple[str, str]]) -> str:
    return f'<div class="wide"><table>{_rows(rows, ("text", "text"))}</table></div>'


def _topics(information: Information) -> str:
    head = ''.join(
        f'<th class="{kind}">{name}</th>'
        for name, kind in zip(TOPIC_COLUMNS, _TOPIC_KINDS, strict=True)
    )
    rows = _rows(topic_rows(information), _TOPIC_KINDS)
    return f'<div class="wide"><table><tr>{head}</tr>{rows}</table></div>'


def _rows(rows: Iterable[Sequence[str]], kinds: Sequence[str]) -> str:
    return '\n'.join(
        f'<tr><th>{_text(name)}</th>'
        + ''.join(
            f'<td class="{kind}">{_text(cell)}</td>'
            for cell, kind in zip(cells, kinds[1:], strict=True)
        )
        + '</tr>'
        for name, *cells in rows
    )


def _text(value: str) -> str:
    """Return a text as markup that shows it, cut where it is of no use to anyone."""
    more = len(value) - LARGEST_TEXT
    return escape(value[:LARGEST_TEXT]) + (f' … and {more} characters more' if more > 0 else '')
