"""The control law and its gains, to be changed while the loop runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from dpc_ros.control.registry import LAW_PARAMETERS, law_names
from dpc_ros.parameters import declarations
from dpc_ros.view.actions import Actions

if TYPE_CHECKING:
    from viser import GuiApi

_LAW = 'law'
_NUMBERS = ('double', 'integer')
_DECIMALS = 20  # that a field shows, and takes; else they are those of its default


class LawPanel:
    """A field for each number that the law depends on; all that was changed is applied together.

    Args:
        gui: of a viser server, within the container that they are to stand in.
        actions: of the loop.
    """

    def __init__(self, gui: GuiApi, actions: Actions) -> None:
        declared = declarations('controller')
        self._in_force: dict[str, Any] = {}
        names = law_names()
        self._fields: dict[str, Any] = {
            _LAW: gui.add_dropdown('Law', names, hint=declared[_LAW].description)
        }
        for name in LAW_PARAMETERS:
            each = declared[name]
            if each.type in _NUMBERS:
                low, high = each.range or (None, None)
                label = name.replace('_', ' ') + (f' [{each.unit}]' if each.unit else '')
                step = 1 if each.type == 'integer' else _step(each.default)
                self._fields[name] = gui.add_number(
                    label, each.default, min=low, max=high, step=step, hint=each.description
                )
            if each.type == 'double':
                self._fields[name].precision = _DECIMALS
        apply = gui.add_button('Apply')
        apply.on_click(lambda _: actions.tune(self._changed()))
        self.show({name: declared[name].default for name in self._fields})

    def show(self, parameters: Mapping[str, Any]) -> None:
        """Show what is in force; a field that was changed and not applied yet keeps its change."""
        for name, value in parameters.items():
            field = self._fields.get(name)
            if field is None:
                continue
            if name == _LAW and value not in field.options:
                field.options = (*field.options, value)  # of a package that only the node has
            is_changed = name in self._in_force and field.value != self._in_force[name]
            self._in_force[name] = value
            if not is_changed:
                field.value = value

    def _changed(self) -> dict[str, Any]:
        """Return what differs from what is in force."""
        return {
            name: type(self._in_force[name])(field.value)
            for name, field in self._fields.items()
            if field.value != self._in_force[name]
        }


def _step(default: float) -> float:
    """Return what a field resolves: a thousandth of the order of magnitude of its default."""
    return 10.0 ** (math.floor(math.log10(default or 1.0)) - 3)
