"""The index-1 equations of motion of a mechanism in SymPy: matrices, LaTeX output and numerical evaluation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import sympy as sp

_ARRAYS = ("mass_matrix", "constraints", "constraint_jacobian", "gamma", "forces")


@dataclass(frozen=True, eq=False, repr=False)
class SymbolicSystem:
    """The symbolic index-1 equations of motion of a mechanism.

    ::

        [ M      Phi_q^T ] [ q''    ]   [ Q     ]       gamma = -(Phi_q v)_q v - 2 Phi_qt v - Phi_tt
        [ Phi_q  0       ] [ lambda ] = [ gamma ]

    Bodies and joints are in the order of the mechanism. B bodies have n = 3 B coordinates; the joints have m constraint
    rows. A point mass also has an angle, with inertia 1, which does not affect the other equations.

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
        Phi(q, t), the constraint residuals [m] or [rad]; subscripts of Phi denote partial derivatives.
    constraint_jacobian : (m, n) matrix
        Phi_q.
    gamma : (m, 1) matrix
        Right side of ``Phi_q q'' = gamma``.
    forces : (n, 1) matrix
        Q(q, v, t), the applied forces, gravity included.
    parameters : dict of symbol to float
        Values of the symbols for masses, lengths, stiffnesses and other parameters; empty if numbers were inserted.
    names : dict of symbol to str
        LaTeX name of each symbol.
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
        r"""Return the system as LaTeX for an equation environment, with lines between the blocks; requires amsmath.

        Names of bodies and joints with letters other than Latin and Greek require XeLaTeX or LuaLaTeX and a suitable
        font.
        """
        matrix, right = self.kkt()
        unknowns = self.accelerations.col_join(self.multipliers)
        return f"{self._array(matrix)}\n{self._array(unknowns)}\n=\n{self._array(right)}"

    def _repr_latex_(self) -> str:
        return rf"$\displaystyle {self.latex()}$"

    def _array(self, matrix: sp.ImmutableMatrix) -> str:
        n, (rows, columns) = len(self.q), matrix.shape
        split = 0 < n < rows
        layout = "c" * n + "|" + "c" * (columns - n) if split and columns == rows else "c" * columns
        lines = [" & ".join(sp.latex(x, symbol_names=self.names) for x in matrix.row(i)) + r" \\" for i in range(rows)]
        if split:
            lines.insert(n, r"\hline")
        body = "\n".join(lines)
        return f"\\left[\\begin{{array}}{{{layout}}}\n{body}\n\\end{{array}}\\right]"

    def evaluate(self, t: float, q: npt.ArrayLike, v: npt.ArrayLike) -> dict[str, np.ndarray]:
        """Evaluate the system at a state and solve it.

        Parameters
        ----------
        t
            Time [s].
        q, v
            (B, 3) or (3 B,) coordinates [m, rad] and velocities [m/s, rad/s].

        Returns
        -------
        dict of str to ndarray
            ``mass_matrix`` (n, n), ``constraints`` (m,), ``constraint_jacobian`` (m, n), ``gamma`` (m,), ``forces``
            (n,), ``accelerations`` (n,) and ``multipliers`` (m,); if constraints are redundant at this state, the
            multipliers of minimum norm.

        Raises
        ------
        ValueError
            If an array has the wrong size, or if the system is not finite at this state.
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
        """Function of t, q, v and the parameters; it returns the entries of all matrices in the order of `_ARRAYS`."""
        arguments = [self.t, list(self.q), list(self.v), list(self.parameters)]
        entries = [list(getattr(self, name)) for name in _ARRAYS]
        function: Callable[..., list[list[float]]] = sp.lambdify(arguments, entries, modules="math", cse=True)
        return function


def _solved(
    mass_matrix: np.ndarray, constraint_jacobian: np.ndarray, gamma: np.ndarray, forces: np.ndarray, **_: object
) -> dict[str, np.ndarray]:
    """Return accelerations and multipliers, computed with coordinates for which the mass matrix is the identity."""
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
