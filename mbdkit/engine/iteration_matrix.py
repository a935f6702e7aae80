"""Factorized sparse matrix of a Newton iteration; its pivots are reused in later factorizations."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypedDict, cast

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.base.frozen import dataclass, field
from mbdkit.engine.elimination_order import SingularSystemError, empty_pattern, new_factors
from mbdkit.engine.kernels.accelerations import KKT_TOLERANCE
from mbdkit.engine.kernels.equations import (
    DAMPING,
    GAMMA_V,
    JACOBIAN,
    MASS,
    RESIDUAL_Q,
    STIFFNESS,
    factorize_complex,
    factorize_real,
    new_matrix,
    solve_complex,
    solve_real,
)
from mbdkit.engine.kernels.lu import Pattern
from mbdkit.engine.kernels.observe import tangents_at
from mbdkit.engine.linear_systems import inverse_of, product
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.repeated_call import RepeatedCall
from mbdkit.engine.stored_arrays import pattern_of, restore, stored
from mbdkit.engine.workspace import Workspace

if TYPE_CHECKING:
    from mbdkit.engine.counters import Counters

REAL, COMPLEX = np.dtype(float), np.dtype(complex)


class Coefficients(TypedDict, total=False):
    """Coefficients of the tangents in `EquationsOfMotion.iteration_matrix`."""

    mass: complex
    damping: complex
    stiffness: complex
    gamma_v: complex
    residual_q: complex


_DEFAULTS: dict[str, complex] = {"mass": 1.0, "damping": 0.0, "stiffness": 0.0, "gamma_v": 0.0, "residual_q": 0.0}


def coefficients_of(given: Coefficients) -> np.ndarray:
    """Return the coefficients (6,) of all classes of terms; raise TypeError if there is no coefficient of that name."""
    known = {**_DEFAULTS, **cast("dict[str, complex]", given)}
    if unknown := known.keys() - _DEFAULTS.keys():
        raise TypeError(f"iteration_matrix() got an unexpected keyword argument {min(unknown)!r}")
    dtype = complex if any(isinstance(x, complex) for x in known.values()) else float
    return np.array([known.pop("mass"), 1.0, *known.values()], dtype=dtype)


def vector(x: np.ndarray, size: int, dtype: np.dtype = REAL) -> np.ndarray:
    """Return `x` as a contiguous vector of the given dtype; raise ValueError unless its shape is ``(size,)``."""
    if type(x) is np.ndarray and x.dtype is dtype and x.flags.carray and x.shape == (size,):
        return x
    array: np.ndarray = np.array(x, dtype=dtype)
    if array.shape != (size,):
        raise ValueError(f"expected an array of shape ({size},), got shape {array.shape}")
    return array


def put(storage: np.ndarray, x: np.ndarray) -> None:
    """Copy the vector `x` to `storage`; raise ValueError unless their shapes are equal."""
    storage[:] = x if type(x) is np.ndarray and x.shape == storage.shape else vector(x, len(storage), storage.dtype)


def classes_of(workspace: Workspace) -> np.ndarray:
    """Return the class of each matrix term of a workspace: M, Phi_q, C, K, gamma_v or residual_q."""
    terms, n = workspace.terms, 3 * len(workspace.mechanism.bodies)
    plain = np.where(terms.source < n, MASS, JACOBIAN)
    level = np.where(terms.row < n, STIFFNESS, RESIDUAL_Q)
    return np.choose(terms.factor, [plain, np.full_like(plain, DAMPING), np.full_like(plain, GAMMA_V), level])


def _restored(state: Any, workspace: Workspace) -> tuple[Pattern, np.ndarray, np.ndarray]:
    """Return stored pattern, scatter and reference of `Pivots`; raise ValueError if they are not valid."""
    pattern = pattern_of(state["pattern"], workspace.unknowns)
    scatter, reference = np.zeros((len(state["scatter"]), 3), np.int64), np.zeros(len(pattern.row_of))
    restore({"scatter": scatter, "reference": reference}, {name: state[name] for name in ("scatter", "reference")})
    if np.any(scatter >= [len(workspace.scratch.source), len(pattern.a_column), len(_DEFAULTS) + 1]):
        raise ValueError("a term of a matrix does not exist")
    return pattern, scatter, reference


@dataclass
class Pivots:
    """Pivots for all matrices whose terms have the same classes, and storage for these matrices."""

    shape: tuple[int, int]  #: Numbers of coordinates and of multipliers, (n, m).
    pattern: Pattern
    scatter: np.ndarray
    reference: np.ndarray  #: (n + m,) sizes of the pivots when they were chosen.
    free: list[Storage] = field(default_factory=list)  #: Storage of matrices that are no longer in use.

    def take(self, dtype: np.dtype) -> Storage:
        """Return storage for a matrix, reusing that of an earlier one if possible."""
        return self.free.pop() if self.free else Storage(self, dtype)


class Storage:
    """Storage for a matrix and for the vectors of its solution, with the kernels that use them.

    `force`, `rows`, `x`, `mu`: (n,) and (m,) right-hand side and solution. `factorize`: takes the values of all terms
    and the coefficients; see `factorize_real`. `solve`: solves the system and returns the largest relative residual.
    """

    def __init__(self, pivots: Pivots, dtype: np.dtype):
        factors = new_factors(pivots.pattern, dtype.type)._replace(reference=pivots.reference)
        self._pinned = PinnedBundle(new_matrix(pivots.pattern, factors, pivots.scatter))
        n, m = pivots.shape
        self.force, self.x, self.rows, self.mu = (np.zeros(size, dtype) for size in (n, n, m, m))
        factorize, solve = (factorize_real, solve_real) if dtype == REAL else (factorize_complex, solve_complex)
        address = self._pinned.address
        self.factorize = RepeatedCall(factorize, None, address, None)
        self.solve = RepeatedCall(solve, address, self.force, self.rows, self.x, self.mu)


INDEX_1_MATRIX = coefficients_of({})  #: Coefficients of the matrix of the index-1 system.


def chosen_pivots(workspace: Workspace, classes: np.ndarray, coefficients: np.ndarray) -> Pivots:
    """Choose pivots for the tangents of the last evaluation; raise SingularSystemError if the matrix is singular."""
    used = coefficients[classes] != 0
    terms = workspace.terms.kept(used)
    pattern, position = workspace.pivots_of(terms, coefficients[classes[used]])
    scatter = np.column_stack([terms.source, position, classes[used]]).astype(np.int64)
    n = 3 * len(workspace.mechanism.bodies)
    scatter = scatter[np.argsort(terms.row >= n, kind="stable")]  # as `SolutionBetween` needs them
    return Pivots((n, workspace.unknowns - n), pattern, scatter, np.zeros(len(pattern.row_of)))


class IterationMatrix:
    """A factorized matrix, created by `EquationsOfMotion.iteration_matrix`.

    It does not change when other states or matrices are evaluated.
    """

    def __init__(self, source: np.ndarray, pivots: Pivots, coefficients: np.ndarray, counters: Counters):
        """Factorize a matrix; `source` holds the values of all terms, and `counters` counts the solves."""
        self._pivots, self._counters = pivots, counters
        self._storage = pivots.take(coefficients.dtype)
        #: Position of the pivot at which the factorization failed, -1 if none.
        self.failed_at: int = self._storage.factorize(source, coefficients)

    def __del__(self) -> None:
        self._pivots.free.append(self._storage)

    def solve(self, force: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve the system, with one step of refinement; counts as one Newton iteration.

        `force`: (n,) upper right-hand side, in the order of the coordinates. `rows`: (m,) lower right-hand side, in the
        order of the constraints. Returns the changes of the coordinates and of the multipliers. Raises StepError if
        the right-hand side is not finite, or if the matrix is so close to singular that a residual remains.
        """
        storage = self._storage
        put(storage.force, force)
        put(storage.rows, rows)
        self._counters.newton_iterations += 1
        if not storage.solve() < KKT_TOLERANCE:
            if not (np.all(np.isfinite(force)) and np.all(np.isfinite(rows))):
                raise StepError("not-finite", "the right-hand side of an iteration is not finite")
            raise StepError("singular", "the matrix of the iteration is too close to singular")
        return storage.x.copy(), storage.mu.copy()

    def lost(self) -> SingularSystemError:
        """Return the error that names the unknown at which the factorization failed."""
        return SingularSystemError(int(self._pivots.pattern.column_of[self.failed_at]))


