"""Direct collocation of optimal control: a motion becomes the solution of a nonlinear program.

The unknowns are the positions, velocities, accelerations, multipliers, first-order states and controls at the
collocation points of all intervals, the state at the start, the durations of the phases and the parameters. Both the
constraints and their rates are zero at every point; multipliers mu make this possible (C. W. Gear, B. Leimkuhler and G.
K. Gupta, Journal of Computational and Applied Mathematics 12-13:77-90, 1985):

    q' = v + Phi_q^T mu,      v' = a,      M a + Phi_q^T lam = Q,      Phi = 0,      Phi_q v + Phi_t = 0

With Radau IIA, the end of an interval is its last point. With Gauss, the state there follows from the collocation,
q- and v-. It violates nonlinear constraints by the error of the interval, and is projected onto them, without which the
method would lose its order (U. M. Ascher and L. R. Petzold, SIAM Journal on Numerical Analysis 28:1097-1120, 1991):

    q = q- + Phi_q^T nu,      M v = M v- + Phi_q^T kappa,      Phi = 0,      Phi_q v + Phi_t = 0

States are continuous from phase to phase, because the end of an interval is the start of the next one.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from importlib import import_module
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.mechanism.values import curve_of
from mbdkit.methods import gauss, radau_iia
from mbdkit_predict.casadi_system import CasadiSystem, StatesInEquilibrium
from mbdkit_predict.grid import IntervalGrid, breaks_of, weights
from mbdkit_predict.guessed_motion import GuessedMotion, archived_motion, solved_motion
from mbdkit_predict.nonlinear_program import MOST_ITERATIONS, NonlinearProgram, ProgramCondition, Solution, solve_pose
from mbdkit_predict.objective import Objective
from mbdkit_predict.point_functions import OF_POINTS, OF_STATE, Held, PointFunctions, at_node
from mbdkit_predict.point_hessian import PointHessian, PointJacobian
from mbdkit_predict.predict_spec import NOTHING, ROUNDING, PathCondition, PredictSpec, Variable
from mbdkit_predict.processes import Stop, results_of

#: Parts into which intervals are divided, and those in which controls or accelerations are discontinuous.
CUTS = 2, 8
#: Intervals are divided into more parts if jumps at their ends are larger than this multiple of the median.
UNEVEN = 10.0
MOTION, COLLOCATION, ENDS = "the equations of motion", "the collocation", "the collocation at the ends of intervals"
JOINTS = "the joints at the ends of intervals"  #: Names of conditions.
OF_SPEC = "u", "p", "duration"  #: Unknowns that a spec asks for.
#: Weight of violations of conditions at the start, which others hardly are to blame for; see `nearest_violations`.
WEIGHT_OF_START = 10.0
MANY_POINTS = {"radau": 7, "gauss": 5}  #: Collocation points of meshes on which the search begins anew.
FEWEST = 4  #: Least number of intervals of a part of a phase.
SHORTEST = 1e-6  #: Shortest part, as a share of the longest duration of its phase.
OF_BODIES = ("x", "y", "angle"), ("vx", "vy", "angular_velocity")  #: Coordinates and velocities of bodies.
BETWEEN = 7  #: Times within each interval at which joints are looked at.
SMALL = 1e-3  #: Smaller objectives are multiplied for the optimizer, which scales large ones itself.
MOST_UNEVEN = 0.125  #: Largest share of such intervals.
#: Change of controls and numbers, relative to their natural sizes, and of durations [s], which counts as none.
UNMOVED = 1e-9
SLACK = 1e-11  #: Slack of the conditions of a pose at an extreme of a coordinate, such as the top of a swing.
WORTH_THREADS = 1e6  #: Operations of a function at all points from which they take longer than threads do to start.
NEARBY = 0.01  #: Distance of a second guess from a stationary one, relative to natural sizes.


@dataclass(frozen=True)
class Mesh:
    """A solution, or a first guess, on a grid."""

    grid: IntervalGrid
    #: Arrays of the unknowns by name: ``q``, ``v``, ``a``, ``lam``, ``mu``, ``z``, ``u`` have a column for each of the
    #: N s points; ``start`` (2 n + Z,) is the state at the start, ``nodes`` are those at the ends of intervals, if
    #: these are no points, and ``jumps`` (2 m, N) the multipliers nu and kappa there; ``duration`` (P,) and ``p``.
    values: Mapping[str, np.ndarray]
    iterations: int = 0  #: Number of iterations of the optimizer, on this mesh and those before.
    solution: Solution | None = None  #: What the optimizer returned; None for a guess.
    #: Indices of points by name of the conditions of a solution, as in `NonlinearProgram.points`.
    conditions: Mapping[str, np.ndarray] = field(default_factory=dict)
    #: Of a guess from a coarser mesh: estimates of `Solution.slopes`, with columns for all points.
    slopes: Mapping[str, np.ndarray] | None = None
    size: float = 1.0  #: Natural size of the objective.
    #: Whether the optimizer stayed at a guess, here or on a coarser mesh, and no second solution tells its curvature.
    is_unexamined: bool = False

    @property
    def times(self) -> np.ndarray:
        """Times (N s,) of the collocation points [s]."""
        return np.asarray(self.values["duration"] @ self.grid.points)


@dataclass(frozen=True)
class Switching:
    """Parts of phases, which end at jumps.

    Attributes
    ----------
    times
        Times of the jumps in the motion from which the search begins.
    phases : (P,) array of int
        Phase of the spec to which each part belongs.
    durations : (P,) array
        Durations of the parts in that motion [s].
    surfaces
        By part, an expression that is zero at its end; the last part of a phase has none.
    values : (K, P) array
        Values of the operations that jump, in each part.
    held
        These operations.
    motion
        The motion from which the search begins.
    """

    times: tuple[float, ...]
    phases: np.ndarray
    durations: np.ndarray
    surfaces: Mapping[int, ca.SX]
    values: np.ndarray
    held: Held
    motion: GuessedMotion


class PathOfPhase(NamedTuple):
    """A condition along the path, of one phase or of all."""

    name: str
    expression: ca.SX
    low: float
    high: float
    phase: int | None
    operands: ca.SX  #: Operands of the operations in the expression, (K, 1).
    peak: int | None = None  #: Index of the peak that the values do not exceed, which is an unknown.


class AlongPath(NamedTuple):
    """A condition along the path, with the derivatives of the objective by its bounds at all points, (N s,)."""

    path: PathOfPhase
    slopes: np.ndarray


class Transcription:
    """The optimal control problem of a spec, for any grid.

    The solution of `simpler` on its first mesh is the first guess. With `switching`, phases have parts.
    """

    def __init__(
        self,
        spec: PredictSpec,
        system: CasadiSystem,
        objective: Objective,
        simpler: Transcription | None = None,
        switching: Switching | None = None,
    ):
        self.spec, self.system, self._given_objective = spec, system, objective
        is_fixed = len(system.q0) <= len(system.constraint_names) and not system.state_names
        if is_fixed and not any(joint.is_driver for joint in spec.mechanism().joints.values()):
            why = "has no degree of freedom, and neither drivers nor first-order states: there is no motion to predict"
            raise SpecError(f"the mechanism {why}", key="model.joints")
        self.balanced = StatesInEquilibrium(spec.chosen, self.system)
        self.simpler = simpler
        self._simple: Mesh | None = None  # its solution
        is_archived = switching is None and isinstance(spec.guess, str)
        self._known_motion = archived_motion(spec, system) if is_archived else None
        phases = list(spec.whole.items())
        self.phase_of, self.sides = np.arange(len(phases)), np.zeros((0, len(phases)))
        durations: list[float | Variable] = [phase.duration for _, phase in phases]
        lengths = [float(np.mean(x.limits)) if isinstance(x, Variable) else x for x in durations]
        self._totals = [x.limits if isinstance(x, Variable) else (x, x) for x in durations]
        surfaces, held = dict[int, ca.SX](), None
        if switching is not None:
            self._known_motion, self.phase_of, self.sides = switching.motion, switching.phases, switching.values
            surfaces, lengths, held = dict(switching.surfaces), switching.durations.tolist(), switching.held
            durations = [
                Variable.model_construct(bounds=(SHORTEST * self._totals[k][1], self._totals[k][1]), start=length)
                if sum(self.phase_of == k) > 1
                else durations[k]
                for k, length in zip(self.phase_of.tolist(), lengths, strict=True)
            ]
        self.limits = {
            "u": _limits(map(spec.control, self.system.control_names), self.system.u0),
            "p": _limits(map(spec.optimized.get, self.system.parameter_names), self.system.p0),
            "duration": _limits((x if isinstance(x, Variable) else None for x in durations), lengths),
        }
        self._set_points(spec.collocation.points)
        self.has_nodes = spec.collocation.method == "gauss"
        ends = np.cumsum(lengths).tolist()
        self.breaks = breaks_of(spec, float(self.limits["duration"][1].sum()))
        at_end = ca.SX(system.u)
        for name, table in spec.tables.items():
            at_end[spec.chosen.control_states.index(f"measured.{name}")] = float(curve_of(table)(ends[-1]))
        finals = ca.substitute(objective.finals, system.u, at_end)
        self._check_known(finals, "`final`", "minimize")
        self.objective = replace(objective, finals=finals)
        self._initial = self._conditions("initial", spec.initial, 0.0)
        self._ends = [
            {f"the jump at the end of part {k}": (surfaces[k], 0.0, 0.0)}
            if k in surfaces
            else self._conditions(f"{phases[of][0]}final", phases[of][1].final, at)
            for k, (of, at) in enumerate(zip(self.phase_of.tolist(), ends, strict=True))
        ]
        self._ends[-1] |= self._conditions("final", spec.final, ends[-1]) if spec.phases else {}
        self._periodic = [
            (f"periodic: {last}" + f" = {first}" * (first != last), self._expression(last, "periodic", ends[-1]),
             self._expression(first, "periodic", 0.0))
            for last, first in spec.repeated_values
        ]  # fmt: skip
        self._path: list[PathOfPhase] = []
        self._bounded: list[tuple[str, int, PathOfPhase]] = []
        for k, (place, phase) in enumerate(phases):
            self._add_path(phase.subject_to, f"{place}subject_to", k)
        if spec.phases:
            self._add_path(spec.subject_to, "subject_to", None)
        for k, peak in enumerate(ca.vertsplit(objective.peaks)):
            self._path.append(
                PathOfPhase(f"peak {k} of the objective", peak, -np.inf, 0.0, None, objective.operands, k)
            )
        conditions = [*(x for x, _, _ in self._initial.values()), *(x for _, *both in self._periodic for x in both)]
        self._is_free = np.array(ca.which_depends(ca.vertcat(ca.SX(0, 1), *conditions), system.z, 1), dtype=bool)
        path = ca.vertcat(ca.SX(0, 1), *(path.expression for path in self._path))
        self.functions = PointFunctions(system, objective, path, self._weight, held)
        self.stage = self.functions.stage
        self._idle = self._without_effect()

    def _set_points(self, points: int) -> None:
        method = radau_iia if self.spec.collocation.method == "radau" else gauss
        self.a, self.b, self.c = method.tableau(points).floats()

    def switched(self, switching: Switching) -> Transcription:
        """Return the problem with phases that have parts."""
        other = Transcription(self.spec, self.system, self._given_objective, None, switching)
        other.a, other.b, other.c = self.a, self.b, self.c
        return other

    def of_high_order(self) -> Transcription:
        """Return the problem with as many collocation points as meshes have on which the search begins anew."""
        other = copy(self)
        other._set_points(max(len(self.c), MANY_POINTS[self.spec.collocation.method]))
        return other

    def _add_path(self, conditions: Mapping[str, PathCondition], key: str, phase: int | None) -> None:
        """Add conditions along the path; those of one coordinate, velocity or state are bounds of unknowns."""
        unknowns = {
            x.element_hash(): (name, i) for name in "qvz" for i, x in enumerate(ca.vertsplit(self.system.symbols[name]))
        }
        for name, condition in conditions.items():
            expression = self._expression(condition.value, f"{key}.{name}.value")
            low, high = condition.bounds
            operands = self.system.operands(self.spec.with_states(condition.value))
            path = PathOfPhase(f"{key}: {name}", expression, low, high, phase, operands)
            if expression.is_symbolic() and (unknown := unknowns.get(expression.element_hash())):
                self._bounded.append((*unknown, path))
            else:
                self._path.append(path)

    def integrated(self, rates: np.ndarray, mesh: Mesh) -> np.ndarray:
        """Return the integrals of rates (K, N s) at the collocation points, from 0 at the start on, and at the end of
        the motion if it is no such point.
        """
        parts = rates.reshape(len(rates), -1, len(self.c))
        h = mesh.values["duration"] @ mesh.grid.lengths
        whole = np.cumsum(h * (parts @ self.b), axis=1)
        within = (whole - h * (parts @ self.b))[:, :, None] + h[:, None] * (parts @ self.a.T)
        return np.column_stack([np.zeros(len(rates)), within.reshape(len(rates), -1), *[whole[:, -1]] * self.has_nodes])

    def guess(
        self, random: np.random.Generator | None = None, stop: Stop | None = None, grid: IntervalGrid | None = None
    ) -> Mesh:
        """Return a first guess, by default on the first mesh: the motion in an archive, that of the simpler problem, or
        else positions on straight lines between poses that satisfy the conditions at the start and at the ends of
        phases; with `random`, by way of drawn poses, and with drawn controls.
        """
        system, spec = self.system, self.spec
        grid, (low, high, durations) = grid or self._first_grid(), self.limits["duration"]
        if self.simpler is not None and self._simple is None:
            self._simple = solved_meshes([(self.simpler, self.simpler.guess(), MOST_ITERATIONS)], stop or Stop())[0]
            self._known_motion = solved_motion(self._simple.times, self._simple.values, self.simpler.system, system)
        known_motion = self._known_motion if random is None else None
        if known_motion is not None:
            durations = np.clip(known_motion.durations(durations), low, high)
        knots, poses = [0.0], [self._nearest(system.q0, self._initial, 0.0)]
        for index, (conditions, end) in enumerate(zip(self._ends, np.cumsum(durations), strict=True)):
            if index == len(durations) - 1:  # values at the end that follow from the pose at the start
                known = np.concatenate([poses[0], 0.0 * poses[0], system.z0])
                for name, at_last, at_first in self._periodic:
                    value = float(at_node(system, at_first)(known, system.p0, 0.0))
                    conditions = conditions | {name: (at_last, value, value)}
            if conditions or index == len(durations) - 1:
                knots.append(float(end))
                poses.append(self._nearest(poses[-1], conditions, float(end)))
        times, m = np.append(0.0, durations @ grid.points), len(system.constraint_names)
        low, high, start = self.limits["u"]
        u = np.repeat(start[:, None], len(times), axis=1)
        if random is not None:
            high, low = np.where(np.isfinite(high - low), (high, low), start)  # unknowns of equilibria are not drawn
            shares, end = np.linspace(0.0, 1.0, 5), knots[-1]
            drawn = np.clip(start + 0.25 * (high - low) * random.standard_normal((5, len(u))), low, high)
            u = np.array([np.interp(times, shares * end, x) for x in drawn.T])
            way = float(np.ptp(poses, axis=0)[~system.is_angle].max(initial=0.0)) or 1.0
            size = np.where(system.is_angle, 0.5 * np.pi, way)
            for t in shares[1:-1] * end:
                pose = np.array([np.interp(t, knots, x) for x in np.array(poses).T])
                pose = pose + size * random.standard_normal(len(pose))
                place = int(np.searchsorted(knots, t))
                knots.insert(place, t)
                poses.insert(place, self._nearest(pose, {}, t))

        def filled(name: str, x: np.ndarray) -> np.ndarray:
            return x if known_motion is None else known_motion.known(name, x, times, durations)

        p = filled("p", np.repeat(self.limits["p"][2][:, None], len(times), axis=1))[:, 0]
        q = filled("q", np.array([np.interp(times, knots, x) for x in np.array(poses).T]))
        # velocities in other motions are zero: those on the line lead the swing-up of a pole to five times its effort
        v = filled("v", np.gradient(q, times, axis=1) if spec.periodic else 0.0 * q)
        z = np.repeat(system.z0[:, None], len(times), axis=1)
        z[self.balanced.states] = self.balanced.guess(q, p)
        a, z, u, mu = filled("a", 0.0 * v), filled("z", z), filled("u", u), np.zeros((m, len(times)))
        columns = {"q": q, "v": v, "a": a, "lam": filled("lam", mu), "mu": mu, "z": z, "u": u}
        values = {name: x[:, 1:] for name, x in columns.items()}
        values |= {"duration": durations, "p": p, "start": np.concatenate([q[:, 0], v[:, 0], z[:, 0]])}
        done = self._simple.iterations if self._simple is not None and random is None else 0
        values["peak"] = np.zeros(self.objective.peaks.numel())
        mesh = Mesh(grid, self._with_nodes(values), done)
        balance, along = self._along(mesh, values["u"])[-2:]
        if known_motion is None and not np.all(np.isfinite(balance)):  # such as friction v/abs(v) of a body at rest
            values["v"] = np.gradient(q, times, axis=1)[:, 1:]
            along = self._along(mesh, values["u"])[-1]
        for k, path in enumerate(self._path):
            if path.peak is not None:
                values["peak"][path.peak] = along[k].max()
        return replace(mesh, size=self._size_of_objective(mesh))

    def _first_grid(self) -> IntervalGrid:
        """Return the first mesh: intervals of equal length, some of which end earlier or later, at discontinuities of
        functions of time, up to the first phase whose duration is free.
        """
        spec, begin = self.spec, 0.0
        counts = [phase.intervals or spec.collocation.intervals for phase in spec.whole.values()]
        lengths = self.limits["duration"][2]
        shares = lengths / np.bincount(self.phase_of, lengths)[self.phase_of]
        parts = zip([counts[k] for k in self.phase_of], shares, strict=True)
        grid = IntervalGrid.uniform([max(math.ceil(n * share), min(FEWEST, n)) for n, share in parts], self.c)
        for k, (low, high, _) in enumerate(self.limits["duration"].T.tolist()):
            if low < high:
                break
            grid = grid.with_ends(k, [(t - begin) / low for t in self.breaks if begin < t < begin + low])
            begin += low
        return grid

    @property
    def is_guess_solved(self) -> bool:
        """Whether the simpler problem, if there is one, has an optimum."""
        return self._simple is None or (self._simple.solution is not None and self._simple.solution.is_optimum)

    @property
    def path_names(self) -> list[str]:
        """Names of the conditions along the path, the last results of `stage`."""
        return [f"The condition `{path.name}`" for path in self._path]

    def refined(self, mesh: Mesh, chosen: np.ndarray | None = None) -> Mesh:
        """Return a guess on a finer grid, from the polynomials of the solution.

        All intervals are halved. Those where controls, accelerations or multipliers are discontinuous, which is where
        conditions become active and the order of the method is lost, are divided into more parts. If some intervals are
        `chosen` (N,), only these are divided, into as many parts.
        """
        parts = self._parts(mesh) if chosen is None else np.where(chosen, CUTS[1], 1)
        finer = self.moved(mesh, self, mesh.grid.divided(parts))
        return replace(finer, slopes=self._refined_slopes(mesh, finer.grid), is_unexamined=mesh.is_unexamined)

    def moved(self, mesh: Mesh, other: Transcription, grid: IntervalGrid) -> Mesh:
        """Return the motion of a solution as a guess for another number of collocation points, on a finer grid."""
        values, duration, grid = dict(mesh.values), mesh.values["duration"], replace(grid, c=other.c)
        ends, lengths, centres = (
            duration @ mesh.grid.ends,
            duration @ mesh.grid.lengths,
            duration @ (grid.ends - 0.5 * grid.lengths),
        )
        of = np.repeat(np.searchsorted(ends, centres), len(other.c))
        shares = 1.0 - (ends[of] - duration @ grid.points) / lengths[of]
        for name in OF_POINTS:
            values[name] = self.values_at(mesh, name, shares, of)
        return Mesh(grid, other._with_nodes(values), mesh.iterations, size=mesh.size)

    def _parts(self, mesh: Mesh) -> np.ndarray:
        """Return the number of parts (N,) into which intervals are divided for the next mesh."""
        s, count = len(self.c), len(mesh.grid.phase)
        jumps = np.zeros(count)
        for name in ("a", "lam", "u"):
            parts = mesh.values[name].reshape(-1, count, s)
            jump = abs(parts[:, 1:] @ weights(self.c, 0.0) - parts[:, :-1] @ weights(self.c, 1.0))
            share = (jump / (np.ptp(parts, axis=(1, 2))[:, None] + 1e-9)).max(axis=0, initial=0.0)
            jumps[1:] = np.maximum(jumps[1:], share)
            jumps[:-1] = np.maximum(jumps[:-1], share)
        most = np.partition(jumps, -int(MOST_UNEVEN * count) - 1)[-int(MOST_UNEVEN * count) - 1]
        return np.where(jumps > max(UNEVEN * np.median(jumps), most, 1e-3), CUTS[1], CUTS[0])

    def values_at(self, mesh: Mesh, name: str, shares: np.ndarray, intervals: np.ndarray | None = None) -> np.ndarray:
        """Return the polynomials of an unknown of `OF_POINTS` at K shares of each interval, (rows, N, K); or at one
        share of each of K `intervals`, (rows, K).
        """
        parts, points = mesh.values[name].reshape(-1, len(mesh.grid.phase), len(self.c)), self.c
        if name in self._rows:  # polynomials of states pass through the start of the interval
            begins = self.nodes(mesh)[self._rows[name], :-1]
            parts, points = np.concatenate([begins[:, :, None], parts], axis=2), np.array([0.0, *self.c])
        at = weights(points, shares)
        return np.asarray(parts @ at if intervals is None else np.einsum("rks,sk->rk", parts[:, intervals], at))

    def openings(self, mesh: Mesh) -> tuple[np.ndarray, list[str]]:
        """Return how far cut joints open between the points of each interval (N,), at most, as a share of the largest
        distance of bodies, and the name of the joint that opens most in each.
        """
        labels, count = self.system.constraint_names, len(mesh.grid.phase)
        if not labels:
            return np.zeros(count), [""] * count
        shares = np.linspace(0.0, 1.0, BETWEEN + 2)[1:-1]
        x = {name: self.values_at(mesh, name, shares).reshape(-1, count * BETWEEN) for name in "qvz"}
        times = (mesh.values["duration"] @ (mesh.grid.ends[..., None] - mesh.grid.lengths[..., None] * (1.0 - shares)
                                            ).reshape(len(mesh.values["duration"]), -1))  # fmt: skip
        given = [x["q"], x["v"], 0.0 * x["v"], np.zeros((len(labels), len(times))), x["z"]]
        u, p = (np.tile(y[:, None], len(times)) for y in (self.system.u0, mesh.values["p"]))
        position = np.array(self.system.constraints.map(len(times))(*given, u, p, times[None])[0])
        largest = abs(position).reshape(len(labels), count, -1).max(axis=2)
        return largest.max(axis=0) / self._length, [labels[row].rpartition(".")[0] for row in largest.argmax(axis=0)]

    def _refined_slopes(self, mesh: Mesh, grid: IntervalGrid) -> dict[str, np.ndarray]:
        """Return `Solution.slopes` on a finer grid.

        Multipliers of points are weights of the quadrature times functions of time, which are taken from the nearest
        points. Those of the collocation follow from the costates: ``slopes = b (costates - costates at the end)``, the
        latter with nodes only. With its own estimate of the multipliers, the optimizer does not converge on fine
        meshes where conditions are active, because the Hessian of the Lagrangian has the wrong inertia.
        """
        assert mesh.solution is not None
        slopes, duration, s = dict(mesh.solution.slopes), mesh.values["duration"], len(self.c)
        old, new = (np.kron(duration @ x.lengths, self.b) for x in (mesh.grid, grid))
        times = mesh.times
        nearest = np.searchsorted(0.5 * (times[1:] + times[:-1]), duration @ grid.points)
        for name, points in {**dict.fromkeys(OF_POINTS, np.arange(len(old))), **mesh.conditions}.items():
            values = np.zeros((slopes[name].size // len(points), len(old)))
            values[:, points] = np.reshape(slopes[name], (-1, len(points)), order="F") / old[points]
            slopes[name] = values[:, nearest] * new
        costates = self._costates(mesh)[:, nearest].reshape(len(mesh.values["start"]), s, -1, order="F")
        if self.has_nodes:
            slopes[ENDS], slopes["nodes"] = costates[:, -1] / self.functions.weights, 0.0 * costates[:, -1]
            slopes[JOINTS] = slopes["jumps"] = np.zeros((2 * len(self.system.constraint_names), len(grid.phase)))
            costates = costates - costates[:, -1:]
        slopes[COLLOCATION] = self.b[:, None] * costates
        return slopes

    def solved(
        self,
        guess: Mesh,
        stop: Stop,
        most_iterations: int = MOST_ITERATIONS,
        report: Callable[[Mesh], None] = lambda mesh: None,
        *,
        threads: int = 1,
    ) -> Mesh:
        """Return the optimum on the grid of a guess; `report` is called with the best iterates in between.

        The optimizer stays at any stationary guess, also at a saddle or a maximum, and knows its curvature only after a
        step. Where it stays, the problem is thus solved again from a guess nearby.
        """
        unknowns, bounds, rows, objective, jacobian, hessian = self._program(guess.grid, threads)
        sizes = self._sizes | {"peak": np.where(guess.values["peak"] == 0.0, 1.0, abs(guess.values["peak"]))}
        program = NonlinearProgram(unknowns, bounds, rows, objective, sizes, jacobian, hessian, guess.size, len(self.c))

        def mesh(solution: Solution) -> Mesh:
            done = guess.iterations + solution.iterations
            return replace(guess, values=solution.values, iterations=done, solution=solution, conditions=program.points)

        values, slopes = guess.values, guess.slopes
        found = program.solve(values, stop, lambda best: report(mesh(best)), most_iterations, slopes)
        found = replace(found, is_strict=found.is_strict and not guess.is_unexamined)
        is_first = slopes is None and self._stays(values, found.values)
        if not found.is_optimum or stop.now or not (is_first or found.iterations == 0):
            return mesh(found)
        found = replace(found, is_strict=False)
        report(mesh(found))
        nearby = self._nearby(guess, bounds)
        other = program.solve(nearby, stop, lambda best: None, most_iterations, slopes)
        change, same = other.objective - found.objective, ROUNDING * abs(found.objective) + NOTHING * guess.size
        if change < -same and (other.is_optimum or other.is_unbounded):
            moved, done = mesh(other), found.iterations
            return replace(moved, iterations=moved.iterations + done, is_unexamined=False)
        is_strict = other.is_strict and change <= same and not guess.is_unexamined
        stays = mesh(replace(found, is_strict=is_strict))
        return replace(stays, iterations=stays.iterations + other.iterations, is_unexamined=not is_strict)

    def _stays(self, before: Mapping[str, np.ndarray], after: Mapping[str, np.ndarray]) -> bool:
        """Return whether controls, numbers and durations are those before."""
        changes = ((abs(after[x] - before[x]).T / self._sizes.get(x, 1.0)).max(initial=0.0) for x in OF_SPEC)
        return bool(max(changes) <= UNMOVED)

    def _nearby(self, guess: Mesh, bounds: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> dict[str, np.ndarray]:
        """Return the values of a guess nearby: what determines the motion is changed in ways without symmetries, and
        which conditions do not undo.
        """
        values, growth = dict(guess.values), np.exp(guess.times / guess.values["duration"].sum())
        way = np.where(self.system.is_angle, 1.0, self._length)
        of_start = np.concatenate([way, way, np.ones(len(self.system.z0))])
        sizes = self._sizes | {"q": way, "start": of_start, "duration": values["duration"]}
        for name in (*OF_SPEC, "q", "start"):
            change = NEARBY * sizes[name] / np.arange(1, len(sizes[name]) + 1)
            change = np.outer(change, growth) if values[name].ndim > 1 else change
            values[name] = np.clip(values[name] + change, *bounds[name])
        return values

    def nearest_violations(self, guess: Mesh, stop: Stop) -> Mapping[str, float]:
        """Return the violations, by name, of the motion whose conditions of the user have the smallest sum of
        violations; empty if it is not found.
        """
        unknowns, bounds, conditions, *_ = self._program(guess.grid)
        asked = [k for k, row in enumerate(conditions) if ": " in row.name]
        sizes = [conditions[k].value.numel() for k in asked]
        weight = [WEIGHT_OF_START if conditions[k].name.startswith("initial") else 1.0 for k in asked]
        none, values = np.zeros(sum(sizes)), dict(guess.values)
        for name in ("over", "under"):
            unknowns[name], bounds[name], values[name] = ca.MX.sym(name, len(none)), (none, none + np.inf), none
        parts = np.split(np.arange(len(none)), np.cumsum(sizes)[:-1])
        for k, part in zip(asked, parts, strict=True):
            missed = (unknowns["over"] - unknowns["under"])[part.tolist()]
            conditions[k] = conditions[k]._replace(value=ca.vec(conditions[k].value) - missed)
        total = ca.dot(np.repeat(np.divide(weight, sizes), sizes), unknowns["over"] + unknowns["under"])
        program = NonlinearProgram(unknowns, bounds, conditions, total, self._sizes)
        solution = program.solve(values, stop, lambda solution: None)
        if not solution.is_optimum:
            return {}
        misses = np.maximum(solution.values["over"], solution.values["under"])
        return {conditions[k].name: float(misses[part].max()) for k, part in zip(asked, parts, strict=True)}

    def _without_effect(self) -> np.ndarray:
        """Return which positions and velocities (2 n,) affect nothing, such as the angle of a point mass."""
        system, n = self.system, len(self.system.q0)
        ends = [x for conditions in (self._initial, *self._ends) for x, _, _ in conditions.values()]
        mu = ca.SX.sym("mu", len(system.constraint_names))
        results = self.stage(*system.symbols.values(), mu, ca.DM(self.sides[:, :1]))
        known = [x for k, x in enumerate(results) if k != 1]  # without q'
        everything = ca.vertcat(*known, self.objective.finals, *ends, *(x for _, *both in self._periodic for x in both))
        of_q, of_v = (np.array(ca.which_depends(everything, system.symbols[name], 1)) for name in "qv")
        return np.concatenate([~of_q, ~(of_q | of_v)]) if n else np.zeros(0, dtype=bool)

    def _program(
        self, grid: IntervalGrid, threads: int = 1
    ) -> tuple[
        dict[str, ca.MX], dict[str, Any], list[ProgramCondition], ca.MX, PointJacobian, PointHessian | None
    ]:  # fmt: skip
        system, s = self.system, len(self.c)
        count = len(grid.phase)
        total = count * s
        bounds = self._bounds(grid)
        x = {name: ca.MX.sym(name, *lower.shape) for name, (lower, _) in bounds.items()}
        h = ca.mtimes(x["duration"].T, ca.sparsify(ca.DM(grid.lengths)))
        times = ca.mtimes(x["duration"].T, ca.DM(grid.points))
        given = [*(x[name] for name in ("q", "v", "a", "lam", "z", "u")), ca.repmat(x["p"], 1, total), times, x["mu"],
                 ca.MX(ca.DM(self.sides_at(grid, s)))]  # fmt: skip

        def mapped(function: ca.Function) -> ca.Function:
            several = ("thread", threads) if threads > 1 and total * function.n_instructions() > WORTH_THREADS else ()
            return function.map(total, *several)

        values: Any = mapped(self.stage)(*given)
        sizes = np.cumsum([0, *(value.shape[0] for value in values)]).tolist()
        results = ca.MX.sym("results", sizes[-1], total)
        closed, position_rates, rates, _, balance, path = ca.vertsplit(results, sizes)
        integrands = self.functions.integrands.map(total)(*given)
        states, slopes = ca.vertcat(x["q"], x["v"], x["z"]), ca.vertcat(position_rates, x["a"], rates)
        ends = x["nodes"] if self.has_nodes else states[:, s - 1 :: s]
        begins = ca.horzcat(x["start"], ends[:, :-1])
        each = ca.DM.eye(count)
        lengths = ca.mtimes(h, ca.kron(each, ca.DM.ones(1, s)))
        inverse = np.linalg.inv(self.a)  # derivatives: nonlinear terms of a point stand in its rows only
        changes = ca.mtimes(states, ca.kron(each, ca.DM(inverse.T)))
        changes -= ca.mtimes(begins, ca.kron(each, ca.DM(inverse.sum(axis=1)).T))
        conditions = [
            ProgramCondition(MOTION, ca.vertcat(balance, closed), points=np.arange(total)),
            ProgramCondition(COLLOCATION, changes - slopes * ca.repmat(lengths, states.shape[0], 1)),
        ]
        if self.has_nodes:
            whole = ca.mtimes(slopes, ca.kron(each, ca.DM(self.b))) * ca.repmat(h, states.shape[0], 1)
            at_ends = ca.mtimes(x["duration"].T, ca.DM(grid.ends))
            moved, joined = self.functions.projection.map(count)(
                ends, ca.repmat(x["p"], 1, count), at_ends, ends - begins - whole, x["jumps"]
            )
            conditions += [ProgramCondition(ENDS, moved), ProgramCondition(JOINTS, joined)]
        start, end, duration = x["start"], ends[:, -1], ca.sum1(x["duration"])
        at_rest = [x for x, k in zip(self.balanced.at_rest, self.balanced.states, strict=True) if not self._is_free[k]]
        rows: Any = system.constraints(*system.symbols.values())[:2]
        for name, zeros in (("the joints at the start", rows), ("the equilibrium of fibres at the start", at_rest)):
            if any(zero.numel() for zero in zeros):
                conditions.append(ProgramCondition(name, at_node(system, ca.vertcat(*zeros))(start, x["p"], 0.0)))
        at: list[Any] = [ca.sum1(x["duration"][: k + 1]) for k in range(len(self._ends))]
        nodes = [(start, 0.0), *((ends[:, k], t) for k, t in zip(grid.ends_of_phases(), at, strict=True))]
        for (state, t), asked in zip(nodes, (self._initial, *self._ends), strict=True):
            for name, (expression, low, high) in asked.items():
                conditions.append(ProgramCondition(name, at_node(system, expression)(state, x["p"], t), low, high))
        for k, (low, high) in enumerate(self._totals):
            parts = np.flatnonzero(self.phase_of == k).tolist()
            if len(parts) > 1:
                conditions.append(ProgramCondition(f"duration {k}", ca.sum1(x["duration"][parts]), low, high))
        for name, at_last, at_first in self._periodic:
            change = at_node(system, at_last)(end, x["p"], duration) - at_node(system, at_first)(start, x["p"], 0.0)
            conditions.append(ProgramCondition(name, change))
        for k, condition in enumerate(self._path):
            points = self._points(grid, condition)
            along = path[k, points.tolist()] - (0.0 if condition.peak is None else x["peak"][condition.peak])
            conditions.append(ProgramCondition(condition.name, along, condition.low, condition.high, points))
        finals = at_node(system, self.objective.finals)(end, x["p"], duration)
        integrals = ca.mtimes(integrands, ca.mtimes(h, ca.kron(each, ca.DM(self.b).T)).T)
        objective = self.objective.value(integrals, finals, x["peak"], duration)
        variables = ca.vertcat(*(x[name] for name in OF_POINTS), ca.repmat(x["p"], 1, total), times, lengths)
        outer = [condition.value for condition in conditions]
        column: Any = ca.vertcat(*map(ca.vec, outer))
        jacobian = PointJacobian(variables, results, mapped(self.functions.slopes)(*given), column, ca.vertcat(*values))
        columns: Any = ca.substitute(outer, [results], [jacobian.values])
        conditions = [condition._replace(value=value) for condition, value in zip(conditions, columns, strict=True)]
        sums = ca.MX.sym("integrals", integrands.shape[0])
        (rest,) = self.objective.value.call([sums, finals, x["peak"], duration], True, False)  # not as a call
        slope = ca.jacobian(rest, sums)
        if self.has_nodes or ca.depends_on(slope, sums):  # projections are curved, too
            return x, bounds, conditions, objective, jacobian, None

        def blocks(factor: ca.MX, multipliers: Mapping[str, ca.MX]) -> ca.MX:
            of_path = [
                ca.mtimes(multipliers[path.name], ca.DM.eye(total)[self._points(grid, path).tolist(), :])
                for path in self._path
            ]
            weight = factor * ca.mtimes(slope.T, ca.DM(np.tile(self.b, count)[None]))
            return mapped(self.functions.curvature)(
                variables, multipliers[COLLOCATION], multipliers[MOTION], ca.vertcat(ca.MX(0, total), *of_path), weight,
                given[-1],
            )  # fmt: skip

        names = (MOTION, COLLOCATION, *(path.name for path in self._path))
        return x, bounds, conditions, objective, jacobian, PointHessian(variables, blocks, names, rest, sums, integrals)

    def multipliers(self, mesh: Mesh, integrals: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return derivatives of the objective: by integrals; and as functions of time, (rows, N s) at the collocation
        points, by the values of the condition `MOTION` and by the rates of first-order states.
        """
        assert mesh.solution is not None
        given, slopes = self.objective.value.sx_in(), mesh.solution.slopes
        slope = ca.Function("slope", given, [ca.jacobian(self.objective.value(*given), given[0])])
        end, duration = self.nodes(mesh)[:, -1], mesh.values["duration"].sum()
        finals = at_node(self.system, self.objective.finals)(end, mesh.values["p"], duration)
        by_integrals = np.array(slope(integrals, finals, mesh.values["peak"], duration)).ravel()
        quadrature = np.kron(mesh.values["duration"] @ mesh.grid.lengths, self.b)
        of_motion = slopes[MOTION].reshape(-1, len(mesh.times), order="F") / quadrature
        return by_integrals, of_motion, self._costates(mesh)[self._rows["z"]]

    def costates(self, mesh: Mesh) -> dict[str, np.ndarray]:
        """Return the derivatives (T,) of the objective by the states, named by coordinates of bodies, by their
        velocities, and by first-order states: at the start, the collocation points, and the end.
        """
        system, s, inside = self.system, len(self.c), self._costates(mesh)
        ends = [inside[:, :s] @ weights(self.c, 0.0), *[inside[:, -s:] @ weights(self.c, 1.0)] * self.has_nodes]
        names = [f"{system.bodies[k // 3]}.{kind[k % 3]}" for kind in OF_BODIES for k in system.places.tolist()]
        rows = np.column_stack([ends[0], inside, *ends[1:]])
        return dict(zip([*names, *system.state_names], rows, strict=True))

    def _costates(self, mesh: Mesh) -> np.ndarray:
        """Return the costates (2 n + Z, N s) at the collocation points: derivatives of the objective by the states."""
        assert mesh.solution is not None
        slopes, rows, s = mesh.solution.slopes, len(mesh.values["start"]), len(self.c)
        costates = slopes[COLLOCATION].reshape(rows, s, -1, order="F") / self.b[:, None]
        if self.has_nodes:
            costates += (self.functions.weights * slopes[ENDS].reshape(rows, -1, order="F"))[:, None]
        return np.asarray(costates.reshape(rows, -1, order="F"))

    def sides_at(self, grid: IntervalGrid, count: int) -> np.ndarray:
        """Return the values of the operations that jump at so many points in each interval, the last argument of
        `stage`.
        """
        return self.sides[:, np.repeat(grid.phase, count)]

    def bounds_of_path(self, mesh: Mesh, k: int) -> tuple[float, float]:
        """Return the bounds of a condition along the path."""
        path = self._path[k]
        return path.low, path.high if path.peak is None else float(mesh.values["peak"][path.peak])

    def along_path(self, mesh: Mesh) -> list[AlongPath]:
        """Return the conditions along the path, bounds of states among them."""
        assert mesh.solution is not None
        every, slopes = list[AlongPath](), mesh.solution.slopes
        bounded = [(path, slopes.get(name, np.zeros((i + 1, 1)))[i]) for name, i, path in self._bounded]
        for path, found in [*((path, slopes.get(path.name, np.zeros(1))) for path in self._path), *bounded]:
            values, points = np.zeros(len(mesh.times)), self._points(mesh.grid, path)
            values[points] = np.ravel(found)[points if np.size(found) == len(values) else slice(None)]
            every.append(AlongPath(path, values))
        return every

    def _points(self, grid: IntervalGrid, path: PathOfPhase) -> np.ndarray:
        """Return the indices of the collocation points at which a condition along the path is asked.

        These are the points of its phase, except ends whose conditions fix the value within the bounds: no motion near
        the optimum would satisfy both conditions with slack, so that their multipliers were not unique.
        """
        phases = np.repeat(self.phase_of[grid.phase], len(self.c))
        chosen = phases == (phases if path.phase is None else path.phase)
        for last, conditions in zip(grid.ends_of_phases(), self._ends, strict=True):
            for expression, low, high in conditions.values():
                if low == high and path.low <= low <= path.high and ca.is_equal(expression, path.expression, 4):
                    chosen[(last + 1) * len(self.c) - 1] &= self.has_nodes
        return np.flatnonzero(chosen)

    def _bounds(self, grid: IntervalGrid) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        system = self.system
        n, m, z, total = len(system.q0), len(system.constraint_names), len(system.z0), grid.points.shape[1]
        sizes = {"q": n, "v": n, "a": n, "lam": m, "mu": m, "z": z}
        free = {name: np.full((size, total), np.inf) for name, size in sizes.items()}
        is_free = self._is_free.copy()
        is_free[self.balanced.states] = True
        start = np.concatenate([np.where(self._idle, 0.0, np.inf), np.where(is_free, np.inf, 0.0)])
        at = np.concatenate([np.where(self._idle, [*system.q0, *system.v0], 0.0), np.where(is_free, 0.0, system.z0)])
        bounds = {
            **{name: tuple(self.limits[name][:2]) for name in ("duration", "p")},
            "peak": (np.full(self.objective.peaks.numel(), -np.inf), np.full(self.objective.peaks.numel(), np.inf)),
            "start": (at - start, at + start),
            **{name: (-limit, limit) for name, limit in free.items()},
            "u": tuple(np.repeat(side[:, None], total, axis=1) for side in self.limits["u"][:2]),
        }
        for name, table in self.spec.tables.items():
            row = self.spec.chosen.control_states.index(f"measured.{name}")
            for side in bounds["u"]:
                side[row] = curve_of(table)(self.limits["duration"][2] @ grid.points)
        for name, i, path in self._bounded:
            columns = self._points(grid, path)
            lower, upper = bounds[name]
            lower[i, columns], upper[i, columns] = (
                np.maximum(lower[i, columns], path.low), np.minimum(upper[i, columns], path.high)
            )  # fmt: skip
            row = i + {"q": 0, "v": n, "z": 2 * n}[name]
            if start[row] and not path.phase:  # not fixed
                lower, upper = bounds["start"]
                lower[row], upper[row] = max(lower[row], path.low), min(upper[row], path.high)
        if self.has_nodes:
            for name, size in (("nodes", 2 * n + z), ("jumps", 2 * m)):
                limit = np.full((size, len(grid.phase)), np.inf)
                bounds[name] = -limit, limit
        return bounds

    @property
    def _rows(self) -> dict[str, slice]:
        n = len(self.system.q0)
        return {"q": slice(n), "v": slice(n, 2 * n), "z": slice(2 * n, None)}

    def states_of_bodies(self, mesh: Mesh, states: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Return states (6 B + Z, T) of B bodies, given those of the coordinates (2 n + Z, T)."""
        q, v, z = (states[rows] for rows in self._rows.values())
        p, still = np.tile(mesh.values["p"][:, None], len(times)), 0.0 * v
        placed, moving = self.system.placed.map(len(times))(q, v, still, p, times[None])[:2]
        return np.vstack([np.array(placed), np.array(moving), z])

    def nodes(self, mesh: Mesh) -> np.ndarray:
        """Return the states (2 n + Z, N + 1) at the start and at the ends of intervals."""
        s, values = len(self.c), mesh.values
        ends = values["nodes"] if self.has_nodes else np.vstack([values[name][:, s - 1 :: s] for name in "qvz"])
        return np.column_stack([values["start"], ends])

    @property
    def free_controls(self) -> list[int]:
        """Indices of the controls of the spec that have different bounds."""
        low, high, _ = self.limits["u"]
        names = self.system.control_names
        return [k for k, name in enumerate(names) if name in self.spec.controls and low[k] < high[k]]

    @property
    def control_sizes(self) -> np.ndarray:
        """Natural sizes (U,) of the controls."""
        return self._sizes["u"]

    @cached_property
    def _sizes(self) -> dict[str, np.ndarray]:
        """Natural sizes: of controls and parameters the largest bound, of multipliers the weight.

        Controls that are forces or torques are at most those that balance the weight. The optimizer regularizes
        indefinite problems by absolute numbers; without sizes, a squat takes 395 iterations, not 24.
        """
        system = self.system
        sizes = {"lam": np.full(len(system.constraint_names), self._weight)}
        for name in "up":
            largest = abs(self.limits[name][:2]).max(axis=0)
            sizes[name] = np.where(np.isfinite(largest) & (largest > 0.0), largest, np.inf)
        start = [system.q0, system.v0, 0.0 * system.v0, np.zeros(len(system.constraint_names)), system.z0, system.u0]
        slopes = ca.Function("slopes", [*system.symbols.values()], [ca.jacobian(system.residual.call(
            [*system.symbols.values()])[0], system.u)])  # fmt: skip
        effects = abs(np.array(slopes(*start, system.p0, 0.0)).reshape(len(system.q0), -1))
        weights = self._weight * np.where(system.is_angle, self._length, 1.0)[:, None]
        with np.errstate(divide="ignore"):
            balancing = np.where(effects > 0.0, weights / effects, np.inf).min(axis=0, initial=np.inf)
        of_spec = np.array([name in self.spec.controls for name in system.control_names], dtype=bool)
        sizes["u"] = np.where(of_spec, np.minimum(sizes["u"], balancing), sizes["u"])
        present = np.where(system.p0 == 0.0, 1.0, abs(system.p0))
        return sizes | {
            "u": np.where(np.isfinite(sizes["u"]), sizes["u"], 1.0),
            "p": np.where(np.isfinite(sizes["p"]), sizes["p"], present),
        }

    def _size_of_objective(self, mesh: Mesh) -> float:
        """Return the natural size of the objective: that of a guess, with controls changed by half their natural sizes;
        1 unless it is small.
        """
        low, high, _ = self.limits["u"]
        u = np.clip(mesh.values["u"] + 0.5 * self._sizes["u"][:, None], low[:, None], high[:, None])
        size = abs(self.objective_at(mesh, u))
        return size if 0.0 < size < SMALL else 1.0

    def objective_at(self, mesh: Mesh, u: np.ndarray) -> float:
        """Return the objective of a motion, with controls (U, N s)."""
        values, duration, (*_, integrands, _, along) = mesh.values, mesh.values["duration"], self._along(mesh, u)
        integrals = integrands @ np.kron(duration @ mesh.grid.lengths, self.b)
        finals = at_node(self.system, self.objective.finals)(self.nodes(mesh)[:, -1], values["p"], duration.sum())
        peaks = [along[k].max() for k, path in enumerate(self._path) if path.peak is not None]
        return float(self.objective.value(integrals, finals, peaks, duration.sum()))

    def _along(self, mesh: Mesh, u: np.ndarray) -> list[np.ndarray]:
        """Return the results of `stage` at the points of a mesh, with other controls (U, N s)."""
        values, count = {**mesh.values, "u": u}, len(mesh.times)
        own = [values[name] for name in ("q", "v", "a", "lam", "z", "u")]
        p = np.tile(values["p"][:, None], count)
        given = *own, p, mesh.times[None], values["mu"], self.sides_at(mesh.grid, len(self.c))
        return list(map(np.array, self.stage.map(count)(*given)))

    @property
    def _length(self) -> float:
        """Largest distance of bodies in one direction at the start [m], or 1 if there is none."""
        q = np.array(self.system.placed(self.system.q0, self.system.v0, 0.0 * self.system.v0, self.system.p0, 0.0)[0])
        return float(np.ptp(q.reshape(-1, 3)[:, :2], axis=0).max(initial=0.0)) or 1.0

    @property
    def _weight(self) -> float:
        """Weight of all bodies [N], or the force that moves them by their distance, without gravity."""
        mechanism, duration = self.spec.mechanism(), float(self.limits["duration"][2].sum())
        mass = sum(body.mass for body in mechanism.bodies.values())
        return mass * (float(np.hypot(*mechanism.gravity)) or self._length / duration**2) or 1.0

    def _with_nodes(self, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        if self.has_nodes:
            values["nodes"] = np.vstack([values[name] for name in "qvz"])[:, len(self.c) - 1 :: len(self.c)].copy()
            values["jumps"] = np.zeros((2 * len(values["lam"]), values["nodes"].shape[1]))
        return values

    def _expression(self, text: str, key: str, at: float | None = None) -> ca.SX:
        """Return an expression in symbols, which must be known at a time `at` the start or an end if that is given."""
        with self.spec.blaming(key):
            expression = self.system.expression(self.spec.with_states(text, at))
        if at is not None:
            self._check_known(expression, f"'{text}'", key)
        return expression

    def _check_known(self, expression: ca.SX, text: str, key: str) -> None:
        unknown = [self.system.symbols[name] for name in OF_STATE]
        if any(x.numel() and ca.depends_on(expression, x) for x in unknown):
            why = "depends on accelerations, reactions or controls, which are not known at the start and the end"
            raise SpecError(f"{text} {why}; use positions, velocities and states", key=key)

    def _conditions(self, key: str, wanted: Mapping[str, Any], at: float) -> dict[str, tuple[ca.SX, float, float]]:
        """Return conditions on the state at the start or at the end, by key and text; a number is both bounds."""
        return {
            f"{key}: {text}": (self._expression(text, key, at), *np.broadcast_to(value, 2).tolist())
            for text, value in wanted.items()
        }

    def slopes_of_conditions(self, state: np.ndarray, p: np.ndarray, time: float, node: int | None) -> np.ndarray:
        """Return the derivatives (K, 2 n + Z + 1), by the state and the time, of what is fixed in a state (2 n + Z,):
        the joints and, at the start or the end of a phase, a `node` from 0 on, the values that the spec gives.
        """
        system = self.system
        wanted = {} if node is None else (self._initial, *self._ends)[node]
        asked = [x for x, low, high in wanted.values() if low == high]
        known = system.z[np.flatnonzero(~self._is_free).tolist()] if node == 0 else ca.SX(0, 1)
        rows = ca.vertcat(*system.constraints(*system.symbols.values())[:2], *asked, known)
        slopes = ca.jacobian(rows, ca.vertcat(system.q, system.v, system.z, system.t))
        return np.array(at_node(system, slopes)(state, p, time))

    def _nearest(self, q: np.ndarray, conditions: Mapping[str, tuple[ca.SX, float, float]], t: float) -> np.ndarray:
        """Return the positions nearest to `q` that satisfy the constraints, and conditions of positions only."""
        system = self.system
        others = ca.vertcat(system.v, system.z)
        wanted = [row for row in conditions.values() if not ca.depends_on(row[0], others)]
        rows = ca.vertcat(system.constraints(*system.symbols.values())[0], *(row[0] for row in wanted))
        still = ca.vertcat(system.q, ca.SX.zeros(len(q) + len(system.z0)))
        program = {"x": system.q, "f": ca.sumsqr(system.q - q), "g": at_node(system, rows)(still, system.p0, t)}
        low, high = (np.array([*[0.0] * len(system.constraint_names), *(row[k] for row in wanted)]) for k in (1, 2))
        # an arm that points away from its aim does not turn by itself
        turns = (0.0, 0.5 * np.pi, -0.5 * np.pi)[: 1 + 2 * system.is_arm.any()]
        at = ca.Function("at", [system.q], [program["g"]])

        def misses(pose: np.ndarray) -> bool:
            values = np.array(at(pose)).ravel()
            return bool(np.maximum(low - values, values - high).max(initial=0.0) > 1e-6)

        def nearest(least: np.ndarray, most: np.ndarray) -> np.ndarray:
            poses = [solve_pose(program, x0=q + turn * system.is_arm, lbg=least, ubg=most) for turn in turns]
            return min(poses, key=lambda pose: (misses(pose), np.linalg.norm(pose - q)))

        found = nearest(low, high)
        return nearest(low - SLACK, high + SLACK) if misses(found) else found


def solved_meshes(problems: Sequence[tuple[Transcription, Mesh, int]], stop: Stop) -> list[Mesh]:
    """Return the optima of problems on the grids of guesses in at most so many iterations, each found in a process of
    its own; best iterates, or the guesses themselves, if `stop` says to stop.
    """
    solve = partial(Transcription.solved, threads=max(1, (os.cpu_count() or 1) // len(problems)))
    tasks = [partial(solve, method, guess, stop, most) for method, guess, most in problems]
    results = results_of(tasks, stop, partial(import_module, "scipy.integrate"))  # which the forward run needs
    return [
        replace(guess, solution=Solution(guess.values, method.objective_at(guess, guess.values["u"]), {}))
        if mesh is None
        else mesh
        for mesh, (method, guess, _) in zip(results, problems, strict=True)
    ]


def _limits(variables: Iterable[Variable | None], present: Iterable[float]) -> np.ndarray:
    """Return lower bounds, upper bounds, and starts within them (3, K); present values where a number is fixed."""
    rows = [
        (x, x, x) if variable is None else (*variable.limits, x if variable.start is None else variable.start)
        for variable, x in zip(variables, present, strict=True)
    ]
    low, high, start = np.reshape(rows, (-1, 3)).T
    return np.array([low, high, np.clip(start, low, high)])
