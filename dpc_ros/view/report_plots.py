"""The curves of a run as Plotly figures, in plain JSON: nothing of the log's texts is in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from dpc_ros.bag import Convergence, Timing, goals_in_force
from dpc_ros.bag.topic import NANOSECONDS
from dpc_ros.figure import COLOURS
from dpc_ros.results import quantity
from dpc_ros.view.packing import packed

LARGEST_CURVE = 4000  # points; of more samples the extremes of each stretch are kept
LARGEST_CLOUD = 1000  # points that no line joins, each of which costs a browser more
LARGEST_SHOWN = 1e30  # a body that exploded has numbers that no axis can take
_LARGEST_LATENT = 12  # coordinates up to which each has a curve of its target, too
_LATENT_CURVES = 40  # at most
_FEW = 2  # points that make no curve
_GREY = '#8a8a8a'
_MILLISECONDS = 1e3  # per second
_HELD = 'hv'  # Plotly's name of a curve that goes on as it was until the next sample

Figure = dict[str, Any]
_Curve = dict[str, Any]


@dataclass(frozen=True)
class Panel:
    """One of the plots of a page.

    Attributes:
        key: a word that names it in the page.
        title: what is shown.
        unit: of the numbers.
        caption: how to read it.
        figure: `data` and `layout` of Plotly; None where there is nothing to plot.
        missing: why so.
    """

    key: str
    title: str
    unit: str
    caption: str
    figure: Figure | None = None
    missing: str = ''


def panels(convergence: Convergence, timing: Timing) -> list[Panel]:
    """Return the plots of a run, all over its time."""
    return [
        _nmse(convergence),
        _latent(convergence),
        _latent_error(convergence),
        _force(convergence),
        _energy(convergence),
        _timing(timing),
        *_losses(timing),
    ]


def shown_samples(
    values: Float[np.ndarray, ' samples'], largest: int = LARGEST_CURVE
) -> Int[np.ndarray, ' shown']:
    """Return which samples to draw: all, or the smallest and the largest of each stretch.

    The first and the last are among them.

    Args:
        values: NaN where there is no sample.
        largest: how many at most, ≥ 4.
    """
    count = len(values)
    if count <= largest:
        return np.arange(count)
    stretches = largest // 2 - 1
    starts = np.arange(stretches) * count // stretches
    length = int(np.diff([*starts, count]).max())
    place = np.minimum(
        starts[:, np.newaxis] + np.arange(length), np.append(starts[1:], count)[:, np.newaxis] - 1
    )
    stretch = values[place]
    smallest = np.argmin(np.where(np.isnan(stretch), np.inf, stretch), axis=1)
    greatest = np.argmax(np.where(np.isnan(stretch), -np.inf, stretch), axis=1)
    rows = np.arange(stretches)
    return np.unique([*place[rows, smallest], *place[rows, greatest], 0, count - 1])


def _nmse(convergence: Convergence) -> Panel:
    final, settled = convergence.final_nmse, convergence.settling_time
    panel = Panel(
        'nmse',
        'Normalised error',
        'nMSE',
        'Squared distance of all masses from the target, over what it was when the target came. '
        '1: no progress. Dashed: the final error. Dotted: settled.',
    )
    positive = np.where(convergence.nmse > 0, convergence.nmse, np.nan)
    if not _is_shown(positive):
        return _without(panel, 'No target was in force, or there was no error to begin with.')
    shapes = []
    if np.isfinite(final) and final > 0:
        shapes.append(_line(y=final, dash='dash'))
    if np.isfinite(settled):
        shapes.append(_line(x=settled, dash='dot'))
    curve = _curve('nMSE', convergence.time, positive, COLOURS[0], width=2)
    return _with(panel, _figure([curve], convergence, is_log=True, shapes=shapes, has_legend=False))


def _latent(convergence: Convergence) -> Panel:
    latent = convergence.run.latent
    panel = Panel('latent', 'Latent state', 'ξ', 'What the controller sees of the body.')
    if not len(latent):
        return _without(panel, 'No latent state is in the log.')
    stamps, values = _latent_targets(convergence)
    with_targets = len(stamps) > 0 and latent.shape[1] <= _LARGEST_LATENT
    remarks = [panel.caption]
    if with_targets:
        remarks.append('Dashed: where it is to go, ξ̄ = E(q̄).')
    if latent.shape[1] > _LATENT_CURVES:
        remarks.append(f'The first {_LATENT_CURVES} of {latent.shape[1]} coordinates.')
    panel = replace(panel, caption=' '.join(remarks))
    curves = []
    for i, coordinate in enumerate(latent.T[:_LATENT_CURVES]):
        name, colour = f'ξ{_subscript(i)}', COLOURS[i % len(COLOURS)]
        curves.append(_curve(name, convergence.latent_time, coordinate, colour))
        if with_targets:
            target = _curve(
                f'{name} target', stamps, values[:, i], colour, dash='dash', is_held=True
            )
            curves.append(target | {'legendgroup': name, 'showlegend': False})
            curves[-2]['legendgroup'] = name
    return _with(panel, _figure(curves, convergence))


def _latent_targets(
    convergence: Convergence,
) -> tuple[Float[np.ndarray, ' k'], Float[np.ndarray, 'k m']]:
    """Return from when on [s] which ξ̄ was in force, with the end of the log as the last."""
    run = convergence.run
    in_force = goals_in_force(run.latent_stamp, convergence.goals)
    first = np.flatnonzero(np.diff(in_force, prepend=-1))
    latents = [convergence.goals[i].latent for i in in_force[first]]
    if not latents or any(latent is None for latent in latents):
        return np.zeros(0), np.zeros((0, 0))
    times = convergence.latent_time[[*first, -1]]
    return times, np.array([*latents, latents[-1]])


def _latent_error(convergence: Convergence) -> Panel:
    error = convergence.latent_error
    panel = Panel(
        'latent_error',
        'Latent error',
        '|ξ − ξ̄|',
        'Distance from the target in latent coordinates. It need not end at zero: a force on one '
        'mass does not hold every shape.',
    )
    if error is None:
        return _without(panel, 'The checkpoint is not known, or was not found.')
    if not _is_shown(error):
        return _without(panel, 'No target was in force.')
    curve = _curve('|ξ − ξ̄|', convergence.latent_time, error, COLOURS[0], width=2)
    figure = _figure([curve], convergence, has_legend=False)
    figure['layout']['yaxis']['rangemode'] = 'tozero'
    return _with(panel, figure)


def _force(convergence: Convergence) -> Panel:
    run = convergence.run
    mass = 'one mass' if run.actuated_mass is None else f'mass {run.actuated_mass}'
    panel = Panel(
        'force', 'Force', 'N', f'The only input of the body: on {mass}, held until the next.'
    )
    curves = [
        _curve('|u|', convergence.force_time, convergence.force_norm, _GREY, is_held=True),
        *(
            _curve(name, convergence.force_time, component, colour, is_held=True)
            for name, component, colour in zip(('u x', 'u y'), run.force.T, COLOURS, strict=False)
        ),
    ]
    if len(run.external_force):
        time = (run.external_force_stamp - run.configuration_stamp[0]) / NANOSECONDS
        push = np.hypot(*run.external_force.T)
        curves.append(_cloud('|external force|', time, push, COLOURS[3], size=6))
    if not len(run.force) and not len(run.external_force):
        return _without(panel, 'No force is in the log.')
    return _with(panel, _figure(curves, convergence))


def _energy(convergence: Convergence) -> Panel:
    energy = convergence.energy
    panel = Panel(
        'energy',
        'Energy',
        'J',
        'Of the body: what moves, what its springs and its weight hold, and the sum.',
    )
    if energy is None:
        return _without(panel, 'The network is not known: name its file by --network.')
    curves = [
        _curve('total', convergence.time, energy.total, '', width=2),
        _curve('kinetic', convergence.time, energy.kinetic, COLOURS[0]),
        _curve('elastic', convergence.time, energy.elastic, COLOURS[1]),
        _curve('gravitational', convergence.time, energy.gravitational, COLOURS[2]),
    ]
    return _with(panel, _figure(curves, convergence))


def _timing(timing: Timing) -> Panel:
    measured = (
        ('period', timing.period_time, timing.period, COLOURS[5]),
        ('age', timing.age_time, timing.age, COLOURS[1]),
    )
    shown = [
        _cloud(name, time, _MILLISECONDS * np.where(values > 0, values, np.nan), colour)
        for name, time, values, colour in measured
        if _is_shown(values)
    ]
    panel = Panel(
        'timing',
        'Timing',
        'ms',
        'By the wall clock. Period: from the arrival of one configuration at the recorder to that '
        'of the next. Age: from the sending of a configuration to that of the force that answers '
        f'it. {" ".join(_percentiles(name, values) for name, _, values, _ in measured)}'.strip(),
    )
    if not shown:
        return _without(panel, 'The log does not have two configurations, nor an answer to one.')
    end = max(float(time[-1]) for _, time, values, _ in measured if _is_shown(values))
    return _with(panel, _layout(shown, end, is_log=True))


def _percentiles(name: str, seconds: Float[np.ndarray, ' k']) -> str:
    known = seconds[np.isfinite(seconds)]
    if not len(known):
        return ''
    median, late = (quantity(float(each), 's') for each in np.percentile(known, [50, 99]))
    longest = quantity(float(known.max()), 's')
    return f'{name.capitalize()}: {median} in the median, {late} at 99 %, {longest} at most.'


def _losses(timing: Timing) -> list[Panel]:
    lost = {name: counts for name, counts in timing.lost.items() if counts.any()}
    if not lost:
        return []
    curves = [
        _curve(name, timing.loss_time[name], counts.astype(float), colour, is_held=True)
        for (name, counts), colour in zip(lost.items(), COLOURS, strict=False)
    ]
    caption = 'Summed up, by the numbers that publishers give their messages.'
    panel = Panel('losses', 'Lost messages', '', caption)
    end = max(float(timing.loss_time[name][-1]) for name in lost)
    return [_with(panel, _layout(curves, end))]


def _with(panel: Panel, figure: Figure) -> Panel:
    return replace(panel, figure=figure)


def _without(panel: Panel, reason: str) -> Panel:
    return replace(panel, missing=reason)


def _is_shown(values: Float[np.ndarray, ' samples']) -> bool:
    return bool((np.abs(values) <= LARGEST_SHOWN).any())  # which NaN is not


def _curve(
    name: str,
    time: Float[np.ndarray, ' samples'],
    values: Float[np.ndarray, ' samples'],
    colour: str,
    *,
    width: float = 1.4,
    dash: str = 'solid',
    is_held: bool = False,
    largest: int = LARGEST_CURVE,
) -> _Curve:
    """Return a trace; without a colour it takes that of the text, light or dark."""
    shown = np.where(np.abs(values) <= LARGEST_SHOWN, values, np.nan)
    place = shown_samples(shown, largest)
    line = {'color': colour or _GREY, 'width': width, 'dash': dash}
    return {
        'type': 'scatter',
        'mode': 'lines' if np.isfinite(shown).sum() >= _FEW else 'markers',
        'name': name,
        'x': packed(time[place]),
        'y': packed(shown[place].astype(np.float32)),
        'line': line | ({'shape': _HELD} if is_held else {}),
        'meta': {'foreground': not colour},
    }


def _cloud(
    name: str,
    time: Float[np.ndarray, ' samples'],
    values: Float[np.ndarray, ' samples'],
    colour: str,
    size: float = 3,
) -> _Curve:
    """Return a trace of points [px]."""
    curve = _curve(name, time, values, colour, largest=LARGEST_CLOUD)
    return curve | {'mode': 'markers', 'marker': {'color': colour, 'size': size}}


def _figure(
    curves: list[_Curve],
    convergence: Convergence,
    *,
    is_log: bool = False,
    has_legend: bool = True,
    shapes: Sequence[dict[str, Any]] = (),
) -> Figure:
    if convergence.target_time > 0:
        shapes = [*shapes, _line(x=convergence.target_time)]
    figure = _layout(curves, float(convergence.time[-1]), is_log, has_legend)
    figure['layout']['shapes'] = list(shapes)
    return figure


def _layout(
    curves: list[_Curve], end: float, is_log: bool = False, has_legend: bool = True
) -> Figure:
    layout = {
        'hovermode': 'x unified',
        'showlegend': has_legend,
        'xaxis': {'range': [0, end or 1.0], 'ticksuffix': ' s', 'hoverformat': '.5g'},
        'yaxis': {
            'type': 'log' if is_log else 'linear',
            'exponentformat': 'power',
            'hoverformat': '.4g',
        },
    }
    return {'data': curves, 'layout': layout}


def _line(*, x: float | None = None, y: float | None = None, dash: str = 'solid') -> dict[str, Any]:
    """Return a line through the whole plot, at one x or at one y."""
    line = {'type': 'line', 'line': {'color': _GREY, 'width': 1.2, 'dash': dash}}
    if x is not None:
        return line | {'x0': x, 'x1': x, 'y0': 0, 'y1': 1, 'yref': 'paper'}
    return line | {'x0': 0, 'x1': 1, 'xref': 'paper', 'y0': y, 'y1': y}


def _subscript(number: int) -> str:
    return str(number).translate(str.maketrans('0123456789', '₀₁₂₃₄₅₆₇₈₉'))
