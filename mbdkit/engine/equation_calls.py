"""The kernels of `mbdkit.engine.kernels.equations` with storage for their vectors."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.iteration_matrix import put
from mbdkit.engine.kernels import equations
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.repeated_call import RepeatedCall
from mbdkit.engine.workspace import Workspace


class EquationCalls:
    """Kernels that read vectors of fixed storage, which takes half the time of calls with new arrays.

    Parameters
    ----------
    workspace
        The workspace of the equations of motion.

    Attributes
    ----------
    address
        Address of the data for the kernels.
    x, mu, phi, rate, gamma
        (n,) and (m,) results.
    accelerations, solution, residual, constraint_forces, rows, tangents
        The kernels; each takes the time and returns a status.
    """

    def __init__(self, workspace: Workspace):
        top, scratch = workspace.stepping_topology, workspace.scratch
        n = 3 * len(workspace.mechanism.bodies)
        self._workspace = workspace
        self._pinned = PinnedBundle(equations.new_equations(top, scratch, workspace.solver))
        address = self.address = self._pinned.address
        q, v, a, force, self.x = (np.zeros(n) for _ in range(5))
        lam, rows, self.mu, self.phi, self.rate, self.gamma = (np.zeros(workspace.unknowns - n) for _ in range(6))
        self._q, self._v, self._a, self._lam, self._force, self._rows = q, v, a, lam, force, rows
        state, solved = (address, None, q, v), (force, rows, self.x, self.mu)
        self.accelerations = RepeatedCall(equations.solution_of, *state, False, *solved)
        self.solution = RepeatedCall(equations.solution_of, *state, True, *solved)
        self.residual = RepeatedCall(equations.residual_of, *state, a, lam, True, self.x)
        self.constraint_forces = RepeatedCall(equations.residual_of, *state, a, lam, False, self.x)
        self.rows = RepeatedCall(equations.rows_of, *state, self.phi, self.rate, self.gamma)
        self.tangents = RepeatedCall(equations.tangents_of, *state, a, lam)

    def use_pivots(self) -> None:
        """Use the solver of the workspace, which differs after new pivots, chosen here or by the recorder.

        The address stays, because solvers have equally many arrays.
        """
        if self._pinned.bundle.solver is not self._workspace.solver:
            self._pinned.replace(self._pinned.bundle._replace(solver=self._workspace.solver))

    def at(self, q: np.ndarray, v: np.ndarray) -> None:
        """Store a position and a velocity (n,)."""
        put(self._q, q)
        put(self._v, v)

    def with_forces(self, a: np.ndarray, lam: np.ndarray) -> None:
        """Store accelerations (n,) and multipliers (m,)."""
        put(self._a, a)
        put(self._lam, lam)

    def with_right_side(self, force: np.ndarray, rows: np.ndarray) -> None:
        """Store the right-hand side, (n,) and (m,)."""
        put(self._force, force)
        put(self._rows, rows)
