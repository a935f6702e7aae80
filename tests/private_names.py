"""Writes tests/private_names.txt: which names of the core, other than those of `mbdkit.plugin`, each part imports.

Run ``python -m tests.private_names`` after a part has got rid of a name, or has a good reason for another one.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from tests.first_party import PARTS

LIST = Path(__file__).with_suffix(".txt")
_PUBLIC = ("mbdkit", "mbdkit.plugin", "mbdkit.testing")


def private_imports(file: Path) -> Iterator[tuple[str, str]]:
    """Yield the modules and names that a file imports from the core, apart from those for plugins."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            imports = [(str(node.module), alias.name) for alias in node.names]
        elif isinstance(node, ast.Import):
            imports = [(alias.name, "*") for alias in node.names]
        else:
            continue
        yield from (
            (module, name) for module, name in imports if module.partition(".")[0] == "mbdkit" and module not in _PUBLIC
        )


def listing() -> str:
    """Return the list: for each part its modules of the core, each with the names imported from it."""
    lines = []
    for part, folder in PARTS.items():
        names = defaultdict(set)
        for file in folder.rglob("*.py"):
            for module, name in private_imports(file):
                names[module].add(name)
        lines += [f"{part}: {sum(map(len, names.values()))} names of {len(names)} modules"]
        lines += [f"    {module}: {' '.join(sorted(names[module]))}" for module in sorted(names)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    LIST.write_text(listing(), encoding="utf-8")