@dataclass(frozen=True)
class StateTangents:
    """Derivatives that involve the first-order states z of elements, as dense arrays."""

    force_z: np.ndarray  #: (n, Z) -dQ/dz.
    rates_q: np.ndarray  #: (Z, n) derivatives of the rates z' with respect to positions.
    rates_v: np.ndarray  #: (Z, n) the same with respect to velocities.
    rates_z: np.ndarray  #: (Z, Z) the same with respect to the states.


class IterationMatrixWithStates:
    """A factorized matrix with the rows and columns of first-order states, eliminated by their Schur complement.

    ::

        [ A                                                    damping force_z      ]   A: the matrix without states
        [ -damping rates_v - stiffness rates_q,  0             mass - damping rates_z ]

    `matrix`: the factorized matrix A. `states`: derivatives that involve the states. `coefficients`: (6,) coefficients;
    see `coefficients_of`. `m`: number of multipliers.
    """

    def __init__(self, matrix: IterationMatrix, states: StateTangents, coefficients: np.ndarray, m: int):
        mass, _, damping, stiffness, _, _ = coefficients
        self._matrix, self._lower = matrix, damping * states.rates_v + stiffness * states.rates_q
        count, none = len(states.rates_z), np.zeros(m)
        columns = [matrix.solve(column, none) for column in damping * states.force_z.T]
        self._x = np.array([x for x, _ in columns]).reshape(count, states.rates_q.shape[1])
        self._mu = np.array([mu for _, mu in columns]).reshape(count, m)
        complement = mass * np.eye(count) - damping * states.rates_z + product(self._lower, self._x.T)
        try:
            self._inverse = inverse_of(complement)
        except np.linalg.LinAlgError:
            raise StepError("singular", "the matrix of the iteration is singular") from None

    def solve(self, force: np.ndarray, rows: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, ...]:
        """Solve the system; counts as one Newton iteration.

        `force`, `rows`: (n,) and (m,) right-hand sides; see `IterationMatrix.solve`. `rates`: (Z,) right-hand side of
        the rows of the states. Returns (n,) change of the coordinates, (m,) of the multipliers and (Z,) of the states.
        Raises StepError: see `IterationMatrix.solve`.
        """
        x, mu = self._matrix.solve(force, rows)
        r = product(self._inverse, rates + product(self._lower, x))
        return x - product(self._x.T, r), mu - product(self._mu.T, r), r


