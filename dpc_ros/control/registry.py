"""The control laws by their names: those of this package, and those that others register."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from dpc_ros.control.law import ControlLaw, LawSettings
from dpc_ros.control.laws import PaperLaw, ReducedEquilibriumLaw, TransposeLaw
from dpc_ros.control.regulator import QuadraticRegulator
from dpc_ros.parameters import read_options
from dpc_ros.reduction import CompressedSystem

ENTRY_POINT_GROUP = 'dpc_ros.control_laws'

LAWS: dict[str, type[ControlLaw]] = {
    'lqr': QuadraticRegulator,
    'reduced_equilibrium': ReducedEquilibriumLaw,
    'transpose': TransposeLaw,
    'paper': PaperLaw,
}

_NUMBERS = tuple(each.name for each in fields(LawSettings) if each.name != 'options')
LAW_PARAMETERS = ('law', 'law_options', *_NUMBERS)  # of a controller, that its law depends on


def make_law(
    name: str, system: CompressedSystem, settings: LawSettings | None = None
) -> ControlLaw:
    """Return the control law of a name, without a target yet.

    Args:
        name: a key of `LAWS`, or that of an entry point in the group `dpc_ros.control_laws`, whose
            object takes (system, settings) and returns a `ControlLaw`.
        system: the compressed system.
        settings: gains and bound, the defaults where left out.

    Raises:
        ValueError: there is no such law, one of this package is given options, or one of another
            package can't be loaded or made.
    """
    settings = settings or LawSettings()
    if name in LAWS:
        if settings.options:
            raise ValueError(
                f'control law {name!r} takes no options, got {sorted(settings.options)}: what it '
                'takes are parameters of their own'
            )
        return LAWS[name](system, settings)
    law = _load(name)
    try:
        made = law(system, settings)
    except Exception as error:  # whatever goes wrong in code that is not ours
        raise ValueError(f'control law {name!r}: {error}') from error
    if not isinstance(made, ControlLaw):
        raise ValueError(f'control law {name!r}: expected a ControlLaw, got {type(made).__name__}')
    return made


def law_of_parameters(parameters: Mapping[str, Any], system: CompressedSystem) -> ControlLaw:
    """Return the law that a controller's parameters, those in `LAW_PARAMETERS`, ask for.

    Raises:
        ParameterError: the options are no YAML of names and values.
        ValueError: a number is out of its range, or the law can't be made.
    """
    options = read_options(parameters['law_options'], 'law_options')
    settings = LawSettings(**{name: parameters[name] for name in _NUMBERS}, options=options)
    return make_law(parameters['law'], system, settings)


def law_names() -> list[str]:
    """Return the names of all laws."""
    return [*LAWS, *_registered()]


def check_law(name: str) -> None:
    """Make sure that there is a law of a name.

    Raises:
        ValueError: there is none.
    """
    if name not in LAWS and name not in law_names():
        raise ValueError(
            f'unknown control law {name!r}: choose one of {", ".join(law_names())}; one of another '
            f'package is there once that package is installed with an entry point in the group '
            f'{ENTRY_POINT_GROUP!r}'
        )


def _load(name: str) -> Any:
    check_law(name)
    point = _registered()[name]
    try:
        return point.load()
    except Exception as error:  # whatever goes wrong in code that is not ours
        raise ValueError(
            f'control law {name!r}: {point.value} can not be loaded, {error}'
        ) from error


def _registered() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}
