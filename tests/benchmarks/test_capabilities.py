"""The page on capabilities: all methods of the core are in it, and cells of it are still true."""

from __future__ import annotations

import re

import numpy as np
import pytest

from mbdkit.registry.manager import built_in
from tests.benchmarks import capabilities
from tests.benchmarks.capabilities import ATTEMPTS, PAGE, Member, reference, tried

TEXT = PAGE.read_text(encoding="utf-8").partition(capabilities.MARK)[2]
REASONS = dict(re.findall(r"^(\d+)\. (.+)$", TEXT, flags=re.MULTILINE))
ROWS = [[cell.strip() for cell in line.split("|")[1:-1]] for line in TEXT.splitlines() if line.startswith("| ")]


def stored(method: str) -> dict[str, str]:
    """Return what the page says about a method, as `tried` returns it."""
    cells: dict[str, str] = {}
    for row in ROWS:
        if row[0] == "methods":
            names = row[1:]
        elif method in row[0].split(", "):
            cells |= dict(zip(names, (REASONS.get(cell.partition(" ")[2], cell) for cell in row[1:]), strict=True))
    return cells


def test_all_methods_of_the_core_are_in_all_tables_and_no_result_is_wrong() -> None:
    for item in built_in().of_kind("integrator"):
        assert list(stored(item.name)) == list(ATTEMPTS)
    assert not [reason for reason in REASONS.values() if reason.startswith("wrong")]


@pytest.mark.parametrize("method", ["rk4", "rattle", "scipy-dop853"])
@pytest.mark.parametrize("capability", ["states", "events", "`interval`", "resumption"])
def test_cells_are_still_true(method: str, capability: str) -> None:
    assert tried(Member(method, method), capability) == stored(method)[capability]


def test_a_wrong_result_is_not_a_yes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reference is moved by a millionth, which is far above the errors of a method of order 4."""

    def moved(asked: str) -> list[np.ndarray]:
        return [one + 1e-6 * np.maximum(1, abs(one)) for one in reference(asked)]

    monkeypatch.setattr(capabilities, "reference", moved)
    assert tried(Member("rk4", "rk4"), "states").startswith("wrong: errors are")
