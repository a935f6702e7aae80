"""Names of the core that parts import, from wherever, or take from its modules: how many threads hold the rooms of the
core.

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

ROOT = Path(__file__).parents[1]
BUDGET = Path(__file__).with_suffix(".txt")


@cache
def core_names() -> dict[str, set[tuple[str, str]]]:
    """Return the names of the core that each part imports, with their home modules; of modules what is taken from
    them.
    """
    homes = {face: homes_of(file) for face, file in FACES.items()}
    used: dict[str, set[tuple[str, str]]] = {}
    for part, folder in PARTS.items():
        used[part] = set()
        for file in folder.rglob("*.py"):
            modules: dict[str, str] = {}  # by the names that they have in this file
            for node in import_statements(file):
                if not isinstance(node, ast.ImportFrom):
                    continue
                for alias in node.names:
                    home = homes.get(str(node.module), {}).get(alias.name, str(node.module))
                    if home.partition(".")[0] != "mbdkit":
                        continue
                    if _is_module(f"{home}.{alias.name}"):
                        modules[alias.asname or alias.name] = f"{home}.{alias.name}"
                    else:
                        used[part].add((home, alias.name))
            for taken in ast.walk(ast.parse(file.read_text("utf-8"))) if modules else ():
                if isinstance(taken, ast.Attribute) and isinstance(taken.value, ast.Name) and taken.value.id in modules:
                    used[part].add((modules[taken.value.id], taken.attr))
    return used


def _is_module(name: str) -> bool:
    path = ROOT.joinpath(*name.split("."))
    return path.with_suffix(".py").is_file() or path.is_dir()


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
