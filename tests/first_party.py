"""The packages of the distribution: the core, and the parts below plugins/ that have no pyproject.toml of their own."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PARTS = {
    folder.name.replace("-", "_"): folder / "src" / folder.name.replace("-", "_")
    for folder in sorted((ROOT / "plugins").glob("mbdkit-*"))
    if not (folder / "pyproject.toml").exists()
}
"""Source folder of each part by the name of its package."""

PACKAGES = {"mbdkit": ROOT / "mbdkit", **PARTS}
"""Source folder of each package by its name."""

MAPS = {
    name: (folder / "README.md", *sorted(folder.glob("*/README.md")))
    if name == "mbdkit"
    else (folder.parents[1] / "README.md",)
    for name, folder in PACKAGES.items()
}
"""Maps of the code of each package by its name: of the core, one for each room."""


def modules() -> dict[str, Path]:
    """Return the files of all packages by the names of their modules."""
    files = {}
    for package, folder in PACKAGES.items():
        for path in sorted(folder.rglob("*.py")):
            name = ".".join((package, *path.relative_to(folder).with_suffix("").parts))
            files[name.removesuffix(".__init__")] = path
    return files


@cache
def import_statements(path: Path) -> tuple[ast.Import | ast.ImportFrom, ...]:
    """Return all imports of a file, also those inside of functions."""
    found: list[ast.Import | ast.ImportFrom] = []
    _collect_imports(ast.parse(path.read_text(encoding="utf-8")).body, found)
    return tuple(found)


def _collect_imports(statements: list[Any], found: list[ast.Import | ast.ImportFrom]) -> None:
    """Add the imports among statements and inside of them; `ast.walk` visits all expressions as well."""
    for node in statements:
        if isinstance(node, ast.Import | ast.ImportFrom):
            found.append(node)
        for field in ("body", "orelse", "handlers", "finalbody", "cases"):
            if isinstance(inner := getattr(node, field, None), list):
                _collect_imports(inner, found)
