"""The equations of motion for methods written in NumPy: evaluation, tangents and solution, with work counters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypedDict, Unpack, cast

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.consistent_start import workspace_at_start
from mbdkit.engine.contact_forces import ActingContact
from mbdkit.engine.counters import Counters
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.iteration_matrix import IterationMatrix, Pivots, chosen_pivots, classes_of, vector
from mbdkit.engine.joint_sums import joint_sums
from mbdkit.engine.kernels import equations
from mbdkit.engine.kernels.equations import MASS
from mbdkit.engine.kernels.frames import Reactions, reactions_in_frames
from mbdkit.engine.kernels.observe import baumgarte_at
from mbdkit.engine.kernels.system import NOT_FINITE, OK
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.nearest_state import nearest_positions, nearest_velocities
from mbdkit.engine.observed_states import GivenForces, StateObserver
from mbdkit.engine.stored_arrays import pattern_of, restore, stored
from mbdkit.engine.workspace import Workspace

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from mbdkit.mechanism.mechanism import Mechanism


@dataclass(frozen=True)
class Tangents:
    """Derivatives of the equations of motion for implicit methods, as sparse arrays."""

    stiffness: csr_array
    """(n, n) K = d(Phi_q^T lam - Q)/dq."""
    damping: csr_array
    """(n, n) C = -dQ/dv."""
    gamma_v: csr_array
    """(m, n) d gamma/dv = -2 d(Phi_q v + Phi_t)/dq, minus 2 alpha Phi_q with Baumgarte's terms."""
    residual_q: csr_array
    """(m, n) d(Phi_q a - gamma)/dq."""


class Coefficients(TypedDict, total=False):
    """Coefficients of the tangents in `EquationsOfMotion.iteration_matrix`."""

    mass: complex
    damping: complex
    stiffness: complex
    gamma_v: complex
    residual_q: complex


_DEFAULTS: dict[str, complex] = {"mass": 1.0, "damping": 0.0, "stiffness": 0.0, "gamma_v": 0.0, "residual_q": 0.0}


