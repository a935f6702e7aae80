"""Which joints are to blame where the equations have no unique solution at the start."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.analysis import SingularSystemError
from mbdkit.engine.observe import constraints_at, tangents_at
from mbdkit.engine.problem import Problem
from mbdkit.engine.system import OK
from mbdkit.errors import SpecError

MOST_ROWS = 3000
"""Constraint rows up to which the dependent ones are looked for; it takes a dense factorization."""

RANK_TOLERANCE = 1e-10
"""Pivots below this, relative to the largest, count as zero."""


def dependent_joints(problem: Problem) -> list[str]:
    """Return the joints whose rows of the constraint Jacobian follow from those of the joints before them.

    Parameters
    ----------
    problem
        The mechanism at its start.

    Returns
    -------
    list of str
        Names in the order of the mechanism; empty where all rows are independent, or too many to tell.
    """
    mechanism = problem.mechanism
    rows = mechanism.rows
    if not 0 < len(rows) <= MOST_ROWS:
        return []
    top, scratch = mechanism.topology, problem.scratch
    constraints_at(top, scratch, problem.t0, problem.q0, problem.v0)
    jacobian = np.zeros((len(rows), mechanism.size))
    for i, row in enumerate(rows):
        block = scratch.jac[row.pair, 6 * row.place : 6 * row.place + 6]
        for side in range(2):
            first = 3 * int(top.pairs[row.pair, 1 + side])
            jacobian[i, first : first + 3] += block[3 * side : 3 * side + 3]
    jacobian = jacobian[:, : mechanism.size - 3] * np.sqrt(top.weight[:-1].ravel())
    independent: list[np.ndarray] = []
    found: list[str] = []
    for i, row in enumerate(rows):
        rest = jacobian[i].copy()
        size = float(np.linalg.norm(rest))
        for _ in range(2):  # Gram-Schmidt, once more for orthogonality
            for direction in independent:
                rest -= (direction @ rest) * direction
        left = float(np.linalg.norm(rest))
        if left > RANK_TOLERANCE * size:
            independent.append(rest / left)
        elif (name := row.label.rsplit(".", 1)[0]) not in found:
            found.append(name)
    return found


def require_unique_start(problem: Problem) -> None:
    """Raise SpecError where the start has no unique accelerations, with the joints named that are to blame.

    Parameters
    ----------
    problem
        The mechanism at its start; its solver is left ready for use.
    """
    mechanism = problem.mechanism
    acc, lam = np.zeros(mechanism.size), np.zeros((len(mechanism.topology.pairs), 2))
    try:
        for _ in range(2):
            status = tangents_at(
                mechanism.topology, problem.scratch, problem.solver, problem.t0, problem.q0, problem.v0, acc, lam
            )
            if status == OK:
                break
            problem.use_pivots()
        else:
            raise SingularSystemError
    except SingularSystemError:
        raise SpecError(_blame(problem), key="model.joints") from None
    if force := problem.unusable_law():
        raise SpecError("its law gives no finite number at the start", key=f"model.forces.{force}")
    if not (np.all(np.isfinite(acc)) and np.all(np.isfinite(lam))):
        raise SpecError("the forces of the start are too large to be held in double precision", key="model")


def _blame(problem: Problem) -> str:
    names = dependent_joints(problem)
    if not names:
        return "the equations have no unique solution at the start: the mechanism stands in a singular position"
    joints = ("joint " if len(names) == 1 else "joints ") + ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
    return (
        f"the equations have no unique solution at the start: what {joints} would hold is held by others already; "
        "constraints must be independent"
    )
