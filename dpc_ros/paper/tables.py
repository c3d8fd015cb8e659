"""The tables of the pages in docs/ and of the README, made from docs/results/*.json."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dpc_ros.files import replacing
from dpc_ros.paper.bodies import of_bodies
from dpc_ros.paper.published import (
    MSE,
    NOISE_DEVIATIONS,
    best_test_mse,
    published_mse_by_size,
)
from dpc_ros.results import quantity

Rows = list[dict[str, Any]]
# Beside the results.
PAGES = (
    'experiments.md',
    'control.md',
    'reliability.md',
    'hosts.md',
    'performance.md',
    '../README.md',
)
_SHORT = 10  # characters of a commit
_BLOCK = re.compile(r'(<!-- table (\w+) from (\w+) -->\n).*?(<!-- end -->)', re.DOTALL)


def write_tables(docs: Path) -> list[Path]:
    """Make every table of the pages anew from the results beside them; return the pages.

    Raises:
        FileNotFoundError: a page or a result is missing.
        ValueError: a page asks for a table that there is none of.
    """
    pages = [docs / name for name in PAGES]
    texts = [with_tables(page.read_text(), docs / 'results') for page in pages]
    for page, text in zip(pages, texts, strict=True):
        with replacing(page) as partial:
            partial.write_text(text)
    return pages


def with_tables(text: str, results: Path) -> str:
    """Return a page with the tables between its marks made from result files.

    Raises:
        FileNotFoundError: a result is missing.
        ValueError: the page asks for a table that there is none of.
    """

    def table(match: re.Match[str]) -> str:
        name, source = match.group(2), match.group(3)
        if name not in _TABLES:
            raise ValueError(f'no table {name!r}: expected one of {sorted(_TABLES)}')
        content = json.loads((results / f'{source}.json').read_text())
        rows = content['rows']
        commit, machine = str(content['commit'])[:_SHORT], content['machine']
        origin = f'`{source}.json`: `{content["command"]}`, commit {commit}, on {machine}.'
        if any('commit' in row for row in rows):  # they were measured by several commands
            origin = f'`{source}.json`, which has the commit of each row.'
        return f'{match.group(1)}\n{_TABLES[name](rows)}\nFrom {origin}\n\n{match.group(4)}'

    return _BLOCK.sub(table, text)


def _reproduction(rows: Rows) -> str:
    header = [
        'system',
        'model',
        'parameters',
        'train',
        'validation',
        'test',
        'paper’s test',
        'ratio',
    ]
    body = []
    for row in rows:
        if row['latent_size'] != 5 or row['model'] not in ('flat', 'graph'):
            continue
        train, validation, test = MSE[row['system'], row['model']]
        body.append(
            [
                row['system'][-1],
                row['model'],
                f'{row["parameters"]:,}',
                f'{_number(row["train_mse"])} ({_number(train)})',
                f'{_number(row["validation_mse"])} ({_number(validation)})',
                _number(row['test_mse']),
                _number(test),
                f'{row["ratio_to_paper"]:.2f}',
            ]
        )
    return _markdown(header, body)


def _ours(rows: Rows) -> str:
    columns = [
        ('POD', 'pod', 'paper', 'network', 5),
        ('ours', 'ours', 'paper', 'network', 5),
        ('with projection', 'ours', 'paper', 'projection', 5),
        ('more data', 'ours', 'extended', 'network', 5),
        ('more data, projection', 'ours', 'extended', 'projection', 5),
    ]
    return _by_system(rows, 5, columns, {'ours / paper’s': 1, 'projection / paper’s': 2})


def _small(rows: Rows) -> str:
    tables = []
    for m in (3, 2):
        columns = [
            (f'flat, m = {m}', 'flat', 'paper', 'network', m),
            (f'ours, m = {m}', 'ours', 'paper', 'network', m),
        ]
        tables.append(_by_system(rows, m, columns, {'ours / paper’s': 1}))
    return '\n'.join(tables)


def _by_system(
    rows: Rows,
    latent_size: int,
    columns: Sequence[tuple[str, str, str, str, int]],
    ratios: Mapping[str, int],
) -> str:
    header = [
        'system',
        'paper’s better value',
        *(column[0] for column in columns),
        *ratios,
    ]
    body = []
    for system in dict.fromkeys(row['system'] for row in rows):
        published = best_test_mse(system, latent_size)
        values = [_value(rows, system, *column[1:]) for column in columns]
        assert published is not None
        body.append(
            [
                system[-1],
                _number(published),
                *map(_number, values),
                *(f'{values[column] / published:.2f}' for column in ratios.values()),
            ]
        )
    return _markdown(header, body)


def _value(rows: Rows, system: str, model: str, data: str, encoder: str, m: int) -> float:
    wanted = {
        'system': system,
        'model': model,
        'training_data': data,
        'encoder': encoder,
        'latent_size': m,
    }
    return next(row['test_mse'] for row in rows if wanted.items() <= row.items())


def _compression(rows: Rows) -> str:
    sizes = sorted({row['latent_size'] for row in rows})
    header = ['system', 'model', *(f'm = {m}' for m in sizes)]
    body = []
    for system, model in dict.fromkeys((row['system'], row['model']) for row in rows):
        mine = [row for row in rows if (row['system'], row['model']) == (system, model)]
        errors = {row['latent_size']: row['test_mse'] for row in mine}
        published = published_mse_by_size(system, model)
        body.append([system[-1], model, *(_number(errors.get(m)) for m in sizes)])
        if published:
            body.append(['', 'published', *(_number(published.get(m)) for m in sizes)])
    return _markdown(header, body)


def _noise(rows: Rows) -> str:
    header = ['system', 'model', *(f'σ = {sigma:g} m' for sigma in NOISE_DEVIATIONS)]
    keys = ('system', 'model', 'training_data', 'encoder')
    body = []
    for chosen in dict.fromkeys(tuple(row[key] for key in keys) for row in rows):
        mine = [row for row in rows if tuple(row[key] for key in keys) == chosen]
        system, model, data, encoder = chosen
        label = model + (', more data' if data == 'extended' else '')
        label += ', projection' if encoder == 'projection' else ''
        body.append([system[-1], label, *(_number(row['test_mse']) for row in mine)])
        if mine[0]['paper_test_mse'] is not None:
            body.append(['', 'published', *(_number(row['paper_test_mse']) for row in mine)])
    return _markdown(header, body)


def _grid(rows: Rows) -> str:
    keys = ('learning_rate', 'weight_decay', 'step_factor', 'step_epochs')
    header = ['learning rate', 'λ', 'γ', 'step', 'train', 'validation']
    body = [
        [
            *(f'{row[key]:g}' for key in keys),
            _number(row['train_mse']),
            _number(row['validation_mse']),
        ]
        for row in rows
    ]
    return _markdown(header, body)


def _systems(rows: Rows) -> str:
    header = ['system', 'mobile masses', 'fixed', 'springs', 'width [m]', 'height [m]']
    keys = ('mobile_masses', 'fixed_masses', 'springs')
    body = [
        [
            row['system'][-1],
            *(str(row[key]) for key in keys),
            f'{row["width_m"]:.2f}',
            f'{row["height_m"]:.2f}',
        ]
        for row in rows
    ]
    return _markdown(header, body)


def _interpretability(rows: Rows) -> str:
    changes = sorted({row['change_of_range'] for row in rows if row['change_of_range'] > 0})
    header = ['system', 'variable', *(f'± {change:.0%}' for change in changes)]
    body = []
    for system, variable in dict.fromkeys((row['system'], row['variable']) for row in rows):
        cells = []
        for change in changes:
            moved = [
                row['displacement_rms_m']
                for row in rows
                if (row['system'], row['variable'], abs(row['change_of_range']))
                == (system, variable, change)
            ]
            cells.append(f'{sum(moved) / len(moved):.2f}')
        body.append([system[-1], f'ξ{"₀₁"[variable]}', *cells])
    return _markdown(header, body)


def _pointwise(rows: Rows) -> str:
    quantities = ('configuration', 'velocity', 'energy')
    header = ['system', 'model', 'q [m²]', 'q̇ [m²/s²]', 'energy [J²]']
    body = []
    keys = ('system', 'model', 'encoder')
    for chosen in dict.fromkeys(tuple(row[key] for key in keys) for row in rows):
        mine = [row for row in rows if tuple(row[key] for key in keys) == chosen]
        medians = (sum(row[f'{name}_median'] for row in mine) / len(mine) for name in quantities)
        system, model, encoder = chosen
        label = f'{model}, projection' if encoder == 'projection' else model
        body.append([system[-1], label, *map(_number, medians)])
    return _markdown(header, body)


def _results(rows: Rows) -> str:
    """Return the medians of every model side by side, and more of ours."""
    columns = (
        ('POD [%]', 'pod', 'paper'),
        ('graph [%]', 'graph', 'paper'),
        ('flat [%]', 'flat', 'paper'),
        ('ours [%]', 'ours', 'paper'),
        ('ours, more data [%]', 'ours', 'extended'),
    )
    header = ['system', *(column[0] for column in columns)]
    header += ['… about rest [%]', '… energy [%]', '… stable step [ms]']
    body = []
    for system in dict.fromkeys(row['system'] for row in rows):
        of = {(row['model'], row['training_data']): row for row in rows if row['system'] == system}
        best = of['ours', 'extended']
        body.append(
            [
                system[-1],
                *(_percent(of[column[1:]]['relative_error_median']) for column in columns),
                _percent(best['relative_error_about_rest_median']),
                _percent(best['energy_error_median']),
                _milliseconds(best['stable_step_s']),
            ]
        )
    return _markdown(header, body)


def _reduced(rows: Rows) -> str:
    header = [
        'system',
        'model',
        'q [%]',
        'about rest [%]',
        'worst [%]',
        'energy [%]',
        'energy rises [%]',
        'diverged',
        'stable step [ms]',
    ]
    keys = (
        'relative_error_median',
        'relative_error_about_rest_median',
        'relative_error_max',
        'energy_error_median',
        'energy_increase_max',
    )
    body = [
        [
            row['system'][-1],
            row['model'] + (', more data' if row['training_data'] == 'extended' else ''),
            *(_percent(row[key]) for key in keys),
            str(row['diverged']),
            _milliseconds(row['stable_step_s']),
        ]
        for row in rows
    ]
    return _markdown(header, body)


def _laws(rows: Rows) -> str:
    header = ['law', 'autoencoder', 'final nMSE', 'worst', 'over bound', '2 s over bound']
    header += ['settles [s]', 'failed', 'peak force [N]', 'RMS force [N]']
    body = []
    for row in rows:
        if row['experiment'] != 'paper_targets':
            continue
        many = row.get('equilibrium_starts', 2) > 2
        body.append(
            [
                row['law'] + (f', {row["equilibrium_starts"]} starts' if many else ''),
                row['checkpoint'].partition('@')[0].removeprefix('paper_2_').replace('_', ', '),
                _short(row['final_nmse_median']),
                _short(row['final_nmse_max']),
                _short(row['final_over_bound_median']),
                _short(row['nmse_2s_over_bound_median']),
                _short(row['settling_time_median_s']),
                f'{row["failed"]} of {row["runs"]}',
                f'{row["peak_force_median_N"]:.1f}',
                f'{row["rms_force_median_N"]:.1f}',
            ]
        )
    return _markdown(header, body)


def _robustness(rows: Rows) -> str:
    header = ['condition', 'over bound', '9 of 10 below', '2 s over bound', 'failed']
    body = []
    for row in rows:
        if row['experiment'] not in ('robustness', 'gravity'):
            continue
        body.append(
            [
                _condition(row),
                _short(row['final_over_bound_median']),
                _short(row['final_over_bound_90']),
                _short(row['nmse_2s_over_bound_median']),
                f'{row["failed"]} of {row["runs"]}',
            ]
        )
    return _markdown(header, body)


def _failures(rows: Rows) -> str:
    """Return every failed run of the paper's law at m = 2, with what was seen of it."""
    header = ['autoencoder', 'run', 'mass', 'final nMSE', 'static bound', 'what was seen']
    body = [
        [
            row['checkpoint'].partition('@')[0].removeprefix('paper_2_').replace('_', ', '),
            str(row['run']),
            str(row['actuated_mass']),
            _short(row['final_nmse']),
            _short(row['static_bound']),
            row['reason'],
        ]
        for row in rows
        if row['failed'] and row['law'] == 'paper' and row['latent_size'] == 2
    ]
    return _markdown(header, body)


