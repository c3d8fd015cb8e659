"""The convergence of a run as a table for the terminal."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from dpc_ros.bag.convergence import Convergence
from dpc_ros.bag.reader import Run

_FIRST_TIMES = (0.0, 0.25, 0.5)  # s; whole seconds follow, then whole tens, …
_TIMES_PER_DECADE = 9
_NOTHING = '–'
_COLUMNS = ('t [s]', 'nMSE', 'latent error', '|force| [N]', 'kinetic [J]', 'potential [J]')
_WIDTHS = (8, 11, 12, 11, 11, 13)


def table(convergence: Convergence) -> str:
    """Return a convergence in lines of text: models and target, course in time, summary, messages.

    A row shows what was the case at its time: the last sample at or before it.
    """
    run = convergence.run
    outcome = describe_outcome(convergence)
    nmse, *others = (f'{name:<13}  {text}' for name, text in outcome.items())
    lines = [
        f'network     {run.network_identifier or _NOTHING}',
        f'checkpoint  {run.autoencoder_identifier or _NOTHING}',
        f'target      {describe_target(convergence)}',
        '',
        _line(_COLUMNS),
        *(format_row(row) for row in course(convergence)),
        '',
        f'{nmse}  FAILED: the body ended farther from the target' if convergence.failed else nmse,
        *others,
        '',
        *_messages(run),
    ]
    return '\n'.join(lines)


def row_times(end: float) -> list[float]:
    """Return the times that a log of that length [s] is shown at, its end among them."""
    times = [time for time in _FIRST_TIMES if time < end]
    step = 1.0
    while step < end:
        times += [k * step for k in range(1, _TIMES_PER_DECADE + 1) if k * step < end]
        step *= 10
    return [*times, end]


def describe_target(convergence: Convergence) -> str:
    """Return in words which target was in force at the end."""
    ignored = convergence.ignored_targets
    suffix = f' ({ignored} unusable ignored)' if ignored else ''
    target = convergence.target
    if target is None:
        return 'none in force' + suffix
    kind = 'configuration' if target.latent is None else 'latent'
    name = f' of {target.frame_id}' if target.frame_id else ''
    return f'{kind}{name} from {convergence.target_time:g} s' + suffix


def describe_outcome(convergence: Convergence) -> dict[str, str]:
    """Return in words what a run comes down to, by the name of each number."""
    return {
        'final nMSE': _number(convergence.final_nmse),
        'settling time': _settling(convergence),
        'peak force': _number(convergence.peak_force, 'N'),
        'RMS force': _number(convergence.rms_force, 'N'),
    }


def course(convergence: Convergence) -> list[dict[str, float]]:
    """Return the rows of the table as numbers: time, nMSE, latent error, force, energies.

    A value is NaN where it was not measured.
    """
    energy = convergence.energy
    signals = {
        'nmse': (convergence.time, convergence.nmse),
        'latent_error': (convergence.latent_time, convergence.latent_error),
        'force_N': (convergence.force_time, convergence.force_norm),
        'kinetic_J': (convergence.time, energy.kinetic if energy else None),
        'potential_J': (convergence.time, energy.potential if energy else None),
    }
    return [
        {'time_s': time, **{name: _last(*signal, time) for name, signal in signals.items()}}
        for time in row_times(convergence.time[-1])
    ]


def summary(convergence: Convergence) -> dict[str, float]:
    """Return what a run comes down to, as numbers: NaN where there is none."""
    return {
        'final_nmse': convergence.final_nmse,
        'settling_time_s': convergence.settling_time,
        'peak_force_N': convergence.peak_force,
        'rms_force_N': convergence.rms_force,
    }


def format_row(row: dict[str, float]) -> str:
    """Return a row of `course` as a line of the table."""
    time, *values = row.values()
    return _line((f'{time:.2f}', *(_number(value) for value in values)))


def _last(
    times: Float[np.ndarray, ' k'], values: Float[np.ndarray, ' k'] | None, time: float
) -> float:
    place = np.searchsorted(times, time, side='right') - 1
    return np.nan if values is None or place < 0 else float(values[place])


def _line(cells: tuple[str, ...]) -> str:
    return '  '.join(cell.rjust(width) for cell, width in zip(cells, _WIDTHS, strict=True))


def _number(value: float, unit: str = '') -> str:
    return _NOTHING if np.isnan(value) else f'{value:.4g} {unit}'.rstrip()


def _settling(convergence: Convergence) -> str:
    if convergence.target is None:
        return _NOTHING
    if np.isnan(convergence.settling_time):
        return 'never'
    text = _number(convergence.settling_time, 's')
    if convergence.target_time > 0:
        since = convergence.settling_time - convergence.target_time
        text += f' ({_number(since, "s")} after its target)'
    return text


def _messages(run: Run) -> list[str]:
    lines = []
    width = max(len(topic) for topic in run.messages)
    for topic, count in sorted(run.messages.items()):
        notes = [
            f'{number} {what}'
            for number, what in (
                (run.repeats.get(topic, 0), 'repeated'),
                (run.losses.get(topic, 0), 'LOST'),
                (run.setbacks.get(topic, 0), 'with a stamp SET BACK'),
            )
            if number
        ]
        lines.append(f'{topic.ljust(width)}  {count:>8} messages  {", ".join(notes)}'.rstrip())
    return lines
