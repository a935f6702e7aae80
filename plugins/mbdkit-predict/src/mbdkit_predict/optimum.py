"""Finds the optimum of a spec: several first guesses, finer and finer meshes, and the error of the objective."""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mbdkit_predict.between_points import FEW, NODES, Residual, residual_between_points
from mbdkit_predict.jumps import Jump, jumps_along
from mbdkit_predict.nonlinear_program import MOST_ITERATIONS, STATUSES, Solution
from mbdkit_predict.predict_spec import PredictSpec
from mbdkit_predict.processes import Stop, results_of
from mbdkit_predict.transcription import MOST_UNEVEN, OF_POINTS, Mesh, Transcription, solved_meshes

#: Smallest error of the objective, relative to its size, due to the tolerance of the optimizer.
ROUNDING = 1e-8
NOTHING = 1e-9  #: Changes of the objective below this, relative to its natural size, count as zero.
MOST_INTERVALS = 640  #: Largest number of intervals of a refined mesh; every first mesh is refined once.
ITERATIONS_OF_START = 500  #: Largest number of iterations from a drawn guess.
HUGE = 1e8  #: Unknowns above this size at the limit of iterations are taken for unbounded ones.
#: Share of the largest distance of bodies by which joints must not open between collocation points, and how often the
#: intervals in which they do are divided.
OPEN, DIVISIONS = 0.1, 2
#: Factors of the estimated error of the objective, and of its first-order change by what remains between the points.
SAFETY, HIGHER_ORDER = 3.0, 1.5
#: Smallest ratio of two changes of the objective in a row that is believed; the second one, where conditions become
#: active.
ACCIDENT, ACCIDENT_OF_ACTIVE = 2.0**-10, 2.0**-5
#: Largest and smallest ratio of two changes of the objective in a row with which the error is extrapolated. Where
#: conditions become active, methods of high order have no constant ratio.
SLOWEST, FASTEST = 0.5, 2.0**-4


Problem = tuple[Transcription, Mesh, int]  #: A problem, its first guess, and the largest number of iterations.


@dataclass(frozen=True)
class Optimum:
    """The best motion that is found.

    Attributes
    ----------
    transcription
        The problem.
    mesh
        The solution on the last mesh with an optimum; without one, the best iterate.
    meshes
        The solutions on all meshes with an optimum.
    error
        Estimated error of the objective; nan without an optimum.
    reason
        Code and sentence saying why the optimum was not found, or not accurately; empty if it was.
    jumps
        Where forces, rates, integrands or conditions jump as functions of the state.
    starts
        Objective on the first mesh from each first guess; nan where no optimum was found.
    """

    transcription: Transcription
    mesh: Mesh
    meshes: Sequence[Mesh]
    error: float
    reason: str
    jumps: Sequence[Jump]
    starts: Sequence[float]

    @property
    def spec(self) -> PredictSpec:
        """The spec of the problem."""
        return self.transcription.spec

    @property
    def is_minimum(self) -> bool:
        """Whether the second-order condition holds."""
        return self.is_optimum and _solution(self.mesh).is_strict

    @property
    def record(self) -> list[tuple[tuple[int, ...], float]]:
        """Numbers of intervals of the phases, and objective, of each mesh."""
        return [(mesh.grid.counts, _solution(mesh).objective) for mesh in self.meshes or [self.mesh]]

    @property
    def is_optimum(self) -> bool:
        """Whether the motion is an optimum, on one mesh at least."""
        return bool(self.meshes)

    @property
    def objective(self) -> float:
        """Value of the objective."""
        return _solution(self.mesh).objective

    @property
    def sensitivities(self) -> dict[str, float]:
        """Derivatives of the optimum: by numbers of the model, fixed durations, and values at the start and the end."""
        slopes, names = _solution(self.mesh).slopes, self.transcription.system.parameter_names
        by_parameter = dict(zip(names, slopes["p"].tolist(), strict=True))
        by_duration = {
            f"{place}duration": float(slope)
            for (place, phase), slope in zip(self.spec.whole.items(), slopes["duration"], strict=True)
            if isinstance(phase.duration, float)
        }
        by_condition = {
            name: float(slope[0])
            for name, slope in slopes.items()
            if name.partition(":")[0].rpartition(".")[2] in ("initial", "final")
        }
        return {name: by_parameter[name] for name in self.spec.sensitivities} | by_duration | by_condition


