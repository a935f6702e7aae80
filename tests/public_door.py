"""What is promised: the names on the public doors, with their signatures.

``python -m tests.public_door > tests/public_door.txt`` writes them. They are taken from the source, without importing
it, so that the text is the same on every machine. The doors are `mbdkit` (users), `mbdkit.plugin` with its modules
(authors of plugins), `mbdkit.kernels` (authors of machine code), `mbdkit.testing` and `mbdkit_gym`.

A name is promised because somebody outside needs it: ``python -m tests.public_door --reasons`` prints who uses each.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from mbdkit.base.lazy_names import homes_of
from tests.first_party import PACKAGES, ROOT

_CORE = PACKAGES["mbdkit"]
FACES = {"mbdkit": _CORE / "__init__.py", "mbdkit.kernels": _CORE / "kernels.py"} | {
    ".".join(("mbdkit", "plugin", *([] if path.stem == "__init__" else [path.stem]))): path
    for path in (_CORE / "plugin").glob("*.py")
}
"""The doors whose names are written in the core, by module."""

GUESTS = ("mbdkit_gym", "mbdkit_identify", "mbdkit_transmissions", "mbdkit_wearable")
"""Parts that import the public doors only, as the plugins of others do."""

KIT = PACKAGES.get("mbdkit_testing", Path()) / "__init__.py"
GYM = PACKAGES.get("mbdkit_gym", Path()) / "__init__.py"


def entries() -> list[tuple[str, str, str]]:
    """Return door, name and home module of each public name."""
    faces = FACES | ({"mbdkit.testing": KIT} if KIT.exists() else {})
    names = [(face, name, home) for face, file in faces.items() for name, home in homes_of(file).items()]
    exported = _tree(GYM).body if GYM.exists() else []
    aliases = [(node, name) for node in exported if isinstance(node, ast.ImportFrom) for name in node.names]
    return sorted([*names, *(("mbdkit_gym", name.name, str(node.module)) for node, name in aliases if name.asname)])


@cache
def reasons() -> dict[tuple[str, str], list[str]]:
    """Return who uses each name of a door: distributions of their own, guests, templates, README and the guide."""
    public = {(face, name) for face, name, _ in entries()}
    faces = "|".join(sorted({face for face, _ in public}, reverse=True))  # the longer ones first
    users: dict[tuple[str, str], set[str]] = {entry: set() for entry in public}
    for user, text in _texts():
        text = re.sub(r"(?<![\w.])plugin\.", "mbdkit.plugin.", text)  # of `from mbdkit import plugin`
        for module, names in re.findall(r"from ([\w.]+) import (\([^)]*\)|.*)", text):
            for entry in {(module, name) for name in re.findall(r"\w+", names)} & public:
                users[entry].add(user)
        for entry in set(re.findall(rf"\b({faces})[.:](\w+)", text)) & public:
            users[entry].add(user)
        if user.endswith(".md"):  # a page also names what it explains, as `name` or in its code
            words = set(re.findall(r"`(\w+)\b", text)) | set(re.findall(r"^    .*?\b([A-Z]\w+)\(", text, re.M))
            for entry in public:
                if entry[1] in words and entry[0] not in ("mbdkit", "mbdkit_gym"):
                    users[entry].add(user)
    return {entry: sorted(names) for entry, names in sorted(users.items())}


def _texts() -> Iterator[tuple[str, str]]:
    """Yield the users of doors, with the text of each of their files."""
    for project in (ROOT / "plugins").glob("*/pyproject.toml"):
        yield from ((project.parent.name, file.read_text("utf-8")) for file in project.parent.glob("src/**/*.py"))
    for guest in GUESTS:
        yield from ((guest, file.read_text("utf-8")) for file in PACKAGES.get(guest, Path("absent")).rglob("*.py"))
    templates = ROOT.glob("plugins/mbdkit-testing/src/mbdkit_testing/scaffold/templates/*.jinja")
    pages = [*ROOT.glob("mbdkit/guide/*.md"), *ROOT.glob("plugins/**/*.md"), ROOT / "README.md"]
    yield from ((f"template {file.name}", file.read_text("utf-8")) for file in templates)
    yield from ((file.name, file.read_text("utf-8")) for file in pages)


def lines() -> Iterator[str]:
    """Yield a line per public name, and one per public attribute of a class."""
    for face, name, home in entries():
        definition = _definition(home, name)
        yield f"{face}.{name}{_described(definition)}"
        if isinstance(definition, ast.ClassDef):
            yield from sorted({f"    {line}" for line in _members(definition, home)})


def _members(definition: ast.ClassDef, module: str) -> Iterator[str]:
    """Yield the members of a class, with those of its bases that are on no door."""
    public = {name for _, name, _ in entries()}
    for base in definition.bases:
        inherited = _definition(module, base.id) if isinstance(base, ast.Name) and base.id not in public else None
        if isinstance(inherited, ast.ClassDef):
            yield from _members(inherited, module)
    for node in definition.body:
        if isinstance(node, ast.FunctionDef) and (node.name == "__init__" or not node.name.startswith("_")):
            yield f"{node.name}{_described(node)}"
        elif isinstance(node, ast.AnnAssign) and not ast.unparse(node.target).startswith("_"):
            default = " = ..." if node.value else ""
            yield f"{ast.unparse(node.target)}: {ast.unparse(node.annotation)}{default}"


def _described(node: ast.AST | None) -> str:
    if isinstance(node, ast.FunctionDef):
        decorators = [ast.unparse(one) for one in node.decorator_list]
        if any(one in ("property", "cached_property", "functools.cached_property") for one in decorators):
            return f" -> {ast.unparse(node.returns) if node.returns else 'Any'}"
        return f"({ast.unparse(node.args)}) -> {ast.unparse(node.returns) if node.returns else 'Any'}"
    if isinstance(node, ast.ClassDef):
        bases = ", ".join(map(ast.unparse, node.bases))
        return f": class({bases})" if bases else ": class"
    if isinstance(node, ast.AnnAssign):
        return f": {ast.unparse(node.annotation)}"
    return ": module" if isinstance(node, ast.Module) else ""


def _definition(module: str, name: str) -> ast.AST | None:
    """Return where a name is defined, also if its module imports it from another one."""
    file = _file_of(module)
    if file is None:
        return None
    for node in _statements(_tree(file).body):
        if (isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name) or _assigns(node, name):
            return node
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                if (alias.asname or alias.name) == name and (node.module, alias.name) != (module, name):
                    return _definition(str(node.module), alias.name)
    inner = _file_of(f"{module}.{name}")
    return _tree(inner) if inner else None


def _statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Yield statements, and those of the blocks for type checkers, without those of functions and classes."""
    for node in body:
        yield node
        if isinstance(node, ast.If):
            yield from _statements(node.body)


def _assigns(node: ast.AST, name: str) -> bool:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return any(isinstance(target, ast.Name) and target.id == name for target in targets)


def _file_of(module: str) -> Path | None:
    package, _, rest = module.partition(".")
    if package not in PACKAGES:
        return None
    path = PACKAGES[package].joinpath(*rest.split(".")) if rest else PACKAGES[package]
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.exists()), None)


@cache
def _tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


if __name__ == "__main__":
    users = (f"{face}.{name}: {', '.join(names)}" for (face, name), names in reasons().items())
    print(*(users if "--reasons" in sys.argv else lines()), sep="\n")
