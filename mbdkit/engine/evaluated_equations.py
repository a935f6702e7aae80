"""Evaluation of the equations of motion for methods written in NumPy, with work counters."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.counters import HostCounters
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.iteration_matrix import put, vector
from mbdkit.engine.kernels import equations
from mbdkit.engine.kernels.applied_forces import potential_energy
from mbdkit.engine.kernels.observe import baumgarte_at
from mbdkit.engine.kernels.projected_state import nearest_state
from mbdkit.engine.kernels.projection import MOST_ITERATIONS
from mbdkit.engine.kernels.system import DIVERGED, NOT_FINITE, OK
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.repeated_call import RepeatedCall
from mbdkit.engine.state_derivatives import Rates, StateDerivatives
from mbdkit.engine.workspace import Workspace


class EvaluatedEquations:
    """Evaluation of the equations of motion of one mechanism, and solutions with their index-1 matrix.

    See `mbdkit.engine.equations_of_motion.EquationsOfMotion` for the parameters and attributes.
    """

    def __init__(self, workspace: Workspace, z0: np.ndarray | None = None):
        mechanism = workspace.mechanism
        self._workspace, self._calls = workspace, EquationCalls(workspace)
        self.address = self._calls.address
        self.n, self.m = 3 * len(mechanism.bodies), len(mechanism.solved_rows)
        self.bodies, self.pairs = mechanism.bodies, len(mechanism.topology.pairs)
        self.constraint_names = tuple(row.label for row in mechanism.solved_rows)
        self.formulation, self.stabilization = workspace.formulation, workspace.stabilization
        self.mass = mechanism.topology.mass[:-1].ravel()  # a view of the array that the kernels read
        self.t0, self.q0, self.v0 = workspace.t0, workspace.q0[: self.n].copy(), workspace.v0[: self.n].copy()
        self.z0 = np.array(mechanism.initial_states if z0 is None else z0)
        for array in (self.mass, self.q0, self.v0, self.z0):
            array.flags.writeable = False
        self.counters = HostCounters()
        self.has_power = mechanism.has_power
        self._has_friction = len(mechanism.topology.frictions) > 0
        self.first_step: float | None = None
        self.longest_step = math.inf
        self._no_force, self._no_rows = np.zeros(self.n), np.zeros(self.m)

    @property
    def workspace(self) -> Workspace:
        """Mechanism, working arrays and solver, for internal use."""
        return self._workspace

    @property
    def length(self) -> float:
        """Characteristic length of the mechanism [m]."""
        return self._workspace.mechanism.length

    def hold(self, z: np.ndarray) -> None:
        """Use the values `z` (Z,) of first-order states in later evaluations."""
        self._workspace.take_states(vector(z, len(self.z0)))

    @property
    def terms_now(self) -> np.ndarray:
        """Values of all terms of the tangents at the last evaluation."""
        return self._workspace.scratch.source

    def accelerations(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the index-1 accelerations (n,) and multipliers (m,) at a state."""
        self.counters.rhs_evaluations += 1
        self._at(q, v)
        return self._solved(self._calls.accelerations, t)

    def derivatives(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> Rates:
        """Return the index-1 accelerations, the multipliers, and the rates of the first-order states.

        Counts as one evaluation of the right-hand side. Later calls without `z` use the states `z` too.

        `t`, `q`, `v`, `z`: time [s], position and velocity (n,), and first-order states (Z,). Returns (n,), (m,) and
        (Z,) arrays; rates in the units of the states per second.
        """
        self.counters.rhs_evaluations += 1
        return self._derivatives(t, q, v, z)

    def observed(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> Rates:
        """Return the result of `derivatives` for mbdkit itself, which is counted apart, as a `host_evaluation`."""
        self.counters.host_evaluations += 1
        return self._derivatives(t, q, v, z)

    def rates(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the rates (Z,) of the first-order states, as `derivatives` does; free if there are no such states."""
        return self.derivatives(t, q, v, z)[2] if len(self.z0) else vector(z, 0).copy()

    def potential(self, t: float, q: np.ndarray, z: np.ndarray | None = None) -> float:
        """Return the potential energy of gravity, springs and beams [J], as recorded in the archive.

        `t`, `q`: time [s] and position (n,). `z`: (Z,) first-order states; if left out, those last used.
        """
        if z is not None:
            self.hold(z)
        q = vector(q, self.n)
        self._take(q, self._no_force, self._no_force, self._no_rows)
        self._evaluate(self._calls.residual, t)
        return float(potential_energy(self._workspace.mechanism.topology, self._workspace.scratch, with_ground(q))[0])

    def kinetic(self, v: np.ndarray) -> float:
        """Return the kinetic energy at the velocity `v` (n,) [J]."""
        v = vector(v, self.n)
        return float(0.5 * np.sum(self.mass * v * v))

    def solve(self, t: float, q: np.ndarray, force: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve ``M x + Phi_q^T mu = force``, ``Phi_q x = rows`` at the position `q`.

        `t`, `q`: time [s] and position (n,). `force`, `rows`: (n,) and (m,) right-hand sides. Returns (n,) and (m,)
        solution.
        """
        calls = self._calls
        put(calls.q, q)
        put(calls.force, force)
        put(calls.right, rows)
        return self._solved(calls.solution, t)

    def project(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the consistent positions and velocities (n,) at time `t` nearest to `q` and `v` in the mass metric.

        See `project_positions` and `project_velocities`. One call of compiled code, which counts as one projection.
        """
        return self._projected(self._calls.projected, t, q, v)

    def project_positions(self, t: float, q: np.ndarray) -> np.ndarray:
        """Return the positions (n,) nearest to `q` in the mass metric that satisfy all constraints at time `t`.

        Solves ``M (p - q) + Phi_q(p)^T mu = 0``, ``Phi(t, p) = 0`` to round-off; counts as one projection.
        """
        return self._projected(self._calls.projected_positions, t, q, self._no_force)[0]

    def project_velocities(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the velocities (n,) nearest to `v` in the mass metric with ``Phi_q v + Phi_t = 0`` at `t`, `q`.

        The equations are linear; a second solve removes the rounding error of the first. Counts as one projection.
        """
        return self._projected(self._calls.projected_velocities, t, q, v)[1]

    def forces(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the generalized applied forces Q (n,), gravity and friction in joints included.

        Friction depends on the reactions of its joint. It is that of the index-1 multipliers at this state, so that
        ``solve(t, q, forces(t, q, v), gamma(t, q, v))`` returns the accelerations and multipliers of `accelerations`.
        With such friction, a call costs a solution for these multipliers, and counts as two evaluations. Methods with
        multipliers of their own get the friction due to them from `residual`.
        """
        if not self._has_friction:
            return 0.0 - self.residual(t, q, v, self._no_force, self._no_rows)
        lam = self.accelerations(t, q, v)[1]
        return self.constraint_forces(t, q, lam) - self.residual(t, q, v, self._no_force, lam)

    def residual(self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """Return the residual of the equations of motion, ``M a + Phi_q^T lam - Q(t, q, v)`` (n,).

        Friction in joints, which is part of Q, is that of the multipliers `lam`.
        """
        self.counters.rhs_evaluations += 1
        return self._residual(t, q, v, a, lam)

    def constraint_forces(self, t: float, q: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """Return ``Phi_q^T lam`` (n,)."""
        put(self._calls.q, q)
        put(self._calls.lam, lam)
        self._evaluate(self._calls.constraint_forces, t)
        return self._calls.x.copy()

    def constraints(self, t: float, q: np.ndarray) -> np.ndarray:
        """Return Phi (m,) [m, rad]."""
        put(self._calls.q, q)
        self._evaluate(self._calls.constraints, t)
        return self._calls.phi.copy()

    def constraint_rates(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the time derivative of the constraints, ``Phi_q v + Phi_t`` (m,) [m/s, rad/s]."""
        self._at(q, v)
        self._evaluate(self._calls.rows, t)
        return self._calls.rate.copy()

    def gamma(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the right-hand side of ``Phi_q a = gamma`` (m,) [m/s^2, rad/s^2], Baumgarte's terms included."""
        self._at(q, v)
        self._evaluate(self._calls.rows, t)
        return self._calls.gamma.copy()

    def baumgarte_terms(self, t: float, q: np.ndarray, v: np.ndarray) -> float:
        """Return the largest of Baumgarte's terms ``2 alpha Phi' + beta^2 Phi`` at a state [m/s^2, rad/s^2]."""
        state = (with_ground(vector(x, self.n)) for x in (q, v))
        return float(baumgarte_at(self._workspace.stepping_engine, float(t), *state))

    def powers(self, t: float, q: np.ndarray, v: np.ndarray, lam: np.ndarray) -> tuple[float, float]:
        """Return the power of loads and drivers and the dissipated power at a state with multipliers `lam` [W]."""
        q, v, lam = vector(q, self.n), vector(v, self.n), vector(lam, self.m)
        work, lost = equations.powers_of(self.address, float(t), q, v, lam)
        return work, lost

    def arrive(self, t: float, q: np.ndarray, v: np.ndarray, worst: np.ndarray) -> bool:
        """Update the maxima `worst` (P,) by the squared misalignments at a state; return whether q and v are finite."""
        return bool(self._calls.arrive(float(t), vector(q, self.n), vector(v, self.n), worst))

    def _residual(self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> np.ndarray:
        self._take(q, v, a, lam)
        self._evaluate(self._calls.residual, t)
        return self._calls.x.copy()

    def _derivatives(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> Rates:
        if not len(self.z0):
            self._at(q, v)
            return *self._solved(self._calls.accelerations, t), vector(z, 0).copy()
        if (rates := self._forms.evaluated(t, q, v, z, self.solved_by)) is None:
            raise self._not_finite()
        return rates

    def _projected(
        self, project: Callable[[float], int], t: float, q: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        self.counters.projections += 1
        self._at(q, v)
        self.solved_by(project, t)
        return self._calls.near_q.copy(), self._calls.near_v.copy()

    def _solved(self, solve: Callable[[float], int], t: float) -> tuple[np.ndarray, np.ndarray]:
        self.solved_by(solve, t)
        return self._calls.x.copy(), self._calls.mu.copy()

    def solved_by(self, solve: Callable[[float], int], t: float) -> None:
        """Call `solve` at a time, with new pivots if the current ones fail; raise StepError if there is no solution.

        `solve` calls a kernel with `address`, which returns a status; for internal use.
        """

        def counted() -> int:
            self.counters.factorizations += 1
            self._calls.use_pivots()
            return solve(float(t))

        workspace = self._workspace
        try:
            status = workspace.retry_with_new_pivots(counted)
        except SingularSystemError as error:
            raise self._singular(error) from None
        if status == OK:
            return
        if status == DIVERGED and workspace.is_finite(tangents=False):
            raise StepError(
                "newton-failed", f"no position that satisfies the joints was found in {MOST_ITERATIONS} iterations"
            )
        if status == NOT_FINITE or not workspace.is_finite(tangents=False):
            raise self._not_finite()
        raise self._singular(SingularSystemError(workspace.failed_unknown))

    def _at(self, q: np.ndarray, v: np.ndarray) -> None:
        put(self._calls.q, q)
        put(self._calls.v, v)

    def _take(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> None:
        self._at(q, v)
        put(self._calls.a, a)
        put(self._calls.lam, lam)

    def _evaluate(self, kernel: Callable[[float], int], t: float) -> None:
        if kernel(float(t)) != OK:
            raise self._not_finite()

    def _evaluate_tangents(self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> None:
        self.counters.jacobian_evaluations += 1
        self._take(q, v, a, lam)
        self._evaluate(self._calls.tangents, t)

    @cached_property
    def _forms(self) -> StateDerivatives:
        return StateDerivatives(self._workspace)

    def _singular(self, error: SingularSystemError) -> StepError:
        name = self._workspace.mechanism.unknown_name(error.index)
        return StepError("singular", f"the system of equations is singular at {name}")

    def _not_finite(self) -> StepError:
        return StepError(self._workspace.cause, self._workspace.unusable() or "numbers overflowed")


class EquationCalls:
    """Kernels that read vectors of fixed storage, which takes half the time of calls with new arrays.

    - `workspace`: the workspace of the equations of motion.
    - `address`: address of the data for the kernels.
    - `q`, `v`, `a`, `force`, `lam`, `right`: (n,) arguments, and (m,) multipliers and right-hand side of the constraint
      rows.
    - `x`, `mu`, `phi`, `rate`, `gamma`: (n,) and (m,) results.
    - `near_q`, `near_v`: (n,) projected positions and velocities.
    - `accelerations`, `solution`, `residual`, `constraint_forces`, `rows`, `constraints`, `tangents`, `projected`,
      `projected_positions`, `projected_velocities`: the kernels; each takes the time and returns a status. Velocities
      are zero in `solution`, `constraint_forces` and `constraints`.
    - `arrive`: kernel that takes the time, q, v, and the maxima (P,) of squared misalignments.
    """

    def __init__(self, workspace: Workspace):
        top, scratch = workspace.stepping_topology, workspace.scratch
        n = 3 * len(workspace.mechanism.bodies)
        self._workspace = workspace
        self._pinned = PinnedBundle(equations.new_equations(top, scratch, workspace.solver))
        address = self.address = self._pinned.address
        self.q, self.v, self.a, self.force, self.x, self.near_q, self.near_v, rest = np.zeros((8, n))
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
        both, near = (address, None, self.q, self.v, *np.zeros((2, n + 3))), (self.near_q, self.near_v)
        self.projected = RepeatedCall(nearest_state, *both, True, True, *near)
        self.projected_positions = RepeatedCall(nearest_state, *both, True, False, *near)
        self.projected_velocities = RepeatedCall(nearest_state, *both, False, True, *near)
        self.arrive = RepeatedCall(equations.arrive_at, address, None, None, None, None)

    def use_pivots(self) -> None:
        """Use the solver of the workspace, which differs after new pivots, chosen here or by the recorder.

        The address stays, because solvers have equally many arrays.
        """
        if self._pinned.bundle.solver is not self._workspace.solver:
            self._pinned.replace(self._pinned.bundle._replace(solver=self._workspace.solver))
