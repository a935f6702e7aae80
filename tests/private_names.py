"""Names of the core that no door has, and that parts import all the same.

``python -m tests.private_names`` prints them. ``tests/private_names.txt`` has how many each part may import; a test
lets these numbers fall only.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import mbdkit
from mbdkit.base.lazy_names import homes_of
from tests.first_party import PARTS, import_statements

BUDGET = Path(__file__).with_suffix(".txt")
_CORE = Path(mbdkit.__file__).parent
FACES = {"mbdkit": _CORE / "__init__.py", "mbdkit.kernels": _CORE / "kernels.py"} | {
    ".".join(("mbdkit", "plugin", *([] if path.stem == "__init__" else [path.stem]))): path
    for path in (_CORE / "plugin").glob("*.py")
}
"""The doors and the face for users, by module."""


def inner_imports(file: Path) -> Iterator[tuple[str, str]]:
    """Yield the modules and names that a file imports from inner rooms of the core."""
    for node in import_statements(file):
        if isinstance(node, ast.ImportFrom):
            imports = [(str(node.module), alias.name) for alias in node.names]
        else:
            imports = [(alias.name, "*") for alias in node.names]
        for module, name in imports:
            if module.partition(".")[0] == "mbdkit" and module not in FACES and module != "mbdkit.testing":
                yield module, name


@cache
def private_names() -> dict[str, dict[str, set[str]]]:
    """Return the names that each part imports from inner rooms, by part and module."""
    found: dict[str, dict[str, set[str]]] = {part: defaultdict(set) for part in PARTS}
    for part, folder in PARTS.items():
        for file in folder.rglob("*.py"):
            for module, name in inner_imports(file):
                found[part][module].add(name)
    return found


@cache
def public_names() -> dict[tuple[str, str], list[str]]:
    """Return the doors of each name that has one, by module and name."""
    found: dict[tuple[str, str], list[str]] = defaultdict(list)
    for face, file in FACES.items():
        for name, module in homes_of(file).items():
            found[module, name].append(face)
    return found


def counts() -> dict[str, int]:
    """Return how many names each part imports from inner rooms."""
    return {part: sum(map(len, names.values())) for part, names in private_names().items()}


if __name__ == "__main__":
    for part, names in private_names().items():
        print(f"{part}: {sum(map(len, names.values()))}")
        for module in sorted(names):
            print(f"    {module}: {' '.join(sorted(names[module]))}")
