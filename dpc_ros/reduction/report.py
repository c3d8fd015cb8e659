"""A comparison in numbers: its course over time and its summary, and both as text."""

from __future__ import annotations

from typing import Any

from dpc_ros.reduction.comparison import Comparison

_ROWS = 11  # of the table


def course(comparison: Comparison) -> list[dict[str, float]]:
    """Return one row for each frame: errors of q [m²], q̇ [m²/s²] and energy [J²], energies [J]."""
    return [
        {
            'time_s': float(comparison.time[k]),
            'configuration_mse_m2': float(comparison.configuration_error[k]),
            'velocity_mse_m2_s2': float(comparison.velocity_error[k]),
            'squared_energy_error_J2': float(comparison.energy_error[k]),
            'energy_J': float(comparison.full.total[k]),
            'compressed_energy_J': float(comparison.compressed.total[k]),
        }
        for k in range(len(comparison.time))
    ]


def summary(comparison: Comparison) -> dict[str, Any]:
    """Return the errors of the whole motion, all of them ratios."""
    return {
        'relative_error': comparison.relative_error,
        'relative_error_about_rest': comparison.relative_error_about_rest,
        'relative_energy_error': comparison.relative_energy_error,
        'energy_increase': comparison.energy_increase,
    }


def table(comparison: Comparison) -> str:
    """Return the errors at eleven times and those of the whole motion as lines of text."""
    rows = course(comparison)
    shown = rows[:: max((len(rows) - 1) // (_ROWS - 1), 1)]
    lines = [f'{"t [s]":>7}{"MSE q [m²]":>14}{"MSE q̇ [m²/s²]":>17}{"energy [J]":>12}{"error":>12}']
    for row in shown:
        error = row['compressed_energy_J'] - row['energy_J']
        lines.append(
            f'{row["time_s"]:>7.2f}{row["configuration_mse_m2"]:>14.2e}'
            f'{row["velocity_mse_m2_s2"]:>16.2e}{row["energy_J"]:>12.4g}{error:>12.1e}'
        )
    lines += [
        '',
        f'relative error of q     {comparison.relative_error:.3%}',
        f'… about rest            {comparison.relative_error_about_rest:.3%}',
        f'energy, RMS over range  {comparison.relative_energy_error:.3%}',
        f'energy rises by         {comparison.energy_increase:.1%} of its range at most',
    ]
    return '\n'.join(lines)