def _condition(row: dict[str, Any]) -> str:
    if row['experiment'] == 'gravity':
        return f'gravity of {row["gravity_m_s2"]:g} m/s²'
    for name in ('stiffness', 'damping', 'mass'):
        if f'{name}_factor' in row:
            integral = f', integral gain {row["integral_gain"]:g}/s' if row['integral_gain'] else ''
            return f'true {name} × {row[f"{name}_factor"]:g}{integral}'
    parts = [
        f'hold {1e3 * row["hold_s"]:.0f} ms',
        f'latency {1e3 * row["latency_s"]:.0f} ms',
        f'σ = {row["sigma_m"]:g} m',
    ]
    if row.get('sigma_velocity_m_s'):
        parts.append(f'{row["sigma_velocity_m_s"]:g} m/s of velocities')
    return ', '.join(parts) + (', filtered' if row['observer'] == 'kalman' else '')


def _reachable(rows: Rows) -> str:
    header = ['integral gain [1/s]', 'nMSE at 2 s', 'at 3 s', 'at 5 s', 'at 10 s', 'failed']
    keys = ('nmse_2s_median', 'nmse_3s_median', 'nmse_5s_median', 'nmse_10s_median')
    body = [
        [
            f'{row["integral_gain"]:g}',
            *(_number(row[key]) for key in keys),
            f'{row["failed"]} of {row["runs"]}',
        ]
        for row in rows
        if row['experiment'] == 'reachable'
    ]
    return _markdown(header, body)


