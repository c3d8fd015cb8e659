"""Packages whose names are imported when they are asked for: a node needs few of each.

The names stand in the stub of the package, `__init__.pyi`, as an ordinary `__init__.py` has them:
type checkers and readers see what they are. (`lazy_loader` of Scientific Python does the same.) No
name may be that of a module of the package: the module would be found instead.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def attach_stub(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package with a stub.

    Args:
        package: its `__name__`.
        file: its `__file__`.
    """
    stub = ast.parse(Path(file).with_name('__init__.pyi').read_text(encoding='utf-8'))
    modules = {
        alias.name: statement.module
        for statement in stub.body
        if isinstance(statement, ast.ImportFrom) and statement.module
        for alias in statement.names
    }

    def get(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f'module {package!r} has no attribute {name!r}')
        return getattr(import_module(modules[name]), name)

    return get, lambda: sorted(modules), list(modules)
