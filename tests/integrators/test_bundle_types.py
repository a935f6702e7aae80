"""Kernels are compiled for the types of example bundles; the bundles of runs have exactly these types."""

from __future__ import annotations

import ast
import importlib
import pkgutil
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import integrators
from mbdkit.engine import kernels
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.native.bundle import LOADERS, PinnedBundle
from mbdkit.expressions import operations
from mbdkit.runs.preparation import build
from mbdkit.runs.simulation_batch import SimulationBatch
from mbdkit.spec import load_spec

COMPILED = {"subkernel", "inlined", "kernel", "entry", "law_function"}
"""Decorators of functions that are compiled."""

RUNS: dict[str, dict[str, Any]] = {
    "rk4": {"integrator": {"name": "rk4"}},
    "dopri5, adaptive": {"integrator": {"name": "dopri5", "adaptive": True}},
    "gauss": {"integrator": {"name": "gauss", "stages": 3}},
    "gauss, one stage": {"integrator": {"name": "gauss", "stages": 1}},
    "gauss, adaptive": {"integrator": {"name": "gauss", "adaptive": True}},
    "gauss, fixed-point": {"integrator": {"name": "gauss", "stage_solver": "fixed-point"}},
    "gauss, projected": {"integrator": {"name": "gauss"}, "stabilization": {"name": "projection"}},
    "radau-iia, index-3": {"integrator": {"name": "radau-iia"}, "formulation": "index-3"},
    "radau-iia, ggl": {"integrator": {"name": "radau-iia"}, "formulation": "ggl"},
    "lobatto-pair": {"integrator": {"name": "lobatto-pair"}, "formulation": "index-3"},
    "rk4, an event": {"integrator": {"name": "rk4"}, "events": {"middle": {"when": "t - 0.012"}}},
    "steps taken in Python": {"integrator": {"name": "scipy-dop853"}, "formulation": "index-1"},
}


def types_of(bundle: Any) -> tuple[Any, ...]:
    """Return class, dtype and number of dimensions of every array of a bundle, in its order."""
    return tuple(types_of(x) if isinstance(x, tuple) else (type(x), x.dtype, x.ndim) for x in bundle)


def expected_types() -> dict[str, set[Any]]:
    """Return the types for which the loaders of bundles are compiled, by the class of the bundle."""
    expected = defaultdict(set)
    for room in (kernels, integrators):
        for info in pkgutil.iter_modules(room.__path__, f"{room.__name__}."):
            importlib.import_module(info.name)
    for _, make in LOADERS:
        if not make.__module__.startswith(("mbdkit.", "mbdkit_taylor.")):  # of a plugin that another test has loaded
            continue
        example = make()
        expected[type(example).__name__].add(types_of(example))
    return dict(expected)


@pytest.fixture
def pinned(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Bundles whose addresses have been given to kernels."""
    seen: list[Any] = []
    replace = PinnedBundle.replace

    def noting(self: PinnedBundle, bundle: Any) -> None:
        seen.append(bundle)
        replace(self, bundle)

    monkeypatch.setattr(PinnedBundle, "replace", noting)
    return seen


def test_bundles_of_runs_have_the_types_that_kernels_are_compiled_for(pinned: list[Any]) -> None:
    for example in ("double-pendulum", "double-wishbone"):
        for sections in RUNS.values():
            mbdkit.run(example, **{"events": {}, "time": {"end": 0.02, "step": 0.01}} | sections).check()
        workspace, _ = build(load_spec(example))
        equations = EquationsOfMotion(workspace)
        a, lam = equations.accelerations(equations.t0, equations.q0, equations.v0)
        for mass in (1.0, 1.0 + 0.0j):
            equations.iteration_matrix(equations.t0, equations.q0, equations.v0, a, lam, mass=mass).solve(a, lam)
        for integrator in ({"name": "rk4"}, {"name": "gauss"}, {"name": "dop853", "adaptive": True}):
            in_lanes = load_spec(example, (), integrator=integrator, time={"end": 0.02, "step": 0.01}, events={})
            assert mbdkit.ensemble(in_lanes, {"time.step": [0.01]}, store="hashes").status == "complete"
        for integrator in ({"name": "rk4"}, {"name": "gauss", "stages": 2}):
            short = {"integrator": integrator, "time": {"end": 0.02, "step": 0.01}, "events": {}}
            mbdkit.gradient(example, "final(energy.kinetic)", "model.gravity.1", check=False, **short)
        workspace.use_pivots()
    for name in ("taylor", "gauss"):
        joint: dict[str, Any] = {"integrator": {"name": name}, "formulation": "joint-coordinates"}
        mbdkit.run("double-pendulum", **joint, events={}, time={"end": 0.02, "step": 0.01}).check()
    mbdkit.open("double-pendulum").read(["energy.total"])
    fixed: dict[str, Any] = {"integrator": {"name": "rk4"}, "events": {}, "time": {"end": 0.02, "step": 0.01}}
    SimulationBatch(load_spec("double-pendulum", (), **fixed), 2).close()
    expected = expected_types()
    assert {type(bundle).__name__ for bundle in pinned} == set(expected)
    for bundle in pinned:
        assert types_of(bundle) in expected[type(bundle).__name__], type(bundle).__name__


def test_an_array_whose_size_is_not_the_declared_one_is_refused() -> None:
    """Compiled code takes declared sizes for granted; with another one, it would read and write other elements."""
    workspace, _ = build(load_spec("double-pendulum"))
    with pytest.raises(TypeError, match=r"an array of Topology has shape \(3, 4\); axis 1 must have 3"):
        PinnedBundle(workspace.mechanism.topology._replace(mass=np.ones((3, 4))))


def test_kernels_have_no_indices_from_the_end() -> None:
    """Compiled code does not check whether an index is negative; see `mbdkit_builder.indices`."""
    rooms = [Path(room.__path__[0]) for room in (kernels, integrators)]
    files = [*(file for room in rooms for file in room.glob("*.py")), Path(str(operations.__file__))]
    found = []
    for file in files:
        for function in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(function, ast.FunctionDef) and COMPILED & {
                ast.unparse(one) for one in function.decorator_list
            }:
                found += [
                    f"{file.name}: {ast.unparse(node)}"
                    for node in ast.walk(function)
                    if isinstance(node, ast.Subscript)
                    for index in (node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice])
                    if isinstance(index, ast.UnaryOp) and isinstance(index.op, ast.USub)
                ]
    assert found == []
