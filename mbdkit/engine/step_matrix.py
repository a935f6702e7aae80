"""The sparse matrix of a step in machine code: terms of mass, damping, stiffness and constraints, and its pivots."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbdkit.engine.elimination_order import empty_pattern, new_factors
from mbdkit.engine.iteration_matrix import chosen_pivots, classes_of
from mbdkit.engine.kernels.equations import MASS
from mbdkit.engine.kernels.lu import Pattern
from mbdkit.engine.kernels.observe import tangents_at
from mbdkit.engine.stored_arrays import pattern_of, stored
from mbdkit.engine.workspace import Workspace


class StepMatrix:
    """The matrix of one mechanism; empty until pivots are chosen.

    Attributes
    ----------
    arrays : dict
        ``pattern``, ``factors``, and ``scatter`` (N, 3): index into ``Scratch.source``, index into the values of the
        matrix, class of the term.
    """

    def __init__(self, workspace: Workspace):
        self._workspace, self._classes = workspace, classes_of(workspace)
        self.arrays: dict[str, Any] = {}
        self._use(empty_pattern(), np.zeros((0, 3), dtype=np.int64))

    def _use(self, pattern: Pattern, scatter: np.ndarray, **sizes: np.ndarray) -> None:
        factors = new_factors(pattern, float)._replace(**sizes)
        self.arrays = {"pattern": pattern, "scatter": scatter, "factors": factors}

    def coupling_terms(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the bodies (N, 2) that each term but those of mass couples, and its index in ``Scratch.source`` (N,).

        Rows of constraints couple the bodies of their columns.
        """
        terms, n, is_coupling = self._workspace.terms, self._workspace.mechanism.size - 3, self._classes != MASS
        sides = [np.where(x < n, x, y) // 3 for x, y in ((terms.row, terms.column), (terms.column, terms.row))]
        columns = np.column_stack(sides)[is_coupling], terms.source[is_coupling]
        bodies, sources = (np.ascontiguousarray(x.astype(np.int64)) for x in columns)
        return bodies, sources

    def evaluate(self, t: float, q: np.ndarray, v: np.ndarray) -> bool:
        """Evaluate all terms without accelerations and multipliers; return whether they are finite.

        Raises mbdkit.engine.elimination_order.SingularSystemError if the equations are singular.
        """
        workspace = self._workspace
        none = np.zeros(workspace.mechanism.size), np.zeros((len(workspace.mechanism.topology.pairs), 2))
        workspace.retry_with_new_pivots(lambda: tangents_at(workspace.stepping_engine, t, q, v, *none))
        return workspace.is_finite()

    def choose_pivots(self, coefficients: np.ndarray) -> None:
        """Choose pivots for the terms last evaluated, with the coefficient (6,) of each class.

        Raises mbdkit.engine.elimination_order.SingularSystemError if the matrix is singular.
        """
        pivots = chosen_pivots(self._workspace, self._classes, coefficients)
        self._use(pivots.pattern, pivots.scatter)

    def stored(self) -> dict[str, object]:
        """Return the pivots as plain values for a checkpoint."""
        pattern, scatter, factors = self.arrays.values()
        return {"pattern": stored(pattern), "scatter": scatter, "reference": factors.reference}

    def restore(self, state: Any) -> None:
        """Use stored pivots; raise ValueError if they are not valid."""
        pattern = pattern_of(state["pattern"], self._workspace.unknowns)
        scatter, reference = np.ascontiguousarray(state["scatter"]), np.array(state["reference"], dtype=float)
        sources = len(self._workspace.scratch.source)
        if (
            scatter.dtype != np.int64
            or scatter.shape[1:] != (3,)
            or np.any(scatter < 0)
            or np.any(scatter >= [sources, max(len(pattern.a_column), 1), 6])
            or reference.shape != pattern.row_of.shape
        ):
            raise ValueError("a term of a matrix does not exist")
        self._use(pattern, scatter, reference=reference)
