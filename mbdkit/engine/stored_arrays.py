"""Conversion of bundles, pivots and solvers to the plain values of a checkpoint, and back.

Kernels use patterns and counts as indices without checking bounds. Values read from a file are therefore checked first:
an invalid pattern raises ValueError.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.engine.elimination_order import new_factors
from mbdkit.engine.kernels.engine_bundles import Scatter, Solver
from mbdkit.engine.kernels.lu import Factors, Pattern

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace

#: Parts of a solver that change during a run; all others are constant or scratch arrays.
_PIVOTED = ("pivoted", "pattern", "factors", "scatter")


def stored(bundle: Any) -> dict[str, object]:
    """Return the arrays of a bundle by name, nested as in the bundle; they are not copied."""
    return {name: stored(value) if isinstance(value, tuple) else value for name, value in bundle._asdict().items()}


def restore(arrays: Mapping[str, np.ndarray], state: object) -> None:
    """Copy stored values into arrays by name; raise ValueError if names, shapes or types differ, or an integer is
    negative.
    """
    if not isinstance(state, Mapping) or state.keys() != arrays.keys():
        raise ValueError("it has other arrays")
    for name, array in arrays.items():
        fill(array, state[name])


def fill(array: np.ndarray, values: object) -> None:
    """Copy stored values into an array; raise ValueError if shape or type differ, or an integer is negative."""
    if not isinstance(values, np.ndarray) or values.shape != array.shape or values.dtype != array.dtype:
        raise ValueError("an array has another shape or type")
    if values.dtype == np.int64 and np.any(values < 0):
        raise ValueError("a count is negative")
    array[...] = values


def pattern_of(state: object, unknowns: int) -> Pattern:
    """Return the stored pattern of a matrix with `unknowns` rows, or the empty one; raise ValueError if it is
    invalid.
    """
    pattern = Pattern(**{name: _vector(state, name) for name in Pattern._fields})
    if not len(pattern.row_of):
        unknowns = 0
    for part in "alu":
        start, column = getattr(pattern, f"{part}_start"), getattr(pattern, f"{part}_column")
        if len(start) != unknowns + 1 or start[0] != 0 or start[-1] != len(column) or np.any(np.diff(start) < 0):
            raise ValueError("the rows of a pattern are invalid")
        if np.any(column < 0) or np.any(column >= unknowns):
            raise ValueError("a pattern has columns that do not exist")
    for order in (pattern.row_of, pattern.column_of):
        if not np.array_equal(np.sort(order), np.arange(unknowns)):
            raise ValueError("pivots are not a permutation")
    scales = len(pattern.row_scale), len(pattern.column_scale), len(pattern.weight)
    if scales != (unknowns, unknowns, len(pattern.a_column)):
        raise ValueError("the scales of a pattern are invalid")
    return pattern


_INTEGERS = frozenset(Pattern._fields) - {"row_scale", "column_scale", "weight"}


def _vector(state: object, name: str) -> np.ndarray:
    values = state.get(name) if isinstance(state, Mapping) else None
    kind = np.int64 if name in _INTEGERS else np.float64
    if not isinstance(values, np.ndarray) or values.ndim != 1 or values.dtype != kind:
        raise ValueError(f"the array {name} of a sparsity pattern is missing, or is not a vector of {np.dtype(kind)}")
    return values


def scatter_of(state: object, sources: int, places: int) -> Scatter:
    """Return stored lists that map `sources` terms to `places` entries; raise ValueError if they are invalid."""
    if not isinstance(state, Mapping) or state.keys() != set(Scatter._fields):
        raise ValueError("a matrix has other terms")
    for pairs in state.values():
        if not isinstance(pairs, np.ndarray) or pairs.dtype != np.int64 or pairs.ndim != 2:
            raise ValueError("the terms of a matrix are not pairs")
        if not pairs.size:
            continue
        if pairs.shape[1] != 2 or np.any(pairs < 0) or np.any(pairs >= [sources, places]):
            raise ValueError("a term of a matrix does not exist")
    return Scatter(**state)


def stored_solver(solver: Solver) -> dict[str, object]:
    """Return the parts of a solver that change during a run."""
    return {name: stored(solver)[name] for name in _PIVOTED}


def solver_of(workspace: Workspace, state: object) -> Solver:
    """Return the solver of a workspace with stored pivots and factors; raise ValueError if they are invalid."""
    if not isinstance(state, Mapping) or state.keys() != set(_PIVOTED):
        raise ValueError("a solver has other parts")
    pattern = pattern_of(state["pattern"], workspace.unknowns)
    scatter = scatter_of(state["scatter"], len(workspace.scratch.source), len(pattern.a_column))
    factors: Factors = new_factors(pattern, np.float64)
    restore(factors._asdict(), state["factors"])
    pivoted = np.zeros(1, np.int64)
    fill(pivoted, state["pivoted"])
    if pivoted[0] < workspace.mechanism.needs_pivots:
        raise ValueError("this mechanism needs pivots")
    return workspace.solver._replace(pivoted=pivoted, pattern=pattern, factors=factors, scatter=scatter)


def restore_solver(workspace: Workspace, state: object) -> None:
    """Let a workspace use stored pivots and factors; raise ValueError if they are invalid."""
    now = stored_solver(workspace.solver)
    if isinstance(state, Mapping) and all(
        _is_same(now[part], state.get(part)) for part in ("pivoted", "pattern", "scatter")
    ):
        restore(workspace.solver.factors._asdict(), state["factors"])
    else:
        workspace.use_solver(solver_of(workspace, state))


def _is_same(one: object, other: object) -> bool:
    if isinstance(one, Mapping):
        return (
            isinstance(other, Mapping) and one.keys() == other.keys() and all(_is_same(one[k], other[k]) for k in one)
        )
    return isinstance(one, np.ndarray) and isinstance(other, np.ndarray) and np.array_equal(one, other)