def _faults(rows: Rows) -> str:
    header = ['fault', 'mode', 'promise', 'kept', 'reaction [ms]', 'recovery [ms]', 'test']
    body = [
        [*_promise(row), _time(row, 'reaction'), _time(row, 'recovery'), f'`{row["test"]}`']
        for row in rows
    ]
    return _markdown(header, body)


def _promise(row: dict[str, Any]) -> list[str]:
    """Return what fails, in which mode, what is promised then, and how often that was kept."""
    kept = '{kept} of {repetitions}'.format_map(row)
    return [row['fault'], row['mode'], row['promise'], kept]


def _time(row: dict[str, Any], what: str) -> str:
    """Return the median of what was timed, and the longest [ms]."""
    if f'{what}_median_ms' not in row:
        return '–'
    return f'{row[f"{what}_median_ms"]:.0f} ({row[f"{what}_max_ms"]:.0f})'


def _hosts(rows: Rows) -> str:
    header = [
        'fault',
        'mode',
        'promise',
        'kept',
        'recovery [ms]',
        'measured delay [ms]',
        'nMSE at the end',
        'test',
    ]
    body = [
        [
            *_promise(row),
            _time(row, 'recovery'),
            f'{row["delay_ms"]:.0f}' if 'delay_ms' in row else '–',
            _number(row['nmse']) if 'nmse' in row else '–',
            f'`{row["test"]}`',
        ]
        for row in rows
        if 'bodies' not in row
    ]
    return _markdown(header, body)


