"""The equations of motion for methods written in NumPy: evaluation, tangents, projections and reactions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeVar, Unpack, overload

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.consistent_start import workspace_at_start
from mbdkit.engine.elimination_order import SingularSystemError, new_factors
from mbdkit.engine.evaluated_equations import EvaluatedEquations
from mbdkit.engine.iteration_matrix import (
    Coefficients,
    IterationMatrices,
    IterationMatrix,
    IterationMatrixWithStates,
    Pivots,
    StateTangents,
    coefficients_of,
    put,
    vector,
)
from mbdkit.engine.kernels import equations
from mbdkit.engine.kernels.accelerations import KKT_TOLERANCE
from mbdkit.engine.kernels.between_positions import accelerations_between
from mbdkit.engine.kernels.equations import DAMPING, GAMMA_V, JACOBIAN, RESIDUAL_Q, STIFFNESS, new_matrix
from mbdkit.engine.kernels.frames import Reactions, reactions_in_frames
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.observed_states import GivenForces, StateObserver, joint_sums
from mbdkit.engine.repeated_call import RepeatedCall
from mbdkit.engine.state_derivatives import Rates
from mbdkit.engine.tangents import SparseParts, Tangents
from mbdkit.engine.workspace import Workspace

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from mbdkit.mechanism.mechanism import Mechanism


class SolutionBetween:
    """A kernel with its storage; see `mbdkit.engine.equations_of_motion.EquationsOfMotion.solve_between`.

    - `pivots`: the pivots of the matrix. `address`: address of the `Equations` bundle. `upper`: number of the terms of
      the matrix in rows of coordinates.
    - `q`, `force`, `q_end`, `v_end`, `x`, `mu`: (n,) arguments, and (n,) and (m,) results.
    - `solve`: takes the times of both positions and the factor of the accelerations, all as floats; returns the largest
      relative residual, or ``-1 - k`` if the pivot at position k has become too small.
    """

    def __init__(self, pivots: Pivots, address: int, upper: int):
        self.pivots = pivots
        factors = new_factors(pivots.pattern, np.float64)._replace(reference=pivots.reference)
        self._pinned = PinnedBundle(new_matrix(pivots.pattern, factors, pivots.scatter))
        n, m = pivots.shape
        self.q, self.force, self.q_end, self.v_end, self.x = np.zeros((5, n))
        self.mu = np.zeros(m)
        given = (None, self.q, self.force, None, self.q_end, self.v_end, None)
        self.solve = RepeatedCall(accelerations_between, address, self._pinned.address, upper, *given, self.x, self.mu)


T = TypeVar("T")


class EquationsOfMotion(EvaluatedEquations):
    """The equations of motion of one mechanism, for use in the `step` of a method.

    ::

        M q'' + Phi_q^T lam = Q(t, q, v),      Phi(t, q) = 0,      Phi_q v + Phi_t = 0,      Phi_q q'' = gamma(t, q, v)

    Vectors are NumPy arrays without ground: q, v, a, Q are (n,) with n = 3 B (x, y, theta of each body in turn, in SI
    units and radians); multipliers and constraint rows are (m,), in the order of ``/constraints`` in the archive. Only
    the independent rows of a redundant mechanism are included; `recorded_multipliers` returns the multipliers of all
    rows. Every returned array is new. The computations are compiled; their cost is linear in the number of bodies.

    All methods raise `StepError` with the code ``singular`` if there is no unique solution, or ``not-finite`` on
    overflow. Work is counted in `counters`: an evaluation of forces or accelerations counts as an evaluation of the
    right-hand side, an evaluation of tangents as a Jacobian, and a solution with an iteration matrix as a Newton
    iteration.

    Parameters
    ----------
    workspace
        The compiled mechanism at its consistent initial state.
    z0
        (Z,) first-order states at the start, after the first samples of controllers; if left out, those of the
        mechanism before these samples.

    Attributes
    ----------
    n, m
        Number of coordinates and of constraint rows.
    bodies, constraint_names
        Names of the bodies, and of the constraint rows as ``joint.row``.
    mass : (n,) array
        Diagonal of the mass matrix M [kg, kg m^2].
    t0
        Start time [s].
    q0, v0 : (n,) arrays
        Consistent positions and velocities at the start.
    z0 : (Z,) array
        First-order states of elements (motors, controllers, force laws with states) at the start, each in its
        own unit.
    formulation, stabilization
        Name of the formulation and stabilization requested for the run. Baumgarte's terms are included in gamma, in the
        accelerations and in the tangents. Projections are performed outside `step`, by the framework.
    counters
        Counters of the work done so far.
    has_power
        Whether loads, drivers or dampers are present, so that work is done or energy is dissipated.
    first_step
        Size of the first step that the user asks for [s]; None if the method chooses it.
    longest_step
        Largest step with which an `ExternalMethod` does not miss what a function of time does [s]; infinite without
        such a limit.
    address, pairs
        Address of the data for the kernels, and number of pairs of constraint rows; for internal use.
    """

    def __init__(self, workspace: Workspace, z0: np.ndarray | None = None):
        super().__init__(workspace, z0)
        self._matrices = IterationMatrices(workspace)
        self._between: SolutionBetween | None = None
        self._derived: dict[Any, Any] = {}

    @classmethod
    def of(cls, mechanism: Mechanism, t0: float = 0.0) -> EquationsOfMotion:
        """Return the equations of motion of a mechanism at its consistent initial state, for example to test a method.

        `mechanism`: the validated mechanism. `t0`: start time [s].
        """
        return cls(workspace_at_start(mechanism, t0)[0])

    def derived(self, make: Callable[[EquationsOfMotion], T]) -> T:
        """Return ``make(self)``, computed by the first call: what a method needs of the equations and does not change.

        `make` is a class or a function of a module, by which the result is found again.
        """
        if make not in self._derived:
            self._derived[make] = make(self)
        return self._derived[make]

    def time_derivative(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> Rates:
        """Return the partial derivatives with respect to time of what `derivatives` returns, at a fixed state.

        They are differences, within the times between two discontinuities; each of their two or three evaluations is
        counted. For a mechanism without motions and laws, they are zero and cost nothing.
        """
        return self._forms.by_time(float(t), lambda at: self.derivatives(at, q, v, z))

    def jacobian(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the derivatives of (v, a, rates) with respect to (q, v, z), a (2 n + Z, 2 n + Z) array.

        The derivatives of a with respect to q and v are exact, except with friction in joints; they and all others that
        involve z are central differences. Counts as one Jacobian.
        """
        q, v, z = vector(q, self.n), vector(v, self.n), vector(z, len(self.z0))
        a, lam, _ = self._derivatives(t, q, v, z)
        self._evaluate_tangents(t, q, v, a, lam)
        try:
            jacobian = self._forms.jacobian(q, v, z, partial(self._derivatives, t))
        except np.linalg.LinAlgError:
            raise StepError("singular", "the system of equations is singular") from None
        self.hold(z)
        return jacobian

    def constraint_jacobian(self, t: float, q: np.ndarray) -> csr_array:
        """Return Phi_q, a sparse (m, n) array."""
        put(self._calls.q, q)
        self._evaluate(self._calls.constraints, t)
        return self._jacobian_part.arrays(self.terms_now)[0]

    def tangents(
        self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray, z: np.ndarray | None = None
    ) -> Tangents:
        """Return all tangents at a state with accelerations `a` (n,) and multipliers `lam` (m,).

        With first-order states `z` (Z,), later calls without `z` use these states too, and the derivatives that involve
        them are in `Tangents.states`. These are central differences.
        """
        if z is not None:
            self.hold(z)
        tangents = self._sparse_tangents(t, q, v, a, lam)
        return tangents if z is None else replace(tangents, states=self._state_tangents(t, q, v, a, lam, z))

    def evaluated_terms(self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """Return the values of all terms of the tangents at a state, in the order of the workspace's list of terms."""
        self._evaluate_tangents(t, q, v, a, lam)
        return self.terms_now.copy()

    @overload
    def iteration_matrix(
        self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray, z: None = None,
        **coefficients: Unpack[Coefficients],
    ) -> IterationMatrix: ...  # fmt: skip

    @overload
    def iteration_matrix(
        self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray, z: np.ndarray,
        **coefficients: Unpack[Coefficients],
    ) -> IterationMatrixWithStates: ...  # fmt: skip

    def iteration_matrix(
        self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray, z: np.ndarray | None = None,
        **coefficients: Unpack[Coefficients],
    ) -> IterationMatrix | IterationMatrixWithStates:  # fmt: skip
        """Return the factorized matrix of a Newton iteration.

        ::

            [ mass M + damping C + stiffness K                     Phi_q^T ]
            [ Phi_q + gamma_v gamma_v + residual_q residual_q      0       ]

        The unknowns should be scaled as accelerations and multipliers. With dv = c1 da and dq = c2 da, all formulations
        use ``damping=c1, stiffness=c2``, and in addition

        - index 3: the lower right-hand side -Phi / c2;
        - index 2: ``gamma_v=-c2 / (2 c1)`` and the lower right-hand side -(Phi_q v + Phi_t) / c1;
        - index 1: ``gamma_v=-c1, residual_q=c2``.

        Rows and columns are equilibrated.

        With first-order states `z`, the matrix has their rows and columns too, with the unknowns scaled as the rates of
        the states, dz = c1 dz': the column ``damping force_z``, and the rows
        ``[-damping rates_v - stiffness rates_q, 0, mass - damping rates_z]`` (see `StateTangents`). Its `solve` takes
        and returns a third vector (Z,), which is empty if the mechanism has no such states.

        - `t`, `q`, `v`, `a`, `lam`: time [s], state, accelerations and multipliers at which the tangents are evaluated.
        - `z`: (Z,) first-order states; if left out, the matrix has no rows for them, and those last used are held.
        - `coefficients`: `mass` (default 1), `damping`, `stiffness`, `gamma_v`, `residual_q` (default 0). The matrix is
          complex if any of them is complex.
        """
        factors = coefficients_of(coefficients)
        if z is None:
            return self._matrix(t, q, v, a, lam, factors)
        self.hold(z)
        states = self._state_tangents(t, q, v, a, lam, z)
        return IterationMatrixWithStates(self._matrix(t, q, v, a, lam, factors), states, factors, self.m)

    def solve_between(
        self, t: float, q: np.ndarray, force: np.ndarray, end: float, q_end: np.ndarray, v_end: np.ndarray, h: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the accelerations at one position that lead to consistent velocities at another one.

        ::

            M x + Phi_q(t, q)^T mu = force,      Phi_q(end, q_end) (v_end + h x) + Phi_t(end, q_end) = 0

        These are the equations of a stage of half-explicit methods (Brasey and Hairer 1993). Counts as one
        factorization.

        - `t`, `q`, `force`: time [s] and position (n,) at which the reactions act, and forces (n,).
        - `end`, `q_end`: time [s] and position (n,) of the consistent velocity.
        - `v_end`, `h`: the part of that velocity without `x` (n,), and the factor of `x` [s].

        Returns (n,) accelerations and (m,) multipliers.
        """
        if self._matrices.between is None:
            try:
                self._choose_between(self.t0, self.q0)  # so that a resumed run has the same pivots
            except StepError:
                self._choose_between(t, q)
        for is_last in (False, True):
            solution = self._solution_between()
            given = (solution.q, q), (solution.force, force), (solution.q_end, q_end), (solution.v_end, v_end)
            for storage, x in given:
                put(storage, x)
            self.counters.factorizations += 1
            worst = solution.solve(float(t), float(end), float(h))
            if 0.0 <= worst < KKT_TOLERANCE:
                break
            if not (np.isfinite(worst) and self._workspace.is_finite(tangents=False)):
                raise self._not_finite()
            if is_last:
                raise StepError("singular", "the system of equations with the Jacobians of two positions is singular")
            self._choose_between(t, q)
        return solution.x.copy(), solution.mu.copy()

    def recorded_multipliers(self, t: float, q: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """Return the multipliers (rows,) of all rows of ``/constraints``; only independent rows carry a force."""
        rows = self._workspace.mechanism.rows
        pairs = np.zeros((len(self._workspace.mechanism.topology.pairs), 2))
        equations.pair_multipliers_of(self.address, float(t), vector(q, self.n), vector(lam, self.m), pairs)
        return np.array([pairs[row.pair, row.place] for row in rows])

    def reactions(self, t: float, q: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """Return the reactions (J, 3) of the joints on their second bodies for multipliers `lam` (m,).

        A reaction is a force (x, y) and the torque at the joint point [N, N m]; impulses if the multipliers are
        impulses. Redundant joints share their reactions evenly.
        """
        workspace, times, none = self._workspace, np.array([t]), np.zeros(self.n)
        mechanism = workspace.mechanism
        found = Reactions.zeros(1, len(mechanism.topology.pairs))
        given = vector(q, self.n), none, vector(lam, self.m)
        reactions_in_frames(self.address, times, *(x[None] for x in given), found)
        reactions = found.reactions
        if len(mechanism.topology.spare):
            observer, none = StateObserver(workspace), with_ground(none)[None]
            observed = observer.arrays(1)
            forces = GivenForces(none, found.lam, found.reactions)
            states = np.zeros((1, len(mechanism.states)))
            observer.observe(times, with_ground(vector(q, self.n))[None], none, observed, forces, states)
            reactions = observed.reactions
        return joint_sums(mechanism).sum(reactions)[0]

    def relative_change(self, q: np.ndarray, dq: np.ndarray) -> float:
        """Return the largest change of a coordinate relative to the largest coordinate of the same kind.

        Lengths are compared with the largest length (at least 1 m, or the mechanism's length if that is smaller),
        angles with the largest angle (at least 1 rad). A Newton iteration has converged if the result is a few eps or
        does not decrease any more.
        """
        size, change = np.abs(q).reshape(-1, 3), np.abs(dq).reshape(-1, 3)
        lengths = change[:, :2].max() / max(min(1.0, self._workspace.mechanism.length), size[:, :2].max())
        return float(max(lengths, change[:, 2].max() / max(1.0, size[:, 2].max())))

    def _sparse_tangents(self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> Tangents:
        self._evaluate_tangents(t, q, v, a, lam)
        return Tangents(*self._tangent_parts.arrays(self.terms_now))

    def _matrix(
        self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray, factors: np.ndarray
    ) -> IterationMatrix:
        try:
            tangents = partial(self._evaluate_tangents, t, q, v, a, lam)
            return self._matrices.factorized(factors, self._evaluate_at_start, tangents, self._factorized)
        except SingularSystemError as error:
            raise self._singular(error) from None

    def _state_tangents(
        self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray, z: np.ndarray
    ) -> StateTangents:
        """Return the derivatives that involve first-order states; their evaluations are not counted."""
        q, v, z = vector(q, self.n), vector(v, self.n), vector(z, len(self.z0))
        if not len(z):
            return StateTangents(np.zeros((self.n, 0)), np.zeros((0, self.n)), np.zeros((0, self.n)), np.zeros((0, 0)))

        def residual(x: np.ndarray) -> np.ndarray:
            self.hold(x)
            return self._residual(t, q, v, a, lam)

        tangents = self._forms.tangents(q, v, z, residual, lambda *state: self._derivatives(t, *state)[2])
        self.hold(z)
        return tangents

    @cached_property
    def _jacobian_part(self) -> SparseParts:
        return SparseParts(self._workspace, [JACOBIAN])

    @cached_property
    def _tangent_parts(self) -> SparseParts:
        return SparseParts(self._workspace, [STIFFNESS, DAMPING, GAMMA_V, RESIDUAL_Q])

    def stored_pivots(self) -> list[dict[str, object]]:
        """Return the pivots of all iteration matrices used so far, as plain values for a checkpoint."""
        return self._matrices.stored()

    def restore_pivots(self, state: object) -> None:
        """Use stored pivots; raise ValueError if they are not valid."""
        self._matrices.restore(state)

    def _evaluate_at_start(self) -> None:
        self._evaluate_tangents(self.t0, self.q0, self.v0, *self.accelerations(self.t0, self.q0, self.v0))

    def _choose_between(self, t: float, q: np.ndarray) -> None:
        put(self._calls.q, q)
        self._evaluate(self._calls.constraints, t)
        try:
            self._matrices.choose_between()
        except SingularSystemError as error:
            raise self._singular(error) from None

    def _solution_between(self) -> SolutionBetween:
        pivots = self._matrices.between
        assert pivots is not None
        if self._between is None or self._between.pivots is not pivots:
            upper = np.count_nonzero(self._workspace.terms.chosen(tangents=False).row < self.n)
            self._between = SolutionBetween(pivots, self.address, int(upper))
        return self._between

    def _factorized(self, pivots: Pivots, coefficients: np.ndarray) -> IterationMatrix:
        self.counters.factorizations += 1
        return IterationMatrix(self.terms_now, pivots, coefficients, self.counters)
