"""Names of the core that parts import, from wherever: how many threads hold the rooms of the core.

``python -m tests.core_names`` prints how many names and modules each part uses; ``--names`` prints the names too. The
numbers in ``tests/core_names.txt`` may only fall: a change inside a room should ask few others.
"""

from __future__ import annotations

import ast
import sys
from functools import cache
from pathlib import Path

from mbdkit.base.lazy_names import homes_of
from tests.first_party import PARTS, import_statements
from tests.public_door import FACES

BUDGET = Path(__file__).with_suffix(".txt")


@cache
def core_names() -> dict[str, set[tuple[str, str]]]:
    """Return the names of the core that each part imports, with their home modules."""
    homes = {face: homes_of(file) for face, file in FACES.items()}
    used: dict[str, set[tuple[str, str]]] = {}
    for part, folder in PARTS.items():
        used[part] = {
            (home, alias.name)
            for file in folder.rglob("*.py")
            for node in import_statements(file)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
            if (home := homes.get(str(node.module), {}).get(alias.name, str(node.module))).partition(".")[0] == "mbdkit"
        }
    return used


def counts() -> dict[str, int]:
    """Return how many names each part imports, and how many names and modules all of them import."""
    every = set().union(*core_names().values())
    numbers = {part: len(names) for part, names in core_names().items()}
    return numbers | {"names": len(every), "modules": len({module for module, _ in every})}


if __name__ == "__main__":
    for part, count in counts().items():
        print(part, count)
        if "--names" in sys.argv:
            print(*(f"    {module}.{name}" for module, name in sorted(core_names().get(part, ()))), sep="\n")