def find_optima(transcriptions: Sequence[Transcription], stop: Stop) -> list[Optimum]:
    """Return the best motion of each problem, found on finer and finer meshes until `stop` says to stop."""
    searches, found = [_MeshSearch(one, stop).run() for one in transcriptions], dict[int, Optimum]()
    asked = {k: next(search) for k, search in enumerate(searches)}
    while asked:
        meshes = iter(solved_meshes([problem for problems in asked.values() for problem in problems], stop))
        for k, problems in [*asked.items()]:
            try:
                asked[k] = searches[k].send([next(meshes) for _ in problems])
            except StopIteration as end:
                found[k] = end.value
                del asked[k]
    return [found[k] for k in range(len(searches))]


_Search = Generator[list[Problem], list[Mesh], Optimum]


class _MeshSearch:
    """Refines meshes until the error of the objective is known to be small enough."""

    def __init__(self, transcription: Transcription, stop: Stop):
        self.spec, self.transcription, self.stop = transcription.spec, transcription, stop
        self.meshes, self.starts = list[Mesh](), list[float]()
        self.halved = 0  # index of the mesh from which on all intervals are divided

    def run(self) -> _Search:
        """Yield problems to solve, take their solutions, and return the best motion."""
        mesh, error, reason = (yield from self._first()), math.nan, ""
        divisions, is_resolved = 0, False
        while _solution(mesh).is_optimum:
            opens, joints = self.transcription.openings(mesh)
            if opens.max() > OPEN and divisions == DIVISIONS:
                reason = self._branches(mesh, opens, joints)
                break
            if opens.max() > OPEN:
                divisions, self.halved = divisions + 1, len(self.meshes)
                refined = self.transcription.refined(mesh, opens > OPEN)
                (mesh,) = yield [(self.transcription, refined, MOST_ITERATIONS)]
                continue
            self.meshes.append(mesh)
            error, is_known = self._error()
            objective, count = abs(_solution(mesh).objective), len(mesh.grid.phase)
            limit = self.spec.tolerance * objective + NOTHING * mesh.size
            is_last = len(self.meshes) > self.halved + 1 and 2 * count > MOST_INTERVALS
            is_accurate, chosen = is_known and error <= limit, None
            if is_accurate or is_last or not is_resolved:
                nodes = NODES if is_accurate or is_last else FEW
                residual = residual_between_points(self.transcription, mesh, nodes)
                large = residual.is_large(limit / HIGHER_ORDER, math.sqrt(self.spec.tolerance))
                is_resolved = not large.any()
                if is_accurate or is_last:
                    error = max(error, HIGHER_ORDER * float(abs(residual.change).sum()))
                    if is_last and (error > limit or not is_resolved):
                        reason = _mesh_limit(error, limit, residual, count)
                    if is_last or is_resolved:
                        break
                # all intervals are halved unless few of them have almost all that remains
                if is_accurate or 0 < large.sum() <= MOST_UNEVEN * count < MOST_UNEVEN * MOST_INTERVALS / 2:
                    chosen, self.halved = large, len(self.meshes)
            (mesh,) = yield [(self.transcription, self.transcription.refined(mesh, chosen), MOST_ITERATIONS)]
        if not _solution(mesh).is_optimum and not reason:
            reason = self._failure(mesh)
        best = self.meshes[-1] if self.meshes else mesh
        error = error if math.isfinite(error) else math.nan
        jumps = jumps_along(self.transcription, best) if self.meshes and not self.stop.now else []
        return Optimum(self.transcription, best, self.meshes, error, reason, jumps, self.starts)

    def _first(self) -> Generator[list[Problem], list[Mesh], Mesh]:
        random = np.random.default_rng(self.spec.seed)
        guesses = [self.transcription.guess(random if k else None, self.stop) for k in range(self.spec.starts)]
        meshes = yield [
            (self.transcription, guess, ITERATIONS_OF_START if k else MOST_ITERATIONS)
            for k, guess in enumerate(guesses)
        ]
        solutions = [_solution(mesh) for mesh in meshes]
        self.starts = [solution.objective if solution.is_optimum else np.nan for solution in solutions]
        return min(meshes, key=_order)

    def _error(self) -> tuple[float, bool]:
        """Return the estimated error of the objective, and whether it can be trusted.

        It can after three meshes, or if the objective does not change any more. Where conditions become active, two
        meshes may agree by accident: then it takes four meshes, or two changes of nothing.
        """
        floor, is_smooth = self._floor(), _solution(self.meshes[-1]).is_smooth
        changes = np.abs(np.diff([_solution(mesh).objective for mesh in self.meshes[self.halved :]]))
        if not len(changes):
            return np.inf, False
        settled = bool(np.all(changes[-1 if is_smooth else -2 :] <= floor)) and (is_smooth or len(changes) > 1)
        if settled or len(changes) == 1:
            return max(floor, float(changes[-1])), settled
        stages = len(self.transcription.c)
        order = 2 * stages if self.transcription.has_nodes else 2 * stages - 1
        last, accident = (2, ACCIDENT) if is_smooth else (3, ACCIDENT_OF_ACTIVE)
        return max(floor, extrapolated(changes[-last:], order, accident)), is_smooth or len(changes) > 2

    def _floor(self) -> float:
        solution = _solution(self.meshes[-1])
        return max(ROUNDING * abs(solution.objective), 2.0 * solution.gap)

    def _branches(self, mesh: Mesh, opens: np.ndarray, joints: Sequence[str]) -> str:
        place, ends = int(opens.argmax()), mesh.values["duration"] @ mesh.grid.ends
        begin = float(ends[place] - mesh.values["duration"] @ mesh.grid.lengths[:, place])
        return (
            f"jump: between t = {begin:.4g} and {float(ends[place]):.4g} s, bodies jump from one position to another: "
            f"the joint '{joints[place]}' is closed at the collocation points only; use revolute joints and slots, "
            "whose coordinates cannot jump, another `guess`, or conditions along the path"
        )

    def _failure(self, mesh: Mesh) -> str:
        if self.stop.interrupted:
            why = "interrupted: stopped by the user"
        elif self.stop.now:
            assert self.spec.limits is not None
            why = f"wall-time: stopped after limits.wall_time = {self.spec.limits.wall_time:g} s"
        else:
            status = _solution(mesh).status
            code, sentence = STATUSES.get(status, ("not-solved", f"the optimizer stopped: {status}"))
            largest = max(float(abs(mesh.values[name]).max(initial=0.0)) for name in OF_POINTS)
            if code == "iteration-limit" and largest > HUGE:
                code, sentence = "unbounded", f"unknowns grow to {largest:.1e}; give bounds to what is free"
            why = f"{code}: {sentence}, on a mesh of {len(mesh.grid.phase)} intervals"
            if code in ("infeasible", "iteration-limit") and not self.meshes:
                why += self._cause(mesh)
            if not self.transcription.is_guess_solved:
                why += "; the simpler problem of `guess` has no optimum either"
        if self.meshes:
            why += f"; the motion is the optimum on a mesh of {len(self.meshes[-1].grid.phase)} intervals"
        return why

    def _cause(self, mesh: Mesh) -> str:
        guess = self.transcription.guess()
        (found,) = results_of([lambda report: self.transcription.nearest_violations(guess, self.stop)], self.stop)
        largest = max((found or {}).items(), key=lambda x: x[1], default=None)
        if largest is not None and largest[1] > 1e-6:
            return f"; `{largest[0]}` cannot hold with the others: the nearest motion misses it by {largest[1]:.3g}"
        name, size = max(_solution(mesh).violations.items(), key=lambda x: x[1])
        if ": " in name:
            return f"; the largest violation is that of `{name}`, {size:.3g}"
        return "; motion does not lead from the start to the end within the bounds" if size > 1e-6 else ""


