"""Items under test, and the check of items of every kind: their functions exist, and are what mbdkit calls."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.base.distributions import MBDKIT
from mbdkit.base.text import listed
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.runs.simulation import simulate
from mbdkit.spec.loading import load_spec
from mbdkit.spec.run_spec import RunSpec, spec_type
from mbdkit_testing.check import STEP_LIMIT, check
from mbdkit_testing.check_result import Result, passed, skipped, warned

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


def short_runs() -> Iterator[tuple[str, Run]]:
    """Yield short runs of packaged examples with their names."""
    for name in EXAMPLES:
        with simulate(load_spec(name, time={"steps": 20, "step": 0.005})) as run:
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
    """The package of the plugin imports only names that are on doors, because all others may change at any time."""
    package = _package(under_test.item)
    spec = find_spec(package) if package else None
    if spec is None or spec.origin is None:
        return skipped("its package has no files")
    folders = spec.submodule_search_locations or []
    files = [file for folder in folders for file in Path(folder).rglob("*.py")] or [Path(spec.origin)]
    ours = {_package(item) for item in under_test.installed.items if item.origin.distribution == MBDKIT}
    trees = {file.name: ast.parse(file.read_text(encoding="utf-8")) for file in files}
    names = {name: file for file, tree in trees.items() for name in _inner_names(tree, ours)}
    if not names:
        return passed(files=len(files))
    told = listed([f"{name} ({file})" for name, file in sorted(names.items())], "and")
    return warned(f"it imports what is on no door and may change at any time: {told}", names=len(names))


def _package(item: Registered) -> str:
    return item.origin.entry_point.partition(" = ")[2].partition(":")[0].partition(".")[0]


def _inner_names(tree: ast.Module, ours: set[str]) -> Iterator[str]:
    """Yield the names that a module imports from packages of mbdkit, `ours`, and that are on no door."""
    for node in ast.walk(tree):
        names: list[tuple[str, str]] = []
        if isinstance(node, ast.Import):
            names = [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [(str(node.module), alias.name) for alias in node.names]
        for module, name in names:
            imported = f"{module}.{name}".strip(".")
            if module.partition(".")[0] not in ours or _DOOR.fullmatch(imported):
                continue
            if not _DOOR.fullmatch(module) or name not in dir(importlib.import_module(module)):
                yield imported


CHECKS = (functions,)
