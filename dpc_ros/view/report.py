"""The page of a run: one file of HTML with everything in it, which asks no one for anything."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from dpc_ros import __version__
from dpc_ros.bag import Convergence, Information, measure_timing
from dpc_ros.files import replacing
from dpc_ros.view.animation import NothingToShowError, animate
from dpc_ros.view.report_plots import LARGEST_CURVE, Panel, panels
from dpc_ros.view.report_tables import header, run_name, tables

FILE_NAME = 'report.html'
_FOOTER = (
    f'Made by dpc_ros {__version__}. This file holds all that it shows. A curve of more than '
    f'{LARGEST_CURVE} samples is drawn through the smallest and the largest of each stretch.'
)
_SCRIPTS = tuple(f'report_{name}.js' for name in ('content', 'plots', 'body', 'player'))
_PLACE = re.compile(r'\{\{(\w+)\}\}')


def write_report(
    convergence: Convergence, information: Information, notes: Sequence[str], path: str | Path
) -> None:
    """Write the page of a run.

    Args:
        convergence: what the run shows.
        information: what its log holds.
        notes: what could not be measured.
        path: of the file.

    Raises:
        OSError: it can't be written.
    """
    page = report_page(convergence, information, notes)
    with replacing(path) as partial:
        partial.write_text(page, encoding='utf-8', errors='replace', newline='\n')


def report_page(
    convergence: Convergence, information: Information, notes: Sequence[str] = ()
) -> str:
    """Return the page of a run as HTML.

    Whatever the log says is escaped, and the page lets no script run but the two of its own, and
    nothing be loaded, whatever the log says.
    """
    from plotly.offline import get_plotlyjs

    plots = panels(convergence, measure_timing(convergence.run))
    motion: dict[str, Any] | None = None
    try:
        motion = animate(convergence)
        stage = _stage(convergence, motion)
    except NothingToShowError as error:
        stage = f'<h2>No animation</h2><p class="missing">{escape(str(error))}</p>'
    figures = {plot.key: plot.figure for plot in plots if plot.figure is not None}
    scripts = {'plotly': get_plotlyjs(), 'script': '\n'.join(map(_asset, _SCRIPTS))}
    return _fill(
        _asset('report.html'),
        {
            'policy': _policy(scripts.values()),
            'title': escape(f'{run_name(convergence)} – dpc_ros'),
            'style': _asset('report.css'),
            'header': header(convergence, information, notes),
            'animation': stage,
            'panels': '\n'.join(map(_panel, plots)),
            'tables': tables(information),
            'footer': _FOOTER,
            'content': _json({'animation': motion, 'figures': figures}),
            **scripts,
        },
    )


def _stage(convergence: Convergence, motion: Mapping[str, Any]) -> str:
    frames, samples = len(base64.b64decode(motion['time']['bdata'])) // 8, motion['samples']
    mass = motion['mass']
    return _fill(
        _asset('report_animation.html'),
        {
            'strain': f'{100 * motion["largest_strain"]:g}',
            'reconstruction': 'D(ξ)' if len(convergence.run.latent) else 'D(E(q))',
            'mass': '' if mass is None else f' on mass {mass}',
            'frames': f'{frames} of {samples} configurations.',
        },
    )


def _panel(panel: Panel) -> str:
    unit = f' <span class="unit">{escape(panel.unit)}</span>' if panel.unit else ''
    content = (
        f'<p class="missing">{escape(panel.missing)}</p>'
        if panel.figure is None
        else f'<div class="plot" data-panel="{panel.key}"></div>'
        f'<p class="caption">{escape(panel.caption)}</p>'
    )
    return f'<section class="panel"><h3>{escape(panel.title)}{unit}</h3>{content}</section>'


def _policy(scripts: Iterable[str]) -> str:
    """Return a policy that lets these scripts run and no other, and nothing be loaded."""
    digests = (hashlib.sha256(script.encode()).digest() for script in scripts)
    sources = ' '.join(f"'sha256-{base64.b64encode(each).decode()}'" for each in digests)
    return (
        f"default-src 'none'; script-src {sources}; style-src 'unsafe-inline'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )


def _json(content: Any) -> str:
    """Return JSON that ends no script element, whatever is in it."""
    text = json.dumps(content, allow_nan=False, separators=(',', ':'))
    return text.replace('<', '\\u003c')


def _fill(template: str, texts: Mapping[str, str]) -> str:
    """Put texts into their places in one go: what is put in has no places."""
    return _PLACE.sub(lambda place: texts[place[1]], template)


def _asset(name: str) -> str:
    return files('dpc_ros.view').joinpath(name).read_text(encoding='utf-8')
