"""Parameters of the nodes, declared once in config/nodes/*.yaml; files and texts of values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import yaml

from dpc_ros.resources import config_path

_TYPES: dict[str, tuple[type, ...]] = {
    'bool': (bool,),
    'integer': (int,),
    'double': (float, int),
    'string': (str,),
    'string_array': (list, tuple),
}
KINDS = ('simulator', 'encoder', 'controller', 'recorder', 'player', 'markers', 'viewer')


class ParameterError(ValueError):
    """A parameter that is unknown, of the wrong type or out of range."""


@dataclass(frozen=True)
class Declaration:
    """One parameter, as config/nodes declares it."""

    name: str
    type: str
    default: Any
    description: str
    unit: str = ''
    range: tuple[float, float] | None = None
    options: tuple[str, ...] = ()
    live: bool = False  # whether it can be set while the node runs

    def check(self, value: Any) -> Any:
        """Return the value, a whole number as a float where a double is meant.

        Raises:
            ParameterError: wrong type, out of range, or none of the options.
        """
        if value is None and self.type == 'string_array':
            value = []  # an empty list of a parameter file comes as None
        fits = isinstance(value, _TYPES[self.type])
        is_bool = isinstance(value, bool)
        if not fits or is_bool != (self.type == 'bool'):
            raise ParameterError(f'{self.name}: expected a {self.type}, got {value!r}')
        if self.type == 'string_array':
            value = [str(item) for item in value]
        if self.range is not None and not self.range[0] <= value <= self.range[1]:
            raise ParameterError(
                f'{self.name}: expected {self.range[0]:g} to {self.range[1]:g} {self.unit}'.rstrip()
                + f', got {value:g}'
            )
        chosen = value if self.type == 'string_array' else [value]
        if self.options and not set(chosen) <= set(self.options):
            raise ParameterError(
                f'{self.name}: expected one of {", ".join(self.options)}, got {value!r}'
            )
        return float(value) if self.type == 'double' else value

    def parse(self, text: str) -> Any:
        """Return the value that a text means.

        Raises:
            ParameterError: it means none of this type.
        """
        read = {'string': str, 'double': float}.get(self.type, yaml.safe_load)
        try:
            value = read(text)
        except (yaml.YAMLError, ValueError) as error:
            raise ParameterError(f'{self.name}: expected a {self.type}, got {text!r}') from error
        return self.check(value)


@cache
def declarations(node_name: str) -> Mapping[str, Declaration]:
    """Return the parameters of a node, those common to all included."""
    found: dict[str, Declaration] = {}
    for part in ('common', node_name):
        content = yaml.safe_load(config_path('nodes', f'{part}.yaml').read_text())
        for name, entry in content.items():
            values = {'options': (), **entry}
            if 'range' in values:
                low, high = values['range']
                values['range'] = (low, high)
            found[name] = Declaration(name=name, **{**values, 'options': tuple(values['options'])})
    return found


def parse_overrides(items: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return values by node and parameter of texts `<node>.<parameter>=<value>`.

    The value of a parameter that no node declares stays the text that it is.

    Raises:
        ValueError: a text has another form.
        ParameterError: a value is of the wrong type or out of range.
    """
    overrides: dict[str, dict[str, Any]] = {}
    for item in items:
        name, equals, value = item.partition('=')
        node, dot, parameter = name.partition('.')
        if not (equals and dot and parameter):
            raise ValueError(f'--set {item}: expected <node>.<parameter>=<value>')
        known = declarations(node) if node in KINDS else {}
        try:
            parsed = known[parameter].parse(value) if parameter in known else value
        except ParameterError as error:
            raise ParameterError(f'{node}: {error}') from error
        overrides.setdefault(node, {})[parameter] = parsed
    return overrides


def read_sections(text: str, origin: str, others: Iterable[str] = ()) -> dict[str, dict[str, Any]]:
    """Return the sections of a ROS 2 parameter file by the kind of node, `/**` for all of them.

    Args:
        text: of the file.
        origin: what to call it in an error.
        others: sections that are of no node, and are passed over.

    Raises:
        ParameterError: it is no such file.
    """
    try:
        content = yaml.safe_load(text) or {}
        return {
            section.removeprefix('/**/').lstrip('/') if section != '/**' else section: dict(
                entry['ros__parameters']
            )
            for section, entry in content.items()
            if section not in others
        }
    except (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise ParameterError(
            f'{origin}: expected a ROS 2 parameter file (node: ros__parameters: …), '
            f'but {type(error).__name__}: {error}'
        ) from error


def read_options(text: str, origin: str) -> dict[str, Any]:
    """Return names and values that a text says as YAML; an empty one says none.

    Args:
        text: what to read.
        origin: what to call it in an error.

    Raises:
        ParameterError: it is no YAML, or another kind of it.
    """
    try:
        options = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ParameterError(f'{origin}: expected YAML, got {text!r}') from error
    options = {} if options is None else options
    if not isinstance(options, dict):
        raise ParameterError(f'{origin}: expected names and values as YAML, got {text!r}')
    return options


def node_parameters(kind: str, *given: Mapping[str, Any]) -> dict[str, Any]:
    """Return every parameter of a kind of node.

    Args:
        kind: one of `KINDS`.
        given: values that win over the defaults, later ones over earlier ones; what the kind does
            not declare is passed over.

    Raises:
        ParameterError: a value is of the wrong type or out of range.
    """
    parameters = {}
    for name, declaration in declarations(kind).items():
        values = [each[name] for each in given if name in each]
        try:
            parameters[name] = declaration.check(values[-1] if values else declaration.default)
        except ParameterError as error:
            raise ParameterError(f'{kind}: {error}') from error
    return parameters
