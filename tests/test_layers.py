"""The import graph of the packages has no cycle, lazy and type-only imports included."""

from __future__ import annotations

import ast
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from mbdkit.base.parts import OWN_PACKAGES
from mbdkit.cli import QUIET
from tests.first_party import PACKAGES, PARTS, ROOT, import_statements, modules
from tests.imports import imported_names

pytestmark = pytest.mark.end_to_end  # of the sources alone


def imported(path: Path, known: dict[str, Path]) -> set[str]:
    found: set[str] = set()
    for node in import_statements(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        else:
            assert not node.level, f"{path}: relative import"
            submodules = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in known else str(node.module) for name in submodules}
    return found & set(known)


def test_no_file_imports_itself_through_others() -> None:
    known = modules()
    graph = {name: imported(path, known) - {name} for name, path in known.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        raise AssertionError(f"circular import: {' <- '.join(error.args[1])}") from None


def test_commands_show_no_warnings_about_lines_of_our_own_code_and_those_of_other_plugins():
    assert set(OWN_PACKAGES) == set(PACKAGES)
    assert all(re.match(QUIET, f"{package}.module") for package in PACKAGES)
    assert not any(re.match(QUIET, other) for other in ("mbdkit_rocket", "mbdkit_reports", "numpydoc"))


def test_no_test_imports_a_module_of_tests() -> None:
    """Helpers stand in modules of their own, so that tests can be deleted and moved."""
    files = [*(ROOT / "tests").rglob("*.py"), *(ROOT / "plugins").glob("*/tests/**/*.py")]
    wrong = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in files
        for name in imported_names(path)
        if name.startswith("tests.") and name.rpartition(".")[2].startswith("test_")
    ]
    assert wrong == []


COMPARED = ("benchmarks", "campaign")
"""Folders that compare and attack the whole distribution."""


def test_tests_of_the_core_import_no_part() -> None:
    """They use what parts offer through `mbdkit`, `mbdkit.testing` and commands, as users do."""
    files = [path for path in (ROOT / "tests").rglob("*.py") if not set(COMPARED) & set(path.parts)]
    wrong = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in files
        for name in imported_names(path)
        if name.partition(".")[0] in PARTS
    ]
    assert wrong == []
