"""Names that parts take from the inner modules of other parts.

A part may have a door, its package: what others import from there is not counted. ``python -m
tests.names_between_parts`` prints how many names each part takes from each other part, as in
``tests/names_between_parts.txt``, whose numbers may only fall; ``--names`` prints the names.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

from tests.first_party import PARTS, import_statements

BUDGET = Path(__file__).with_suffix(".txt")


def names_between() -> dict[str, set[str]]:
    """Return the names by importing and imported part, such as ``mbdkit_design mbdkit_studies``."""
    names: dict[str, set[str]] = {}
    for part, folder in PARTS.items():
        for file in folder.rglob("*.py"):
            for node in import_statements(file):
                if not isinstance(node, ast.ImportFrom) or "." not in str(node.module):
                    continue
                other = str(node.module).partition(".")[0]
                if other in PARTS and other != part:
                    names.setdefault(f"{part} {other}", set()).update(f"{node.module}.{a.name}" for a in node.names)
    return names


if __name__ == "__main__":
    for pair, taken in sorted(names_between().items()):
        print(pair, len(taken))
        if "--names" in sys.argv:
            print(*(f"    {name}" for name in sorted(taken)), sep="\n")
