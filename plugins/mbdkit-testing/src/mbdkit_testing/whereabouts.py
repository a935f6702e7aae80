"""Where the code of an item is: file and line of each object that the item names."""

from __future__ import annotations

import ast
import importlib.util
import inspect
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from mbdkit.registry.catalogue import Registered
from mbdkit.registry.target import Target


class Place(NamedTuple):
    """File and line of an object that a field of an item names."""

    field: str
    file: str
    line: int


def places(item: Registered) -> list[Place]:
    """Return the places of the objects that an item names, in the order of its fields.

    Modules behind targets are read, not imported, unless they import the object from elsewhere.
    """
    found = []
    for field, value in vars(item.plugin).items():
        place = _of_target(value) if isinstance(value, Target) else _of_object(value)
        if place is not None and field != "references":
            found.append(Place(field, *place))
    return found


def _of_target(target: Target[Any]) -> tuple[str, int] | None:
    spec = importlib.util.find_spec(target.module)
    if spec is not None and spec.origin is not None and spec.origin.endswith(".py"):
        tree = ast.parse(Path(spec.origin).read_bytes())
        for node in tree.body:
            if target.name in _defined(node):
                return spec.origin, node.lineno
    return _of_object(target())


def _defined(node: ast.stmt) -> set[str]:
    """Return the names that a statement of a module defines."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {node.name}
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}


def _of_object(value: Any) -> tuple[str, int] | None:
    """Return file and line of a function, a class or a file; None for other objects."""
    if isinstance(value, Path):
        return str(value), 1
    while isinstance(value, partial):
        value = value.func
    if not callable(value):
        return None
    value = inspect.unwrap(value)
    try:
        return str(inspect.getsourcefile(value)), inspect.getsourcelines(value)[1]
    except (TypeError, OSError):  # built-in, or typed in
        return None
