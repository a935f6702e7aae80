"""What files of tests import."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from tests.first_party import ROOT, import_statements


@cache
def imported_names(path: Path) -> tuple[str, ...]:
    """Return the modules that a file of tests imports, by their whole names."""
    folders = path.relative_to(ROOT).parts[:-1]
    package = folders[folders.index("tests") :]
    named = []
    for node in import_statements(path):
        if isinstance(node, ast.Import):
            named += [alias.name for alias in node.names]
        else:
            above = package[: len(package) + 1 - node.level] if node.level else ()
            named.append(".".join((*above, *filter(None, [node.module]))))
    return tuple(named)
