"""Text definitions of ROS message types, as MCAP's `ros2msg` schemas hold them.

They are read off the generated classes, since an installation need not carry the `.msg` files.
The classes know neither comments nor the types of constants, and defaults of fields are left out:
a constant's type is inferred from its value. None of that matters for decoding a message.
"""

from __future__ import annotations

import re
from importlib import import_module
from typing import Any

_SEPARATOR = '=' * 80 + '\n'

# Primitive types whose names differ between the classes (IDL) and `.msg` files.
_MSG_NAMES = {'boolean': 'bool', 'octet': 'byte', 'float': 'float32', 'double': 'float64'}

_TYPE_NAME = re.compile(r'(?P<package>[a-z][a-z0-9_]*)/msg/(?P<name>[A-Z][A-Za-z0-9]*)')
_FIELD = re.compile(
    r'\s*(?P<type>[A-Za-z][\w/]*(?:<=\d+)?)(?P<array>\[[^\]]*\])?\s+(?P<name>\w+)\s*(?P<constant>=)?'
)
_SEQUENCE = re.compile(r'sequence<(.+?)(?:, (\d+))?>')
_ARRAY = re.compile(r'(.+)\[(\d+)\]')
_BOUNDED_STRING = re.compile(r'(w?string)<(\d+)>')


def message_type_name(message_class: type[Any]) -> str:
    """Return the full name of a message type, for example `sensor_msgs/msg/JointState`."""
    package, folder, _ = message_class.__module__.split('.')
    return f'{package}/{folder}/{message_class.__name__}'


def find_message_class(type_name: str) -> type[Any]:
    """Return the class of a message type, for example of `sensor_msgs/msg/JointState`.

    Raises:
        ValueError: it is no message type, or its Python package is not installed.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    try:
        if match:
            return getattr(import_module(f'{match["package"]}.msg'), match['name'])
    except (ImportError, AttributeError) as error:
        raise ValueError(
            f'{type_name}: expected a type of an installed package, but {error}: '
            'install it, or source the workspace that has it'
        ) from error
    raise ValueError(f'expected a message type, as sensor_msgs/msg/JointState, got {type_name!r}')


def message_definition(message_class: type[Any]) -> str:
    """Return the definition of a message type and of all types that it is made of.

    The type itself comes first. Each dependency follows once, in the order of appearance, headed by
    a line of 80 `=` and a line `MSG: <package>/<Type>`.

    Raises:
        ValueError: a field has a type that `.msg` files cannot express.
    """
    classes = [message_class]
    for known in classes:
        for element, _ in map(_element_and_suffix, known.get_fields_and_field_types().values()):
            if '/' in element:
                package, name = element.split('/')
                dependency = getattr(import_module(f'{package}.msg'), name)
                if dependency not in classes:
                    # The loop goes on to it, and so to its own dependencies.
                    classes.append(dependency)
    own, *dependencies = (_own_definition(known) for known in classes)
    return _SEPARATOR.join(
        [
            own,
            *(
                f'MSG: {message_type_name(known).replace("/msg/", "/")}\n{definition}'
                for known, definition in zip(classes[1:], dependencies, strict=True)
            ),
        ]
    )


def _own_definition(message_class: type[Any]) -> str:
    lines = [
        f'{_constant_type(value)} {name}={_constant_text(value)}'
        for name, value in _constants(message_class).items()
    ]
    for name, idl_type in message_class.get_fields_and_field_types().items():
        element, suffix = _element_and_suffix(idl_type)
        lines.append(f'{element}{suffix} {name}')
    # An empty text would say that the definition is not known.
    return ''.join(f'{line}\n' for line in lines or ['# no fields'])


def _element_and_suffix(idl_type: str) -> tuple[str, str]:
    """Split a field's type into the `.msg` name of its element and its array suffix, if any."""
    suffix = ''
    if match := _SEQUENCE.fullmatch(idl_type):
        idl_type, bound = match.groups()
        suffix = f'[<={bound}]' if bound else '[]'
    elif match := _ARRAY.fullmatch(idl_type):
        idl_type, size = match.groups()
        suffix = f'[{size}]'
    if match := _BOUNDED_STRING.fullmatch(idl_type):
        return f'{match[1]}<={match[2]}', suffix
    if not re.fullmatch(r'\w+(/\w+)?', idl_type):
        raise ValueError(f'field type: expected one of .msg files, got {idl_type!r}')
    return _MSG_NAMES.get(idl_type, idl_type), suffix


def _constants(message_class: type[Any]) -> dict[str, Any]:
    # The generated metaclass keeps them, and nothing else, under this mangled name.
    metaclass = type(message_class)
    return getattr(metaclass, f'_{metaclass.__name__}__constants')


def _constant_type(value: bool | int | float | str | bytes) -> str:
    if isinstance(value, int) and not isinstance(value, bool):
        if value >= 2**63:
            return 'uint64'
        return 'int32' if -(2**31) <= value < 2**31 else 'int64'
    return {bool: 'bool', float: 'float64', str: 'string', bytes: 'byte'}[type(value)]


def _constant_text(value: bool | int | float | str | bytes) -> str:
    if isinstance(value, bytes):
        return str(value[0])
    return repr(value)


def check_definition(message_class: type[Any], definition: str) -> None:
    """Make sure that a type is installed as it is defined elsewhere: the same fields, all the way.

    Comments, constants and defaults may differ: they are not in a message.

    Raises:
        ValueError: a field differs.
    """
    name = message_type_name(message_class)
    expected = _fields_by_type(name, definition)
    installed = _fields_by_type(name, message_definition(message_class))
    for known, fields in expected.items():
        if installed.get(known) != fields:
            raise ValueError(
                f'{name}: {known} was recorded with the fields {_shown(fields)}, but the installed '
                f'one has {_shown(installed.get(known, []))}: install the version that was recorded'
            )


def _fields_by_type(name: str, definition: str) -> dict[str, list[str]]:
    """Return the fields, as `<type> <name>`, of a type and of all that it is made of."""
    own, *dependencies = re.split(r'^=+\n', definition, flags=re.M)
    parts = {name.replace('/msg/', '/'): own}
    for text in dependencies:
        header, _, body = text.partition('\n')
        parts[header.removeprefix('MSG:').strip().replace('/msg/', '/')] = body
    return {
        known: [
            f'{_full_type(match["type"], known)}{match["array"] or ""} {match["name"]}'
            for match in map(_FIELD.match, body.splitlines())
            if match and not match['constant']
        ]
        for known, body in parts.items()
    }


def _full_type(element: str, owner: str) -> str:
    """Return the name of a field's type with its package, as `.msg` files may leave it out."""
    element = element.replace('/msg/', '/')
    if element == 'Header':
        return 'std_msgs/Header'
    if element[0].isupper():
        return f'{owner.partition("/")[0]}/{element}'
    return {'char': 'uint8'}.get(element, element)


def _shown(fields: list[str]) -> str:
    return '; '.join(fields) or 'none'