class EquationsOfMotion:
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
    formulation, stabilization
        Name of the formulation and stabilization requested for the run. Baumgarte's terms are included in gamma, in the
        accelerations and in the tangents. Projections are performed outside `step`, by the framework.
    counters
        Counters of the work done so far.
    address
        Address of the data for the kernels; for internal use.
    """

    def __init__(self, workspace: Workspace):
        mechanism = workspace.mechanism
        self._workspace = workspace
        top, scratch = workspace.stepping_topology, workspace.scratch
        self._pinned = PinnedBundle(equations.new_equations(top, scratch, workspace.solver))
        self.address = self._pinned.address
        self.n, self.m = 3 * len(mechanism.bodies), len(mechanism.solved_rows)
        self.bodies = mechanism.bodies
        self.constraint_names = tuple(row.label for row in mechanism.solved_rows)
        self.formulation, self.stabilization = workspace.formulation, workspace.stabilization
        self.mass = mechanism.topology.mass[:-1].ravel()  # a view of the array that the kernels read
        self.t0, self.q0, self.v0 = workspace.t0, workspace.q0[: self.n].copy(), workspace.v0[: self.n].copy()
        for array in (self.mass, self.q0, self.v0):
            array.flags.writeable = False
        self.counters = Counters()
        self._no_force, self._no_rows = np.zeros(self.n), np.zeros(self.m)
        self._classes = classes_of(workspace)
        self._pivots: dict[tuple[bool, ...], Pivots] = {}

    @classmethod
    def of(cls, mechanism: Mechanism, t0: float = 0.0) -> EquationsOfMotion:
        """Return the equations of motion of a mechanism at its consistent initial state, for example to test a method.

        Parameters
        ----------
        mechanism
            The validated mechanism.
        t0
            Start time [s].
        """
        return cls(workspace_at_start(mechanism, t0)[0])

    @property
    def length(self) -> float:
        """Characteristic length of the mechanism [m]."""
        return self._workspace.mechanism.length

    def free_now(self) -> np.ndarray:
        """Return for each body (B,) whether only rigid contacts couple it to others, according to the last tangents.

        Such a body has no joint, and no force on it, except those of rigid contacts, depends on a position or velocity.
        """
        terms = self._workspace.terms
        coupled = (self._classes != MASS) & (self.terms_now[terms.source] != 0.0)
        free = np.ones(self.n // 3, dtype=bool)
        for places in (terms.row[coupled], terms.column[coupled]):
            free[places[places < self.n] // 3] = False
        return free

    def hold(self, z: np.ndarray) -> None:
        """Use the values `z` (Z,) of first-order states in later evaluations."""
        self._workspace.take_states(z)

    @property
    def contacts(self) -> tuple[ActingContact, ...]:
        """Rigid contacts. The methods of this class include the forces of compliant contacts, but not those of rigid
        ones.
        """
        return tuple(one for one in self._workspace.mechanism.contacts if one.first_state >= 0)

    @property
    def terms_now(self) -> np.ndarray:
        """Values of all terms of the tangents at the last evaluation."""
        return self._workspace.scratch.source

    def accelerations(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the index-1 accelerations (n,) and multipliers (m,) at a state."""
        self.counters.rhs_evaluations += 1
        return self._solved(t, q, v, False, self._no_force, self._no_rows)

    def solve(self, t: float, q: np.ndarray, force: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve ``M x + Phi_q^T mu = force``, ``Phi_q x = rows`` at the position `q`.

        Parameters
        ----------
        t, q
            Time [s] and position (n,).
        force, rows
            (n,) and (m,) right-hand sides.

        Returns
        -------
        x, mu
            (n,) and (m,) solution.
        """
        return self._solved(t, q, self._no_force, True, vector(force, self.n), vector(rows, self.m))

    def forces(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the generalized applied forces Q (n,), gravity included."""
        return 0.0 - self.residual(t, q, v, self._no_force, self._no_rows)

    def residual(self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """Return the residual of the equations of motion, ``M a + Phi_q^T lam - Q(t, q, v)`` (n,)."""
        self.counters.rhs_evaluations += 1
        return self._residual(t, q, v, a, lam, with_forces=True)

    def constraint_forces(self, t: float, q: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """Return ``Phi_q^T lam`` (n,)."""
        return self._residual(t, q, self._no_force, self._no_force, lam, with_forces=False)

    def constraints(self, t: float, q: np.ndarray) -> np.ndarray:
        """Return Phi (m,) [m, rad]."""
        return self._rows(t, q, self._no_force)[0]

    def constraint_rates(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the time derivative of the constraints, ``Phi_q v + Phi_t`` (m,) [m/s, rad/s]."""
        return self._rows(t, q, v)[1]

    def gamma(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the right-hand side of ``Phi_q a = gamma`` (m,) [m/s^2, rad/s^2], Baumgarte's terms included."""
        return self._rows(t, q, v)[2]

    def constraint_jacobian(self, t: float, q: np.ndarray) -> csr_array:
        """Return Phi_q, a sparse (m, n) array."""
        self._rows(t, q, self._no_force)
        terms, n = self._workspace.terms, self.n
        return self._sparse((terms.factor == 0) & (terms.row >= n), below=True)

    def tangents(self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> Tangents:
        """Return all tangents at a state with accelerations `a` (n,) and multipliers `lam` (m,)."""
        self._evaluate_tangents(t, q, v, a, lam)
        classes = self._classes
        return Tangents(
            stiffness=self._sparse(classes == equations.STIFFNESS),
            damping=self._sparse(classes == equations.DAMPING),
            gamma_v=self._sparse(classes == equations.GAMMA_V, below=True),
            residual_q=self._sparse(classes == equations.RESIDUAL_Q, below=True),
        )

    def evaluated_terms(self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """Return the values of all terms of the tangents at a state, in the order of the workspace's list of terms."""
        self._evaluate_tangents(t, q, v, a, lam)
        return self.terms_now.copy()

    def iteration_matrix(
        self,
        t: float,
        q: np.ndarray,
        v: np.ndarray,
        a: np.ndarray,
        lam: np.ndarray,
        **coefficients: Unpack[Coefficients],
    ) -> IterationMatrix:
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

        Parameters
        ----------
        t, q, v, a, lam
            Time [s], state, accelerations and multipliers at which the tangents are evaluated.
        coefficients
            `mass` (default 1), `damping`, `stiffness`, `gamma_v`, `residual_q` (default 0). The matrix is complex if
            any of them is complex.
        """
        given = {**_DEFAULTS, **cast("dict[str, complex]", coefficients)}
        if unknown := given.keys() - _DEFAULTS.keys():
            raise TypeError(f"iteration_matrix() got an unexpected keyword argument {min(unknown)!r}")
        dtype = complex if any(isinstance(x, complex) for x in given.values()) else float
        factors = np.array([given.pop("mass"), 1.0, *given.values()], dtype=dtype)
        key = (dtype is complex, *(factors != 0).tolist())
        if key not in self._pivots:
            self._choose_at_start(key, factors)
        self._evaluate_tangents(t, q, v, a, lam)
        if key in self._pivots:
            matrix = self._factorized(key, factors)
            if matrix.failed_at < 0:
                return matrix
        try:
            self._pivots[key] = chosen_pivots(self._workspace, self._classes, factors)
        except SingularSystemError as error:
            raise self._singular(error) from None
        matrix = self._factorized(key, factors)
        if matrix.failed_at >= 0:
            raise self._singular(matrix.lost())
        return matrix

    def project_positions(self, t: float, q: np.ndarray) -> np.ndarray:
        """Return the positions (n,) nearest to `q` in the mass metric that satisfy all constraints at time `t`.

        Solves ``M (p - q) + Phi_q(p)^T mu = 0``, ``Phi(t, p) = 0`` to round-off; counts as one projection.
        """
        self.counters.projections += 1
        return nearest_positions(self, t, vector(q, self.n))

    def project_velocities(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the velocities (n,) nearest to `v` in the mass metric with ``Phi_q v + Phi_t = 0`` at `t`, `q`.

        The equations are linear; a second solve removes the rounding error of the first. Counts as one projection.
        """
        self.counters.projections += 1
        return nearest_velocities(self, t, vector(q, self.n), vector(v, self.n))

    def baumgarte_terms(self, t: float, q: np.ndarray, v: np.ndarray) -> float:
        """Return the largest of Baumgarte's terms ``2 alpha Phi' + beta^2 Phi`` at a state [m/s^2, rad/s^2]."""
        state = (with_ground(vector(x, self.n)) for x in (q, v))
        return float(baumgarte_at(self._workspace.stepping_engine, float(t), *state))

    def powers(self, t: float, q: np.ndarray, v: np.ndarray, lam: np.ndarray) -> tuple[float, float]:
        """Return the power of loads and drivers and the dissipated power at a state with multipliers `lam` [W]."""
        q, v, lam = vector(q, self.n), vector(v, self.n), vector(lam, self.m)
        work, lost = equations.powers_of(self.address, float(t), q, v, lam)
        return work, lost

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

    def arrive(self, t: float, q: np.ndarray, v: np.ndarray, worst: np.ndarray) -> bool:
        """Update the maxima `worst` (P,) by the squared misalignments at a state; return whether q and v are finite."""
        finite: bool = equations.arrive_at(self.address, float(t), vector(q, self.n), vector(v, self.n), worst)
        return finite

    def _solved(
        self, t: float, q: np.ndarray, v: np.ndarray, given: bool, force: np.ndarray, rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve a system with the index-1 matrix; choose new pivots if the current ones fail."""
        x, mu = np.empty(self.n), np.empty(self.m)
        state = float(t), vector(q, self.n), vector(v, self.n)
        workspace = self._workspace

        def solve() -> int:
            self.counters.factorizations += 1
            # The solvers differ if the workspace has new pivots, chosen here or by the recorder.
            if self._pinned.bundle.solver is not workspace.solver:
                self._pinned.replace(self._pinned.bundle._replace(solver=workspace.solver))
                self.address = self._pinned.address
            return int(equations.solution_of(self.address, *state, given, force, rows, x, mu))

        try:
            status = workspace.retry_with_new_pivots(solve)
        except SingularSystemError as error:
            raise self._singular(error) from None
        if status == OK:
            return x, mu
        if status == NOT_FINITE or not workspace.is_finite(tangents=False):
            raise self._not_finite()
        raise self._singular(SingularSystemError(workspace.failed_unknown))

    def _residual(
        self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray, *, with_forces: bool
    ) -> np.ndarray:
        out = np.empty(self.n)
        q, v, a = vector(q, self.n), vector(v, self.n), vector(a, self.n)
        if equations.residual_of(self.address, float(t), q, v, a, vector(lam, self.m), with_forces, out) != OK:
            raise self._not_finite()
        return out

    def _rows(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return Phi, its rate and gamma, each (m,)."""
        phi, rate, gamma = np.empty(self.m), np.empty(self.m), np.empty(self.m)
        if equations.rows_of(self.address, float(t), vector(q, self.n), vector(v, self.n), phi, rate, gamma) != OK:
            raise self._not_finite()
        return phi, rate, gamma

    def _evaluate_tangents(self, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, lam: np.ndarray) -> None:
        self.counters.jacobian_evaluations += 1
        q, v, a = vector(q, self.n), vector(v, self.n), vector(a, self.n)
        if equations.tangents_of(self.address, float(t), q, v, a, vector(lam, self.m)) != OK:
            raise self._not_finite()

    def _sparse(self, keep: np.ndarray, *, below: bool = False) -> csr_array:
        """Return the sum of the selected terms of the last evaluation, (n, n), or (m, n) if they are `below` row n."""
        from scipy.sparse import csr_array

        terms = self._workspace.terms.kept(keep)
        values = self._workspace.scratch.source[terms.source]
        row, rows = (terms.row - self.n, self.m) if below else (terms.row, self.n)
        return csr_array((values, (row, terms.column)), shape=(rows, self.n))

    def stored_pivots(self) -> list[dict[str, Any]]:
        """Return the pivots of all iteration matrices used so far, as plain values for a checkpoint."""
        return [
            {"matrix": list(key), "pattern": stored(one.pattern), "scatter": one.scatter, "reference": one.reference}
            for key, one in self._pivots.items()
        ]

    def restore_pivots(self, state: Any) -> None:
        """Use stored pivots; raise ValueError if they are not valid."""
        unknowns, sources = self._workspace.unknowns, len(self._workspace.scratch.source)
        for one in state:
            pattern = pattern_of(one["pattern"], unknowns)
            scatter, reference = np.zeros((len(one["scatter"]), 3), np.int64), np.zeros(len(pattern.row_of))
            restore(
                {"scatter": scatter, "reference": reference}, {name: one[name] for name in ("scatter", "reference")}
            )
            if np.any(scatter >= [sources, len(pattern.a_column), len(_DEFAULTS) + 1]):
                raise ValueError("a term of a matrix does not exist")
            key = tuple(map(bool, one["matrix"]))
            self._pivots[key] = Pivots((self.n, unknowns - self.n), pattern, scatter, reference)

    def _choose_at_start(self, key: tuple[bool, ...], coefficients: np.ndarray) -> None:
        """Choose pivots from the values at the start, if possible.

        This choice does not depend on where the run was interrupted, so that a resumed run has the same
        pivots as an uninterrupted one.
        """
        try:
            a, lam = self.accelerations(self.t0, self.q0, self.v0)
            self._evaluate_tangents(self.t0, self.q0, self.v0, a, lam)
            self._pivots[key] = chosen_pivots(self._workspace, self._classes, coefficients)
        except (StepError, SingularSystemError):
            return
        self._factorized(key, coefficients)

    def _factorized(self, key: tuple[bool, ...], coefficients: np.ndarray) -> IterationMatrix:
        self.counters.factorizations += 1
        return IterationMatrix(self.terms_now, self._pivots[key], coefficients, self.counters)

    def _singular(self, error: SingularSystemError) -> StepError:
        name = self._workspace.mechanism.unknown_name(error.index)
        return StepError("singular", f"the system of equations is singular at {name}")

    def _not_finite(self) -> StepError:
        return StepError(self._workspace.cause, self._workspace.unusable() or "numbers overflowed")