def _bodies(rows: Rows) -> str:
    header = [
        'bodies',
        'processor time of all nodes [cores]',
        'round trip, median (p99) [ms]',
        'a newcomer knows all nodes after [s]',
    ]
    body = [
        [
            f'{row["bodies"]:g}',
            f'{row["cores"]:.2f}',
            f'{row["round_trip_p50_ms"]:.1f} ({row["round_trip_p99_ms"]:.1f})',
            f'{row["discovery_s"]:.2f}',
        ]
        for row in of_bodies(rows)
    ]
    return _markdown(header, body)


def _benchmarks(rows: Rows) -> str:
    header = ['benchmark', 'ours', 'beside', 'theirs', 'ratio', 'goal']
    body = []
    for row in rows:
        ours, theirs = (quantity(row[key], row['unit']) for key in ('ours_median', 'peer_median'))
        if 'ours_p99_s' in row:
            ours += f' (p99 {quantity(row["ours_p99_s"], "s")})'
            theirs += f' (p99 {quantity(row["peer_p99_s"], "s")})'
        goal = '' if row['goal'] is None else _short(row['goal'])
        name = row['benchmark'].replace('_', ' ')
        body.append([name, ours, row['peer'], theirs, _short(row['ratio']), goal])
    return _markdown(header, body)


_TABLES: dict[str, Callable[[Rows], str]] = {
    'reproduction': _reproduction,
    'ours': _ours,
    'small': _small,
    'compression': _compression,
    'noise': _noise,
    'grid': _grid,
    'systems': _systems,
    'interpretability': _interpretability,
    'pointwise': _pointwise,
    'reduced': _reduced,
    'results': _results,
    'laws': _laws,
    'robustness': _robustness,
    'reachable': _reachable,
    'failures': _failures,
    'faults': _faults,
    'hosts': _hosts,
    'bodies': _bodies,
    'benchmarks': _benchmarks,
}


def _number(value: float | None) -> str:
    return '' if value is None else f'{value:.2e}'.replace('e-0', 'e-').replace('e+00', '')


def _percent(value: float | None) -> str:
    return '–' if value is None else f'{100 * value:.2g}'


def _short(value: float | None) -> str:
    """Return three digits; what is infinite stands as null in the files."""
    return '∞' if value is None else f'{value:.3g}'


def _milliseconds(value: float | None) -> str:
    return '–' if value is None else f'{1e3 * value:.0f}'


def _markdown(header: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    lines = [header, ['---'] * len(header), *body]
    return ''.join(f'| {" | ".join(line)} |\n' for line in lines)
