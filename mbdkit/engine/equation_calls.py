"""The kernels of `mbdkit.engine.kernels.equations` with storage for their vectors."""

from __future__ import annotations

import numpy as np

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
    q, v, a, force, lam, right
        (n,) arguments, and (m,) multipliers and right-hand side of the constraint rows.
    x, mu, phi, rate, gamma
        (n,) and (m,) results.
    accelerations, solution, residual, constraint_forces, rows, constraints, tangents
        The kernels; each takes the time and returns a status. Velocities are zero in `solution`, `constraint_forces`
        and `constraints`.
    arrive
        Kernel that takes the time, q, v, and the maxima (P,) of squared misalignments.
    """

    def __init__(self, workspace: Workspace):
        top, scratch = workspace.stepping_topology, workspace.scratch
        n = 3 * len(workspace.mechanism.bodies)
        self._workspace = workspace
        self._pinned = PinnedBundle(equations.new_equations(top, scratch, workspace.solver))
        address = self.address = self._pinned.address
        self.q, self.v, self.a, self.force, self.x, rest = (np.zeros(n) for _ in range(6))
        self.lam, self.right, self.mu, self.phi, self.rate, self.gamma = np.zeros((6, workspace.unknowns - n))
        moving, at_rest = (address, None, self.q, self.v), (address, None, self.q, rest)
        solved, rows = (self.force, self.right, self.x, self.mu), (self.phi, self.rate, self.gamma)
        self.accelerations = RepeatedCall(equations.solution_of, *moving, False, *solved)
        self.solution = RepeatedCall(equations.solution_of, *at_rest, True, *solved)
        self.residual = RepeatedCall(equations.residual_of, *moving, self.a, self.lam, True, self.x)
        self.constraint_forces = RepeatedCall(equations.residual_of, *at_rest, rest, self.lam, False, self.x)
        self.rows = RepeatedCall(equations.rows_of, *moving, *rows)
        self.constraints = RepeatedCall(equations.rows_of, *at_rest, *rows)
        self.tangents = RepeatedCall(equations.tangents_of, *moving, self.a, self.lam)
        self.arrive = RepeatedCall(equations.arrive_at, address, None, None, None, None)

    def use_pivots(self) -> None:
        """Use the solver of the workspace, which differs after new pivots, chosen here or by the recorder.

        The address stays, because solvers have equally many arrays.
        """
        if self._pinned.bundle.solver is not self._workspace.solver:
            self._pinned.replace(self._pinned.bundle._replace(solver=self._workspace.solver))
