"""The index-1 system of a whole mechanism in SymPy: its matrices, a print in LaTeX, and its numbers at a state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import sympy as sp

_ARRAYS = ("mass_matrix", "constraints", "constraint_jacobian", "gamma", "forces")


@dataclass(frozen=True, eq=False, repr=False)
class SymbolicSystem:
    """The equations of motion of a mechanism, ready for a paper, a lecture or a formula of one's own.

    ::

        [ M      Phi_q^T ] [ q''    ]   [ Q     ]       gamma = -(Phi_q v)_q v - 2 Phi_qt v - Phi_tt
        [ Phi_q  0       ] [ lambda ] = [ gamma ]

    Bodies and joints come in the order of the mechanism, n = 3 B coordinates and m constraint rows. A point mass has a
    tilt of its own like every body, with inertia 1, on which nothing depends.

    Attributes
    ----------
    t : Symbol
        Time [s].
    q, v, accelerations : (n, 1) matrices of symbols
        ``x_BODY, y_BODY, theta_BODY`` of each body [m, rad], and their derivatives ``xdot_BODY``, ``xddot_BODY``, ...
    multipliers : (m, 1) matrix of symbols
        ``lambda_JOINT_ROW``, such as ``lambda_A_x`` [N or N m].
    mass_matrix : (n, n) matrix
        M.
    constraints : (m, 1) matrix
        Phi(q, t), [m] or [rad].
    constraint_jacobian : (m, n) matrix
        Phi_q.
    gamma : (m, 1) matrix
        Right side of ``Phi_q q'' = gamma``.
    forces : (n, 1) matrix
        Q(q, v, t), the applied forces, gravity included.
    parameters : dict of symbol to float
        What the symbols for masses, lengths, stiffnesses and the like stand for; empty where numbers were put in.
    names : dict of symbol to str
        Each symbol in LaTeX.
    """

    t: sp.Symbol
    q: sp.ImmutableMatrix
    v: sp.ImmutableMatrix
    accelerations: sp.ImmutableMatrix
    multipliers: sp.ImmutableMatrix
    mass_matrix: sp.ImmutableMatrix
    constraints: sp.ImmutableMatrix
    constraint_jacobian: sp.ImmutableMatrix
    gamma: sp.ImmutableMatrix
    forces: sp.ImmutableMatrix
    parameters: Mapping[sp.Symbol, float]
    names: Mapping[sp.Symbol, str]

    def __repr__(self) -> str:
        n, m = len(self.q), len(self.multipliers)
        return f"<SymbolicSystem: {n} coordinates, {m} constraint rows, {len(self.parameters)} parameters>"

    def kkt(self) -> tuple[sp.ImmutableMatrix, sp.ImmutableMatrix]:
        """Return the matrix (n + m, n + m) and the right side (n + m, 1) of the system."""
        m = len(self.multipliers)
        jacobian = self.constraint_jacobian
        upper = self.mass_matrix.row_join(jacobian.T)
        lower = jacobian.row_join(sp.zeros(m, m))
        return sp.ImmutableMatrix(upper.col_join(lower)), sp.ImmutableMatrix(self.forces.col_join(self.gamma))

    def latex(self) -> str:
        r"""Return the system as LaTeX for an equation environment, its blocks parted by lines; needs amsmath.

        A body or joint whose name has letters beyond Latin and Greek needs XeLaTeX or LuaLaTeX with a font for them.
        """
        matrix, right = self.kkt()
        unknowns = self.accelerations.col_join(self.multipliers)
        return f"{self._array(matrix)}\n{self._array(unknowns)}\n=\n{self._array(right)}"

    def _repr_latex_(self) -> str:
        return rf"$\displaystyle {self.latex()}$"

    def _array(self, matrix: sp.ImmutableMatrix) -> str:
        """Return a matrix of n + m rows in brackets, with a line below row n, and right of column n if it is square."""
        n, (rows, columns) = len(self.q), matrix.shape
        split = 0 < n < rows
        layout = "c" * n + "|" + "c" * (columns - n) if split and columns == rows else "c" * columns
        lines = [" & ".join(sp.latex(x, symbol_names=self.names) for x in matrix.row(i)) + r" \\" for i in range(rows)]
        if split:
            lines.insert(n, r"\hline")
        body = "\n".join(lines)
        return f"\\left[\\begin{{array}}{{{layout}}}\n{body}\n\\end{{array}}\\right]"

    def evaluate(self, t: float, q: npt.ArrayLike, v: npt.ArrayLike) -> dict[str, np.ndarray]:
        """Return the numbers of the system at a state, and its solution.

        Parameters
        ----------
        t
            Time [s].
        q, v
            (B, 3) or (3 B,) coordinates and velocities [m, rad, m/s, rad/s].

        Returns
        -------
        dict of str to ndarray
            ``mass_matrix`` (n, n), ``constraints`` (m,), ``constraint_jacobian`` (m, n), ``gamma`` (m,), ``forces``
            (n,), ``accelerations`` (n,) and ``multipliers`` (m,); where joints are redundant at this state, the
            multipliers of least norm.

        Raises
        ------
        ValueError
            For arrays of another size, and where the system is not finite at this state.
        """
        n, m = len(self.q), len(self.multipliers)
        state = [np.asarray(x, dtype=float).ravel() for x in (q, v)]
        for name, x in zip("qv", state, strict=True):
            if len(x) != n:
                raise ValueError(f"{name} should have {n} numbers, 3 for each of {n // 3} bodies, not {len(x)}")
        try:
            flat = self._function(float(t), *(x.tolist() for x in state), list(self.parameters.values()))
        except (ArithmeticError, ValueError) as error:
            raise ValueError(f"the system is not finite at this state, t = {t:g} s ({error})") from error
        shapes = {"mass_matrix": (n, n), "constraints": (m,), "constraint_jacobian": (m, n), "gamma": (m,)}
        values = {
            name: np.array(entries, dtype=float).reshape(shapes.get(name, (n,)))
            for name, entries in zip(_ARRAYS, flat, strict=True)
        }
        return values | _solved(**values)

    @cached_property
    def _function(self) -> Callable[..., list[list[float]]]:
        """The entries of all matrices, in the order of `_ARRAYS`, as a function of t, q, v and the parameters."""
        arguments = [self.t, list(self.q), list(self.v), list(self.parameters)]
        entries = [list(getattr(self, name)) for name in _ARRAYS]
        function: Callable[..., list[list[float]]] = sp.lambdify(arguments, entries, modules="math", cse=True)
        return function


def _solved(
    mass_matrix: np.ndarray, constraint_jacobian: np.ndarray, gamma: np.ndarray, forces: np.ndarray, **_: Any
) -> dict[str, np.ndarray]:
    """Return accelerations and multipliers, from the system scaled to a mass matrix of ones."""
    n, m = len(forces), len(gamma)
    root = np.sqrt(np.diag(mass_matrix))
    jacobian = constraint_jacobian / root
    matrix = np.block([[np.eye(n), jacobian.T], [jacobian, np.zeros((m, m))]])
    right = np.concatenate([forces / root, gamma])
    if m and np.linalg.matrix_rank(jacobian) < m:
        x = np.linalg.lstsq(matrix, right, rcond=1e-12)[0]
    else:
        x = np.linalg.solve(matrix, right)
        x += np.linalg.solve(matrix, right - matrix @ x)
    return {"accelerations": x[:n] / root, "multipliers": x[n:]}