class IterationMatrices:
    """The iteration matrices of one mechanism, and the pivots for each choice of coefficients that are not zero.

    `workspace`: the workspace that evaluates the terms of the matrices. `classes`: class of each term; see
    `classes_of`.
    """

    def __init__(self, workspace: Workspace):
        self._workspace, self.classes = workspace, classes_of(workspace)
        self._pivots: dict[tuple[bool, ...], Pivots] = {}

    @property
    def between(self) -> Pivots | None:
        """Pivots of solutions with the Jacobians of two positions, if they have been chosen."""
        return self._pivots.get(())

    def choose_between(self) -> None:
        """Choose these pivots for the terms last evaluated; raises SingularSystemError."""
        self._pivots[()] = chosen_pivots(self._workspace, self.classes, INDEX_1_MATRIX)

    def factorized(
        self,
        coefficients: np.ndarray,
        evaluate_at_start: Callable[[], None],
        evaluate: Callable[[], None],
        factorize: Callable[[Pivots, np.ndarray], IterationMatrix],
    ) -> IterationMatrix:
        """Return a factorized matrix.

        The first pivots are chosen from the values at the start, if possible. This choice does not depend on where the
        run was interrupted, so that a resumed run has the same pivots as an uninterrupted one.

        `coefficients`: (6,) coefficient of each class of terms, real or complex. `evaluate_at_start`, `evaluate`:
        functions that evaluate the terms at the start, and where the matrix is wanted. `factorize`: function that
        factorizes the terms last evaluated, for given pivots and coefficients. Raises SingularSystemError if the matrix
        is singular.
        """
        key = (coefficients.dtype == COMPLEX, *(coefficients != 0).tolist())
        if key not in self._pivots:
            try:
                evaluate_at_start()
                self._pivots[key] = chosen_pivots(self._workspace, self.classes, coefficients)
            except (StepError, SingularSystemError):
                pass
            else:
                factorize(self._pivots[key], coefficients)
        evaluate()
        if key in self._pivots:
            matrix = factorize(self._pivots[key], coefficients)
            if matrix.failed_at < 0:
                return matrix
        self._pivots[key] = chosen_pivots(self._workspace, self.classes, coefficients)
        matrix = factorize(self._pivots[key], coefficients)
        if matrix.failed_at >= 0:
            raise matrix.lost()
        return matrix

    def stored(self) -> list[dict[str, object]]:
        """Return all pivots as plain values for a checkpoint."""
        return [
            {
                "matrix": list(key),
                "pattern": stored(pivots.pattern),
                "scatter": pivots.scatter,
                "reference": pivots.reference,
            }
            for key, pivots in self._pivots.items()
        ]

    def restore(self, state: Any) -> None:
        """Use stored pivots; raise ValueError if they are not valid."""
        n = 3 * len(self._workspace.mechanism.bodies)
        for entry in state:
            pivots = Pivots((n, self._workspace.unknowns - n), *_restored(entry, self._workspace))
            self._pivots[tuple(map(bool, entry["matrix"]))] = pivots


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
        pattern, scatter, reference = _restored(state, self._workspace)
        self._use(pattern, scatter, reference=reference)
