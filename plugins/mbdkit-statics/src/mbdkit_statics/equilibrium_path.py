"""Static equilibria while loads and drivers change. The path is followed past points at which the mechanism snaps
through.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Unpack

import numpy as np
from scipy.optimize import brentq
from scipy.sparse import block_array, csr_array, diags_array
from scipy.sparse.linalg import splu

from mbdkit.base.errors import StepError
from mbdkit.mechanism.beams import named_body
from mbdkit.spec.loading import RunSource, Sections
from mbdkit_statics.equilibrium import joint_reactions
from mbdkit_statics.equilibrium_search import rest
from mbdkit_statics.prepared_mechanism import PreparedMechanism
from mbdkit_statics.reduced import State, distance_to_singular, least_stiffness, singular_motion
from mbdkit_statics.stability import shape_of, unstable_motions

Kind = Literal["limit point", "bifurcation", "flutter"]

#: Largest and smallest length of a step along a path; lengths are relative to the size of the mechanism, to 1 rad, and
#: to the time span.
LONGEST, FINEST = 0.05, 1e-6

#: A step is halved if the cosine of the angle between the tangents at its beginning and its end is below this.
STRAIGHT = 0.98

MOST_POINTS = 5000

#: Largest number of Newton corrections of a point, and number of corrections up to which the next step is made longer.
MOST_CORRECTIONS, EASY = 8, 4

#: Newton's method ends after the first correction that is smaller than this, because the next correction would be
#: about its square.
CONVERGED = 1e-7

#: Step of the central differences by which loads are differentiated with respect to time, as a share of the time span.
LOAD_STEP = 1e-5

LOCATED = 1e-12  #: Tolerance of the position of a critical point on the path, relative to a step along it.

#: Tolerance of the position of the onset of flutter, which is found by bisection, relative to a step along the path.
FLUTTER_LOCATED = 1e-9

#: Share of its diagonal that is added to the scaled matrix of a point if it is exactly singular, as at a bifurcation.
#:
#: The changes that the matrix determines are wrong by about this share; later corrections remove the error.
SINGULAR = 1e-9

#: Two critical points are not distinguished if their distance, relative to a step along the path, is below this.
APART = 1e-6


@dataclass(frozen=True)
class CriticalPoint:
    """A point of a path where the equilibrium loses or regains its stability along a motion.

    Attributes
    ----------
    kind
        ``limit point``: the path turns back in time, so that a mechanism under these loads snaps through to another
        equilibrium; ``bifurcation``: another path branches off, as when a straight column buckles; or ``flutter``: an
        oscillation begins, or ceases, to grow, as under follower loads.
    time
        Time at which loads and drivers are evaluated [s].
    position : (B, 3) array
        x, y [m] and angle [rad] of each body.
    body
        The body whose centre of mass moves most when the mechanism leaves the path.
    frequency
        Frequency of the oscillation if it is flutter, otherwise 0 [rad/s].
    """

    kind: Kind
    time: float
    position: np.ndarray
    body: str
    frequency: float = 0.0


@dataclass(frozen=True)
class EquilibriumPath:
    """Equilibria of a mechanism in the order of the path; see `equilibrium_path`.

    Attributes
    ----------
    time : (K,) array
        Time of each point [s]; it decreases after a limit point.
    bodies, joints
        Names of the bodies and of the joints.
    position : (K, B, 3) array
        x, y [m] and angle [rad] of each body.
    reaction_force, reaction_torque : (K, J, 2) and (K, J) arrays
        See `Equilibrium` [N, N m].
    stiffness : (K,) array
        Lowest eigenvalue of the stiffness along the degrees of freedom, for unit mass [1/s^2]; see
        `Equilibrium.stiffness`, also for equilibria that are unstable although it is positive.
    unstable : (K,) int array
        Number of independent motions along which each equilibrium is unstable; an oscillation that grows counts as two.
        For mechanisms of more than 500 bodies, 1 if there are any, or the number among the lowest motions if loads can
        supply energy.
    critical
        Points at which `unstable` changes.
    """

    time: np.ndarray
    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    position: np.ndarray
    reaction_force: np.ndarray
    reaction_torque: np.ndarray
    stiffness: np.ndarray
    unstable: np.ndarray
    critical: tuple[CriticalPoint, ...]

    def __getitem__(self, body: str) -> np.ndarray:
        """Return x, y [m] and angle [rad] of a body along the path, (K, 3)."""
        return np.asarray(self.position[:, self.bodies.index(named_body(body, self.bodies))])


def equilibrium_path(source: RunSource, **sections: Unpack[Sections]) -> EquilibriumPath:
    """Follow the static equilibrium while loads and drivers change slowly with time, from start to end.

    The path begins with the equilibrium that `equilibrium` finds at the start time. The time is treated as an unknown
    like the positions (pseudo-arclength continuation; H. B. Keller, 1977), so that the path is followed past limit
    points, where the time decreases, until it reaches the end time. A mechanism under a growing load snaps through at a
    limit point.

    Parameters
    ----------
    source
        A file name, the name of a packaged example, a mapping, a RunSpec, or a Mechanism, whose path goes from 0 to 1 s
        unless `time` is given.
    **sections
        Sections of the spec that replace those of `source`.

    Returns
    -------
    EquilibriumPath
        The equilibria, their reactions and their stability.

    Raises
    ------
    SpecError
        If the input is wrong, there is no equilibrium at the start, or the path cannot be followed to the end.

    Examples
    --------
    Two springs of length 1 m lean against each other, 0.2 m high, and are pressed down at the top:

    >>> import mbdkit
    >>> m = mbdkit.Mechanism(gravity=(0, 0))
    >>> top = m.body("top", mass=1.0, position=(0.0, 0.2))
    >>> for x in (-1, 1):
    ...     ends = {"from_": (x, 0), "to": (0, 0.2)}
    ...     m.spring_damper(f"spring {x}", m.ground, top, **ends, stiffness=1e3, free_length=1.04**0.5)
    >>> m.force("load", top, value=(0.0, "-10*t"))
    >>> path = mbdkit.equilibrium_path(m)
    >>> [(point.kind, round(point.time, 4)) for point in path.critical]
    [('limit point', 0.3018), ('limit point', -0.3018)]
    """
    prepared = PreparedMechanism.of(source, **sections)
    prepared.workspace.mechanism.refuse_states("a path of equilibria")
    with prepared.as_spec_errors():
        return _Follower(prepared).path()


@dataclass(frozen=True)
class _Point:
    """A point of the path: unknowns y, their state, tangent, and eigenvalues of unstable motions, which are nan if the
    energy decides (see `unstable_motions`).
    """

    y: np.ndarray
    at: State
    tangent: np.ndarray
    growing: np.ndarray

    @property
    def unstable(self) -> int:
        """Number of unstable motions."""
        return len(self.growing)


class _Follower:
    """Follows the path of a mechanism in steps along its tangents.

    The unknowns are the coordinates, the multipliers and the time. The square of the length of a step has two terms:
    the sum of the squared changes of the coordinates, divided by the number of bodies, and the squared change of the
    time. These changes are relative to the size of the mechanism, 1 rad, or the time span. Multipliers are not
    included.
    """

    def __init__(self, prepared: PreparedMechanism):
        self.prepared, self.p = prepared, prepared.equations
        p, time = self.p, prepared.spec.time
        self.start, self.end = time.start, time.final
        self.span = self.end - self.start
        bodies = len(p.bodies)
        size = np.tile([prepared.extent, prepared.extent, 1.0], bodies)
        self.weight = np.concatenate([1 / (bodies * size**2), np.zeros(p.m), [1 / self.span**2]])
        self.none = np.zeros(p.n)
        #: Artificial stiffness of the angles of point masses, without which the matrix would be singular.
        self.meaningless = diags_array(prepared.held.astype(float))

    def path(self) -> EquilibriumPath:
        result = rest(self.prepared)
        y = np.concatenate([result.q, result.lam, [self.start]])
        forward = np.zeros(len(y))
        forward[-1] = self.span
        points, critical, step = [self._point(y, forward)], list[CriticalPoint](), LONGEST / 4
        while points[-1].at.t < self.end:
            here = points[-1]
            there, taken, step = self._advance(here, step)
            critical += self._critical(here, there, taken)
            points.append(there if there.at.t < self.end else self._at_end(here, there))
            if len(points) > MOST_POINTS:
                raise self.prepared.error(
                    f"the path of equilibria did not reach t = {self.end:g} s in {MOST_POINTS} points; the last one "
                    f"is at t = {there.at.t:.6g} s"
                )
        return self._result(points, [one for one in critical if one.time <= self.end])

    # ---- steps -----------------------------------------------------------------------------------------------------

    def _advance(self, here: _Point, step: float) -> tuple[_Point, float, float]:
        """Return the next point, the length of the step to it, and the length to try for the step after it."""
        while True:
            try:
                there, corrections = self._at(here, step)
                if self._product(here.tangent, there.tangent) >= STRAIGHT:
                    return there, step, min(1.5 * step, LONGEST) if corrections <= EASY else step
            except (StepError, RuntimeError):
                pass
            step *= 0.5
            if step < FINEST:
                raise self.prepared.error(
                    f"the equilibrium cannot be followed beyond t = {here.at.t:.6g} s: the position there is singular"
                )

    def _at(self, here: _Point, step: float) -> tuple[_Point, int]:
        """Return the point of the path at a distance `step` along the tangent, and the number of Newton corrections."""
        y, corrections = self._corrected(here.y + step * here.tangent, here.tangent)
        return self._point(y, here.tangent), corrections

    def _at_end(self, here: _Point, there: _Point) -> _Point:
        share = (self.end - here.at.t) / (there.at.t - here.at.t)
        y = (1 - share) * here.y + share * there.y
        y[-1] = self.end
        plane = np.zeros(len(y))
        plane[-1] = self.span
        y, _ = self._corrected(y, plane)
        y[-1] = self.end
        return self._point(y, here.tangent)

    def _corrected(self, y: np.ndarray, plane: np.ndarray) -> tuple[np.ndarray, int]:
        """Return the point of the path in the plane through `y` normal to `plane`, and the number of corrections."""
        for corrections in range(1, MOST_CORRECTIONS + 1):
            change = self._solved(y, plane, np.concatenate([-self._lack(y), [0.0]]))
            y = y + change
            size = self._product(change, change) ** 0.5
            if not np.isfinite(size) or size > 2 * LONGEST:
                break
            if size < CONVERGED:
                return y, corrections
        raise StepError("newton-failed", "no point of the path was found")

    def _point(self, y: np.ndarray, forward: np.ndarray) -> _Point:
        """Return a point with its tangent, of length 1 and in the direction of `forward`."""
        across = np.zeros(len(y))
        across[-1] = 1.0
        tangent = self._solved(y, forward, across)
        tangent = tangent / self._product(tangent, tangent) ** 0.5
        at = self._at_rest(y)
        return _Point(y, at, tangent, unstable_motions(self.prepared, at))

    # ---- equations -------------------------------------------------------------------------------------------------

    def _at_rest(self, y: np.ndarray) -> State:
        n = self.p.n
        return State(float(y[-1]), y[:n], self.none, self.none, y[n:-1])

    def _lack(self, y: np.ndarray) -> np.ndarray:
        """Return the residual of the equations of statics and of the constraints, (n + m,)."""
        at = self._at_rest(y)
        return np.concatenate([self.p.residual(*at), self.p.constraints(at.t, at.q)])

    def _solved(self, y: np.ndarray, plane: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Solve the linearised equations for the changes (n + m + 1,); the last equation prescribes the change along
        `plane`.
        """
        p, delta, at = self.p, LOAD_STEP * self.span, self._at_rest(y)
        stiffness, jacobian = p.tangents(*at).stiffness, p.constraint_jacobian(at.t, at.q)
        before, after = (p.residual(at.t + sign * delta, *at[1:]) for sign in (-1, 1))
        last = csr_array((self.weight * plane)[None])
        matrix = block_array(
            [
                [stiffness + self.meaningless, jacobian.T, csr_array((after - before)[:, None] / (2 * delta))],
                [jacobian, None, csr_array(p.constraint_rates(at.t, at.q, self.none)[:, None])],
                [last[:, : p.n], last[:, p.n : -1], last[:, -1:]],
            ],
            format="csc",
        )
        try:
            return np.asarray(splu(matrix).solve(right))
        except RuntimeError:  # exactly singular: this point is a bifurcation
            size = abs(matrix).max(axis=0).toarray().ravel()
            return np.asarray(splu(matrix + SINGULAR * diags_array(size, format="csc")).solve(right))

    def _product(self, a: np.ndarray, b: np.ndarray) -> float:
        return float(np.sum(self.weight * a * b))

    # ---- critical points -------------------------------------------------------------------------------------------

    def _critical(self, here: _Point, there: _Point, step: float) -> list[CriticalPoint]:
        if here.tangent[-1] * there.tangent[-1] >= 0:
            return self._between(here, 0.0, step)
        turn = self._root(here, 0.0, step, lambda point: float(point.tangent[-1]))
        result, _ = self._at(here, turn)
        limit = self._described("limit point", result, result.tangent[: self.p.n])
        before, after = self._beside(turn, step)
        return [*self._between(here, 0.0, before), limit, *self._between(here, after, step)]

    @staticmethod
    def _beside(distance: float, step: float) -> tuple[float, float]:
        return max(distance - APART * step, 0.0), min(distance + APART * step, step)

    def _between(self, here: _Point, low: float, high: float) -> list[CriticalPoint]:
        """Return the bifurcations and points of flutter between two distances along the tangent from a point.

        The interval is halved until it contains only one of them.
        """
        first, last = (self._at(here, part)[0] if part else here for part in (low, high))
        change = abs(last.unstable - first.unstable)
        if not change:
            return []
        critical = max(first, last, key=lambda point: point.unstable).growing[-1]
        is_flutter = change == 2 and critical.imag != 0
        is_short = high - low <= APART * LONGEST
        halves = (low, 0.5 * (low + high)), (0.5 * (low + high), high)
        if is_flutter:
            return self._flutter(here, (low, first), (high, last))
        if change > 1 and not is_short:
            return [point for half in halves for point in self._between(here, *half)]
        border = singular_motion(self.prepared, last.at)
        try:
            place = self._root(here, low, high, lambda point: distance_to_singular(self.prepared, point.at, border))
        except (ValueError, RuntimeError):
            # Two bifurcations coincide, or the bordered matrix is too far from its singular state.
            if not is_short:
                return [point for half in halves for point in self._between(here, *half)]
            place = 0.5 * (low + high)
        result, _ = self._at(here, place)
        bifurcation = self._described("bifurcation", result, singular_motion(self.prepared, result.at))
        if is_short or np.isnan(critical):
            return [bifurcation]
        before, after = self._beside(place, high)  # flutter may begin in the same interval
        return [
            *(self._between(here, low, before) if before > low else []),
            bifurcation,
            *(self._between(here, after, high) if after < high else []),
        ]

    def _flutter(self, here: _Point, low: tuple[float, _Point], high: tuple[float, _Point]) -> list[CriticalPoint]:
        """Return the point between two distances, each with its point, at which an oscillation begins or ceases to
        grow.
        """
        tolerance = FLUTTER_LOCATED * (high[0] - low[0])
        while high[0] - low[0] > tolerance:
            middle = 0.5 * (low[0] + high[0])
            point, _ = self._at(here, middle)
            if point.unstable == low[1].unstable:
                low = middle, point
            elif point.unstable == high[1].unstable:
                high = middle, point
            else:
                return [*self._between(here, low[0], middle), *self._between(here, middle, high[0])]
        result = max(low[1], high[1], key=lambda point: point.unstable)
        value = complex(result.growing[-1])
        return [self._described("flutter", result, shape_of(self.prepared, result.at, value), abs(value.imag))]

    def _root(self, here: _Point, low: float, high: float, value: Callable[[_Point], float]) -> float:
        """Return the distance from a point at which a function of points of the path is zero.

        Raises
        ------
        ValueError
            If the function has the same sign at both distances.
        """

        def at(part: float) -> float:
            return value(here if part == 0 else self._at(here, part)[0])

        return float(brentq(at, low, high, xtol=LOCATED * (high - low), maxiter=10_000))

    def _described(self, kind: Kind, point: _Point, way: np.ndarray, frequency: float = 0.0) -> CriticalPoint:
        parts = way[: self.p.n].reshape(-1, 3)[:, :2]
        most = int(np.argmax(np.einsum("bx,bx->b", parts, parts)))
        return CriticalPoint(kind, point.at.t, point.at.q.reshape(-1, 3), self.p.bodies[most], frequency)

    def _result(self, points: list[_Point], critical: list[CriticalPoint]) -> EquilibriumPath:
        p, prepared, states = self.p, self.prepared, [point.at for point in points]
        recorded = [(x.t, x.q, p.recorded_multipliers(x.t, x.q, x.lam)) for x in states]
        reactions = [joint_reactions(prepared, *multipliers) for multipliers in recorded]
        return EquilibriumPath(
            time=np.array([x.t for x in states]),
            bodies=p.bodies,
            joints=prepared.workspace.mechanism.joints,
            position=np.array([x.q.reshape(-1, 3) for x in states]),
            reaction_force=np.array([force for force, _ in reactions]),
            reaction_torque=np.array([torque for _, torque in reactions]),
            stiffness=np.array([least_stiffness(prepared, x) if prepared.freedoms else np.nan for x in states]),
            unstable=np.array([x.unstable for x in points]),
            critical=tuple(critical),
        )