def extrapolated(changes: Sequence[float] | np.ndarray, order: int, accident: float) -> float:
    """Return the estimated error of the last value of a sequence, from the changes of its values by refinement.

    Halving all intervals divides the error by a constant ratio, at most 2^order, which two changes in a row show: the
    largest of them is taken. A last change below `accident` times the one before may be so small by accident.
    """
    before, last = float(changes[-2]), float(changes[-1])
    ratios = [float(after / change) if change else 1.0 for change, after in pairwise(changes)]
    ratio = min(max(*ratios, 2.0**-order, FASTEST), SLOWEST)
    return SAFETY * ratio / (1.0 - ratio) * max(last, before * accident)


def _mesh_limit(error: float, limit: float, residual: Residual, count: int) -> str:
    if error > limit:
        why = f"the error of the objective is still {error:.2g}, which is more than `tolerance`,"
    else:
        why = f"between collocation points, {residual.impulse.sum():.2g} of the impulse of all forces is not balanced"
    return f"mesh-limit: {why} on a mesh of {count} intervals"


def _solution(mesh: Mesh) -> Solution:
    assert mesh.solution is not None
    return mesh.solution


def _order(mesh: Mesh) -> tuple[bool, float, float]:
    """Return by what solutions are ordered: optima first, by their objective, and then by violations."""
    solution = _solution(mesh)
    worst = 0.0 if solution.is_optimum else max(solution.violations.values(), default=np.inf)
    return not solution.is_optimum, worst, solution.objective
