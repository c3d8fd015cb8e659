"""Parameters of a node as ROS 2 declares them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from dpc_ros.parameters import KINDS, Declaration, ParameterError, declarations


def declare_parameters(node: Node, kind: str) -> dict[str, Any]:
    """Declare the parameters of a kind of node and return their values.

    A parameter that belongs to another kind of node of this package is passed over, so that a
    parameter file may give one value to all of them.

    Args:
        node: the node.
        kind: one of `KINDS`.

    Raises:
        ParameterError: an override is unknown, of the wrong type or out of range.
    """
    known = declarations(kind)
    elsewhere = {name for other in KINDS for name in declarations(other)}
    # rclpy takes overrides silently, known or not; there is no public way to list them.
    overrides = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
    for name in overrides:
        if name not in known and name not in elsewhere and not _is_rclpy_own(name):
            raise ParameterError(f'unknown parameter {name!r}: {kind} has {", ".join(known)}')
    values = {}
    for name, declaration in known.items():
        values[name] = declaration.check(overrides.get(name, declaration.default))
        node.declare_parameter(name, values[name], _descriptor(declaration), ignore_override=True)
    return values


def changed_settings(
    kind: str, settings: Mapping[str, Any], parameters: Iterable[Parameter]
) -> dict[str, Any]:
    """Return the parameters of a kind of node with what one set asks for.

    What the kind does not declare, as rclpy's `use_sim_time`, is passed over.

    Args:
        kind: one of `KINDS`.
        settings: all that are in force, by name.
        parameters: of one set.

    Raises:
        ParameterError: a value is of the wrong type, out of range or none of the options.
    """
    known = declarations(kind)
    return {
        **settings,
        **{
            parameter.name: known[parameter.name].check(parameter.value)
            for parameter in parameters
            if parameter.name in known
        },
    }


def _is_rclpy_own(name: str) -> bool:
    return name in ('use_sim_time', 'start_type_description_service') or name.startswith(
        'qos_overrides.'
    )


def _descriptor(declared: Declaration) -> ParameterDescriptor:
    """Return what `ros2 param describe` shows; only live parameters can be set after start."""
    unit = f' [{declared.unit}]' if declared.unit else ''
    descriptor = ParameterDescriptor(
        name=declared.name,
        description=declared.description + unit,
        additional_constraints=f'one of {", ".join(declared.options)}' if declared.options else '',
        read_only=not declared.live,
    )
    if declared.range is not None:
        low, high = declared.range
        if declared.type == 'double':
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        else:
            descriptor.integer_range = [
                IntegerRange(from_value=int(low), to_value=int(high), step=1)
            ]
    return descriptor
