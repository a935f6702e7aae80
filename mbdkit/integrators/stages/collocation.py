"""Compiled collocation methods of any formulation, and other fully implicit Runge-Kutta methods.

One step is the same for all formulations (`mbdkit.integrators.stages.collocation_step`). A formulation provides the
residual and the change of the stages, and the change that has to converge
(`mbdkit.integrators.stages.collocation_stages.StageKernels`). The modules of both kinds of equations,
`collocation_index1` and `collocation_constrained`, have the compiled functions ``attempt`` and ``dense``
(`mbdkit.integrators.loop.step_loop`), and ``choose_pivots``, which chooses pivots for the stage matrix from the
tangents evaluated last and from ``h mu``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.engine.formulation import FORMULATIONS, INDEX_1
from mbdkit.engine.iteration_matrix import classes_of
from mbdkit.engine.kernels.equations import GAMMA_V, STIFFNESS
from mbdkit.engine.kernels.observe import tangents_at
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.spanning_tree import spanning_tree
from mbdkit.engine.stored_arrays import pattern_of, restore, scatter_of, stored
from mbdkit.integrators.run.run_state import FACTORIZATIONS, JACOBIANS, RHS, RunState
from mbdkit.integrators.stages import collocation_constrained, collocation_index1
from mbdkit.integrators.stages.collocation_stages import (
    FIXED_POINT,
    NEWTON,
    coefficients_of,
    new_settings,
    new_stages,
    new_systems,
)
from mbdkit.integrators.stages.collocation_step import keep
from mbdkit.integrators.stages.compiled_method import CompiledMethod
from mbdkit.integrators.stages.convergence import TOLERANCE, describe_divergence
from mbdkit.integrators.stages.coupled_newton import CoupledNewton
from mbdkit.registry.target import Target

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace
    from mbdkit.integrators.run.step_control import Control
    from mbdkit.methods.kinds import ImplicitRungeKutta


class CompiledCollocation(CompiledMethod):
    """A fully implicit tableau on the formulation of a workspace.

    Parameters
    ----------
    method
        The tableau and how its stages are solved; formulations other than index-1 need a stiffly accurate tableau and
        Newton's method.
    workspace
        The mechanism.
    control
        Control of the step size, which bounds the accuracy of the stages for index-1; None for fixed steps.
    """

    carries_stages = True
    duals = Target("mbdkit.integrators.duals.dual_steps:CollocationDuals")
    keep = keep

    def __init__(self, method: ImplicitRungeKutta, workspace: Workspace, control: Control | None):
        super().__init__(workspace)
        formulation = self.formulation = FORMULATIONS[workspace.formulation]
        self.equations = collocation_constrained if formulation.solves_multipliers else collocation_index1
        self.attempt, self.dense = self.equations.attempt, self.equations.dense
        self.carries_multipliers = formulation.solves_multipliers
        self.has_dense_output = method.tableau.is_collocation
        self.rk = coefficients_of(method.tableau)
        self.stages = len(self.rk.b)
        tolerance = TOLERANCE
        if method.tolerance is not None:
            tolerance = method.tolerance
        elif control is not None and not formulation.solves_multipliers:  # this tolerance is relative to accelerations
            tolerance = control.iteration_tolerance
        solver = NEWTON if method.stage_solver == "newton" else FIXED_POINT
        settings = new_settings(formulation, solver, method.max_iterations, tolerance)
        tree = spanning_tree(workspace.mechanism.topology) if formulation.coordinates == "joint" else None
        self.bundle = new_stages(self.rk, workspace, settings, _terms_by_position(workspace), tree)
        self.pinned = PinnedBundle(self.bundle)
        if method.max_iterations is None:
            self.limit = self.bundle.settings.limit
        self.coupled: CoupledNewton | None = None

    def start(self, run_state: RunState, h: float) -> None:
        """Choose pivots for the stage matrix at the state in `run_state`, for steps of about `h`."""
        self.renew(run_state, self.workspace.t0, h)

    def forget(self) -> None:
        """Start the next step without stage values to extrapolate."""
        self.bundle.previous.size[0] = np.nan

    def renew(self, run_state: RunState, t: float, h: float) -> bool:
        """Choose new pivots for the stage matrix at the state in `run_state`; discard stage values.

        Raises
        ------
        SingularSystemError
            If the matrix, or the index-1 system, is singular.
        """
        stages, workspace = self.bundle, self.workspace
        self.forget()
        self._evaluate_tangents(run_state, t)
        fixed_point = stages.settings.solver[0] == FIXED_POINT
        pattern, scatter = self.equations.choose_pivots(workspace, None if fixed_point else self._rate(h))
        self.bundle = stages._replace(systems=new_systems(self.rk, pattern, scatter, workspace.unknowns))
        self.pinned.replace(self.bundle)
        return True

    def stored_systems(self) -> Any:
        """See `CompiledMethod.stored_systems`."""
        return stored(self.bundle.systems)

    def restore_systems(self, state: Any) -> None:
        """See `CompiledMethod.restore_systems`; the shapes of the arrays depend on the pivots."""
        workspace = self.workspace
        pattern = pattern_of(state["pattern"], workspace.unknowns)
        scatter = scatter_of(state["scatter"], len(workspace.scratch.source), len(pattern.a_column))
        systems = new_systems(self.rk, pattern, scatter, workspace.unknowns)
        arrays = systems._asdict()
        for name in ("real", "cplx"):
            restore(arrays[name]._asdict(), state[name])
        without = ("pattern", "scatter", "real", "cplx")
        restore(
            {name: array for name, array in arrays.items() if name not in without},
            {name: values for name, values in state.items() if name not in without},
        )
        self.bundle = self.bundle._replace(systems=systems)
        self.pinned.replace(self.bundle)

    def _evaluate_tangents(self, run_state: RunState, t: float) -> None:
        stages, workspace = self.bundle, self.workspace
        workspace.take_states(run_state.z)
        workspace.retry_with_new_pivots(
            lambda: tangents_at(workspace.stepping_engine, t, run_state.q, run_state.v, stages.spread[0], stages.pairs)
        )
        if not self.formulation.solves_multipliers:
            stages.lam[:] = 0.0

    def _rate(self, h: float) -> complex:
        """Return ``h mu`` of the eigenvalue by which pivots are chosen; it is real only if all eigenvalues are real."""
        if len(self.rk.mu_complex):
            return complex(h * self.rk.mu_complex[0])
        return float(h * max(self.rk.mu_real, key=abs))

    def solve_apart(self, run_state: RunState, t: float, h: float) -> bool:
        """Solve the stages of the next attempt with a tangent for each stage; return whether that succeeded.

        This is done only for index-1 in the coordinates of the bodies, because only these equations are solved in this
        way, and only if there are no first-order states.
        """
        stages, settings = self.bundle, self.bundle.settings
        is_other = settings.solver[0] == FIXED_POINT or self.formulation != INDEX_1
        if is_other or self.workspace.mechanism.states:
            return False
        if self.coupled is None:
            self.coupled = CoupledNewton(self.workspace, self.rk.a, self.rk.a2, self.rk.c)
        iterations = self.coupled.solve(t, h, run_state.q, run_state.v, stages.acc, stages.lam)
        spent, counts = self.coupled.counters, run_state.counts
        counts[RHS] += spent.rhs_evaluations
        counts[JACOBIANS] += spent.jacobian_evaluations
        counts[FACTORIZATIONS] += spent.factorizations
        spent.rhs_evaluations = spent.jacobian_evaluations = spent.factorizations = 0
        stages.solved_apart[0] = iterations if iterations <= stages.settings.limit.most[0] else 0
        return bool(stages.solved_apart[0] > 0)

    def switch_iteration(self) -> bool:
        """Let the tangents of the stages turn with the nodes of beams, or let them no longer do so.

        Return whether the iteration was switched. In joint coordinates it is not, because the unknowns of nodes are
        then not always their accelerations.
        """
        stages = self.bundle
        is_other = stages.settings.solver[0] == FIXED_POINT or self.formulation.coordinates == "joint"
        if is_other or len(stages.nodes) == 0:
            return False
        stages.turning[0] = 1 - stages.turning[0]
        self.forget()
        self.restore_iterations()
        return True

    def describe_divergence(self, report: np.ndarray) -> str:
        """Return the largest change of an acceleration and its location, as text."""
        return describe_divergence(self.workspace, report)


def _terms_by_position(workspace: Workspace) -> np.ndarray:
    """Return the terms of the matrix that are derivatives with respect to positions, (N, 4).

    The columns are the index in ``Scratch.source``, the row and the column in the matrix, and the class of the term.
    """
    terms, classes = workspace.terms, classes_of(workspace)
    wanted = (classes == STIFFNESS) | (classes == GAMMA_V)
    columns = (terms.source, terms.row, terms.column, classes)
    return np.column_stack([x[wanted] for x in columns]).astype(np.int64)
