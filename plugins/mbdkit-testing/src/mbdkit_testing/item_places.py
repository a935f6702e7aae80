"""Where the code of an item of a plugin is, and which pages of the guide mention it, for `mbdkit plugins where`."""

from __future__ import annotations

import ast
import importlib.util
import inspect
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from mbdkit.base.errors import SpecError
from mbdkit.base.terminal import show_result
from mbdkit.base.text import did_you_mean, listed
from mbdkit.cli.common_options import AsJson, Debug
from mbdkit.guide.pages import search
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.item import Plugin
from mbdkit.registry.items import Command
from mbdkit.registry.manager import registry
from mbdkit.registry.target import Target

PAGES = 3  #: Largest number of pages of the guide that are named for an item.


def whereabouts(name: str) -> dict[str, object]:
    """Return the items of any kind with a name, and for each the files and lines of its code and of its description.

    Raises
    ------
    SpecError
        If there is no such item.
    """
    if not (items := [item for item in registry().items if name in (item.id, item.name)]):
        names = list(dict.fromkeys(item.name for item in registry().items))
        raise SpecError(f"there is no item '{name}'{did_you_mean(name, names)}; see `mbdkit plugins list`")
    return {
        "items": [
            {
                "id": item.id,
                "kind": item.kind,
                "summary": item.plugin.summary,
                "help": _help(item),
                "entry_point": item.origin.entry_point,
                "places": [place._asdict() for place in places(item)],
                "guide": list(dict.fromkeys(hit.topic for hit in search(_guide_words(item))))[:PAGES],
            }
            for item in items
        ]
    }


def whereabouts_text(found: Mapping[str, Any]) -> str:
    """Return the result of `whereabouts` as text."""
    lines = []
    for item in found["items"]:
        lines += [f"{item['id']} ({item['kind']}): {item['summary']}"]
        lines += [f"  {place['field']}: {place['file']}:{place['line']}" for place in item["places"]]
        lines += [f"  entry point: {item['entry_point']}", f"  help: {item['help']}"]
        lines += [f"  guide: {listed(item['guide'])}"] if item["guide"] else []
    return "\n".join(lines)


def _help(item: Registered) -> str:
    """Return the command that prints the help on an item."""
    if isinstance(item.plugin, Command):
        return f"mbdkit {item.name} --help"
    return f"mbdkit plugins show {item.id}" if isinstance(item.plugin, Plugin) else "mbdkit guide plugins"


def _guide_words(item: Registered) -> str:
    return f"mbdkit {item.name}" if isinstance(item.plugin, Command) else item.name


def plugins_where(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="A name or id of any item, such as gauss, study or 'plugins new'.")
    ],
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Print the file and line of the code that a name adds.

    The name is that of a command, model, integrator, force law, study or measure.
    Also prints the command that shows its help, and the pages of the guide that
    mention it. With --json, prints one object with a list "items".
    """
    result = whereabouts(name)
    show_result(result, whereabouts_text(result), as_json=as_json)


class Place(NamedTuple):
    """File and line of an object that a field of an item names."""

    field: str
    file: str
    line: int


def places(item: Registered) -> list[Place]:
    """Return the places of the objects that an item names, in the order of its fields.

    Modules behind targets are read, not imported, unless they import the object from elsewhere.
    """
    results = []
    for field, value in {**vars(item.plugin), **item.plugin.targets()}.items():
        place = _of_target(value) if isinstance(value, Target) else _of_object(value)
        if place is not None and field != "references":
            results.append(Place(field, *place))
    return results


def _of_target(target: Target) -> tuple[str, int] | None:
    module, _, name = target.where.partition(":")
    spec = importlib.util.find_spec(module)
    if spec is not None and spec.origin is not None and spec.origin.endswith(".py"):
        tree = ast.parse(Path(spec.origin).read_bytes())
        for node in tree.body:
            if name in _defined(node):
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
