"""Items under test, and the check of items of every kind: their functions exist, and are what mbdkit calls."""

from __future__ import annotations

import ast
import importlib
import os
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.base.distributions import MBDKIT, code_of_distribution, code_of_module, normalized_name, required_by
from mbdkit.base.text import listed
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.runs.method_evidence import code_of
from mbdkit.runs.simulation import simulate
from mbdkit.spec.loading import load_spec
from mbdkit.spec.run_spec import RunSpec, spec_type
from mbdkit_testing.check import STEP_LIMIT, check
from mbdkit_testing.check_result import Result, failed, passed, skipped, warned

#: Modules whose names plugins may import.
_DOOR = re.compile(r"mbdkit(\.(plugin(\.\w+)?|kernels|testing))?|mbdkit_\w+(\.seams)?")

#: Packaged examples of which short runs are made.
EXAMPLES = ("double-pendulum", "knee", "slider-crank")


AnyItem = TypeVar("AnyItem")


@dataclass
class ItemUnderTest(Generic[AnyItem]):
    """An item of any kind under test.

    Parameters
    ----------
    item
        The item in the registry.
    options
        Its options, as in a spec; empty if it has none.
    installed
        The registry of installed plugins, in which the item is looked up by name.
    """

    item: Registered
    options: dict[str, Any]
    installed: Registry

    @property
    def plugin(self) -> AnyItem:
        """The item as its plugin declares it."""
        return cast(AnyItem, self.item.plugin)

    @property
    def claims(self) -> Any:
        """Claims of the item by name."""
        return {}

    @cached_property
    def spec_type(self) -> type[RunSpec]:
        """The class of run specs that accept this item."""
        return spec_type(self.installed)

    def run_spec(self, model: object, integrator: object, time: object, **sections: object) -> RunSpec:
        """Return the spec of a run, with a limited number of steps."""
        given = {"model": model, "integrator": integrator, "time": time, "limits": {"max_steps": STEP_LIMIT}}
        return self.spec_type(mbdkit=1, **given | sections)


def digest_in_new_process(spec: RunSpec) -> str:
    """Return the hash of the data of a run in a new process; empty if its plugins are not installed, but in memory."""
    code = "import json, mbdkit, sys; print(mbdkit.run(mbdkit.load_spec(json.load(sys.stdin))).data_sha256)"
    words, text = [sys.executable, "-c", code], spec.canonical_json()
    path = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run(words, input=text, env=path, capture_output=True, text=True, check=False).stdout.strip()


def short_runs(every: int = 1) -> Iterator[tuple[str, Run]]:
    """Yield short runs of packaged examples with their names, and with a row after `every` steps."""
    for name in EXAMPLES:
        with simulate(load_spec(name, time={"steps": 20, "step": 0.005}, output={"every": every})) as run:
            yield name, run


def relative_difference(exact: np.ndarray, other: np.ndarray) -> float:
    """Return the largest difference, relative to the largest exact value if this exceeds 1."""
    return float(np.max(np.abs(exact - other)) / max(1.0, float(np.max(np.abs(exact)))))


@check("contract.functions")
def functions(under_test: ItemUnderTest[Any]) -> Result:
    """Every function that the item names exists, is decorated, and takes and returns what its decorator declares."""
    under_test.plugin.check_targets()
    return passed(functions=len(under_test.plugin.targets()))


@check("contract.imports")
def imports(under_test: ItemUnderTest[Any]) -> Result:
    """The distribution of the plugin imports only itself, what it requires, and names of mbdkit that are on doors,
    because all others may change at any time. Imports by `importlib` are not looked at.
    """
    origin = under_test.item.origin
    roots = {code_of(origin), *code_of_distribution(origin.distribution)} - {Path()}  # of an item without entry point
    files = [file for root in roots for file in (root.rglob("*.py") if root.is_dir() else [root]) if file.is_file()]
    if not files:
        return skipped("its package has no files")
    ours = {_package(item) for item in under_test.installed.items if item.origin.distribution == MBDKIT}
    trees = {file.name: ast.parse(file.read_text(encoding="utf-8")) for file in files}
    known = {*ours, *sys.stdlib_module_names, *(root.stem for root in roots), _package(under_test.item)}
    required, new = set[str](), {normalized_name(origin.distribution), MBDKIT}
    while new:
        required, new = required | new, required_by(*new, extras=True) - required - new
    outside = {
        f"{top} ({file})"
        for file, tree in trees.items()
        for top in {module.partition(".")[0] for module, _ in _imported(tree)} - known
        if (code := code_of_module(top)) and not _is_in(code, sorted(required, key=normalized_name(top).__ne__))
    }
    if outside:
        told = listed(sorted(outside), "and")
        return failed(f"it imports what belongs neither to its distribution nor to what that requires: {told}")
    names = {name: file for file, tree in trees.items() for name in _inner_names(tree, ours)}
    if not names:
        return passed(files=len(files))
    told = listed([f"{name} ({file})" for name, file in sorted(names.items())], "and")
    return warned(f"it imports what is on no door and may change at any time: {told}", names=len(names))


def _is_in(code: set[Path], distributions: Iterable[str]) -> bool:
    return any(code & code_of_distribution(name) for name in distributions)


def _package(item: Registered) -> str:
    return item.origin.entry_point.partition(" = ")[2].partition(":")[0].partition(".")[0]


def _inner_names(tree: ast.Module, ours: set[str]) -> Iterator[str]:
    """Yield the names that a module imports from packages of mbdkit, `ours`, and that are on no door."""
    for module, name in _imported(tree):
        imported = f"{module}.{name}".strip(".")
        if module.partition(".")[0] not in ours or _DOOR.fullmatch(imported):
            continue
        if not _DOOR.fullmatch(module) or name not in dir(importlib.import_module(module)):
            yield imported


def _imported(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Yield the modules that a module imports, without relative ones, and the names that it takes from them."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield from ((str(node.module), alias.name) for alias in node.names)


CHECKS = (functions,)
