"""Parameters of the nodes: declared once in config/nodes/*.yaml, checked here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from dpc_ros.resources import config_path

_TYPES: dict[str, tuple[type, ...]] = {
    'bool': (bool,),
    'integer': (int,),
    'double': (float, int),
    'string': (str,),
    'string_array': (list, tuple),
}
_NODES = ('simulator', 'encoder', 'controller', 'recorder')


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

    def check(self, value: Any) -> Any:
        """Return the value, a whole number as a float where a double is meant.

        Raises:
            ParameterError: wrong type, out of range, or none of the options.
        """
        if value is None and self.type == 'string_array':
            value = []  # an empty list of a parameter file comes as None
        kinds = _TYPES[self.type]
        is_bool = isinstance(value, bool)
        if not isinstance(value, kinds) or is_bool != (self.type == 'bool'):
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

    def descriptor(self) -> ParameterDescriptor:
        """Return what `ros2 param describe` shows; parameters are read-only after start."""
        unit = f' [{self.unit}]' if self.unit else ''
        descriptor = ParameterDescriptor(
            name=self.name,
            description=self.description + unit,
            additional_constraints=f'one of {", ".join(self.options)}' if self.options else '',
            read_only=True,
        )
        if self.range is not None and self.type == 'double':
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=self.range[0], to_value=self.range[1])
            ]
        elif self.range is not None:
            descriptor.integer_range = [
                IntegerRange(from_value=int(self.range[0]), to_value=int(self.range[1]), step=1)
            ]
        return descriptor


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


def declare_parameters(node: Node, kind: str) -> dict[str, Any]:
    """Declare the parameters of a kind of node and return their values.

    A parameter that belongs to another kind of node of this package is passed over, so that a
    parameter file may give one value to all of them.

    Args:
        node: the node.
        kind: `simulator`, `encoder`, `controller` or `recorder`.

    Raises:
        ParameterError: an override is unknown, of the wrong type or out of range.
    """
    known = declarations(kind)
    elsewhere = {name for other in _NODES for name in declarations(other)}
    # rclpy takes overrides silently, known or not; there is no public way to list them.
    overrides = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
    for name in overrides:
        if name not in known and name not in elsewhere and not _is_rclpy_own(name):
            raise ParameterError(f'unknown parameter {name!r}: {kind} has {", ".join(known)}')
    values = {}
    for name, declaration in known.items():
        values[name] = declaration.check(overrides.get(name, declaration.default))
        node.declare_parameter(name, values[name], declaration.descriptor(), ignore_override=True)
    return values


def _is_rclpy_own(name: str) -> bool:
    return name in ('use_sim_time', 'start_type_description_service') or name.startswith(
        'qos_overrides.'
    )
