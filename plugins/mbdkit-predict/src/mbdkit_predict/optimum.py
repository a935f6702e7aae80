"""Finds the optimum of a spec: several first guesses, finer and finer meshes, and the error of the objective."""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mbdkit.base.text import listed
from mbdkit_predict.between_conditions import Violation, violations_between
from mbdkit_predict.between_points import FEW, NODES, Residual, change_by_held, residual_between_points
from mbdkit_predict.jumps import Jump, jumps_along
from mbdkit_predict.nonlinear_program import LIMITED, MOST_ITERATIONS, STATUSES, Solution
from mbdkit_predict.point_functions import OF_POINTS
from mbdkit_predict.pontryagin import MinimumPrinciple, minimum_principle
from mbdkit_predict.predict_spec import NOTHING, ROUNDING, SAME, PredictSpec
from mbdkit_predict.processes import Stop, results_of
from mbdkit_predict.switching import switching_of
from mbdkit_predict.transcription import MOST_UNEVEN, Mesh, Switching, Transcription, solved_meshes

#: A start from the optimum on a coarser mesh wanders if it takes so many iterations, or if it takes `FEW_STEPS` and the
#: objective changes by a share of `ELSEWHERE`. Of about 200 such starts in 60 drawn problems, one does, rightly. Where
#: the optimum on the coarser mesh is an artefact, they take a hundred iterations, and lead anywhere.
WANDERING, FEW_STEPS, ELSEWHERE = 90, 15, 0.25
#: Largest first-order change of the objective by what remains between the points, as a share of the objective, of a
#: motion that begins a sequence of meshes. That of artefacts is as large as the objective, or larger.
CREDIBLE = 0.25
#: Least share of the time in which controls that are not determined may change: with constant derivatives, those in the
#: one interval of a switch may.
LEAST_SHARE = 0.1
MOST_INTERVALS = 640  #: Largest number of intervals of a refined mesh; every first mesh is refined once.
ITERATIONS_OF_START = 500  #: Largest number of iterations from a drawn guess.
VARIATIONS = 5  #: How often a search begins anew with controls that make the Hamiltonian least.
SWITCHINGS = 3  #: How often phases are made of the jumps that a motion passes.
HUGE = 1e8  #: Unknowns above this size at the limit of iterations are taken for unbounded ones.
#: Share of the largest distance of bodies by which joints must not open between collocation points, and how often the
#: intervals in which they do are divided.
OPEN, DIVISIONS = 0.1, 2
MOST_CUTS = 8  #: How often meshes are cut where a condition is exceeded between the points.
#: Factors of the estimated error of the objective, and of its first-order change by what remains between the points.
SAFETY, HIGHER_ORDER = 3.0, 1.5
#: Smallest ratio of two changes of the objective in a row that is believed; the second one, where conditions become
#: active.
ACCIDENT, ACCIDENT_OF_ACTIVE = 2.0**-10, 2.0**-5
#: Largest and smallest ratio of two changes of the objective in a row with which the error is extrapolated. Where
#: conditions become active, methods of high order have no constant ratio.
SLOWEST, FASTEST = 0.5, 2.0**-4
TOGETHER = 1e-4  #: Jumps at a distance below this share of the duration count as passed at once.
AT_ONCE = (
    "The motion passes two jumps at once, or one at its end: their order, which is that of the first motion "
    "found, may not be the best one. Begin with a guess that passes them in another order."
)
HELD = (
    "Jumps are held on their sides up to the ends of phases; where the motion is on another side, or jumps take time, "
    "this changes the objective by {change:.2g} and {impulse:.2g} of the impulse of all forces."
)


Problem = tuple[Transcription, Mesh, int]  #: A problem, its first guess, and the largest number of iterations.


class SolvedMesh(NamedTuple):
    """A row of the table of meshes."""

    intervals: int | tuple[int, ...]  #: Of each phase, if there are several.
    points: int  #: Collocation points of each interval.
    objective: float | None  #: None where no optimum was found.
    iterations: int  #: Those on this mesh.
    why: str  #: Why there is this mesh.


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
        Objective from each first guess, on the mesh that begins the sequence; nan where no optimum was found, or one
        that is an artefact of the mesh while others are not.
    start
        Index of the start that led to this motion.
    rows
        The table of all meshes.
    wandered
        Whether the search began anew, because the first meshes led to different motions.
    flat
        `Solution.undetermined` on the first mesh.
    principle
        How far the motion is from the minimum principle; None if that is not known.
    doubt
        Sentence on jumps that are not held; empty without any.
    """

    transcription: Transcription
    mesh: Mesh
    meshes: Sequence[Mesh]
    error: float
    reason: str
    jumps: Sequence[Jump]
    starts: Sequence[float]
    start: int
    rows: Sequence[SolvedMesh]
    wandered: bool
    flat: Mapping[str, np.ndarray]
    principle: MinimumPrinciple | None
    doubt: str = ""

    @property
    def spec(self) -> PredictSpec:
        """The spec of the problem."""
        return self.transcription.spec

    @property
    def is_doubtful(self) -> bool:
        """Whether the motion passes jumps that are not held, or on whose other side it is."""
        return bool(self.doubt) or any(jump.name for jump in self.jumps)

    @property
    def is_minimum(self) -> bool:
        """Whether the second-order condition holds."""
        return self.is_optimum and _solution(self.mesh).is_strict

    @property
    def undetermined(self) -> tuple[str, bool]:
        """Sentence on controls that may change without a change of the objective, empty if there are none, and whether
        the motion may change as well.
        """
        free = self.flat
        if not free:
            return "", False
        u = free["u"] * self.transcription.control_sizes[:, None]
        times = abs(u).max(axis=0, initial=0.0)
        if (times > 0.1 * times.max(initial=0.0)).mean() < LEAST_SHARE:
            return "", False
        sides, sizes, _ = np.linalg.svd(u, full_matrices=False)
        names, shares = self.transcription.system.control_names, abs(sides[:, 0])
        chosen = np.flatnonzero(shares > 1e-3 * shares.max())
        named = listed([f"`{names[k]}`" for k in chosen], "and")
        is_one = len(sizes) < 2 or sizes[1] <= 1e-3 * sizes[0]
        ratio = ":".join(f"{sides[k, 0] / sides[chosen[0], 0]:.4g}" for k in chosen)
        how = f" in the ratio {ratio}" * (is_one and len(chosen) > 1)
        largest = {name: float(abs(x).max(initial=0.0)) for name, x in free.items()}
        moves = max(largest[name] for name in ("q", "z", "p", "duration")) > 1e-6 * largest["u"]
        return f"Controls are not determined: {named} may change{how} without a change of the objective", moves

    @property
    def ending_here(self) -> int:
        """Number of first guesses that lead to this motion."""
        return int(self._ends_here.sum())

    @property
    def _ends_here(self) -> np.ndarray:
        own = self.starts[self.start]
        return np.asarray(abs(np.array(self.starts) - own) <= SAME * abs(own) + NOTHING * self.mesh.size)

    @property
    def basin(self) -> str:
        """Sentence on where the first guesses end; empty if there is only one."""
        ended, here = np.array(self.starts), self._ends_here
        others = ended[~here & np.isfinite(ended)]
        if len(ended) < 2 or not here.any():
            return ""
        text = f"Local minimum: {here.sum()} of {len(ended)} starts end here"
        if others.size:
            share = 100.0 * (others.min() - ended[self.start]) / max(abs(ended[self.start]), NOTHING * self.mesh.size)
            text += f", the best of the others is {abs(share):.2g} % {'higher' if share > 0.0 else 'lower'}"
        return text + "."

    @property
    def is_optimum(self) -> bool:
        """Whether the motion is an optimum, on one mesh at least."""
        return bool(self.meshes)

    @property
    def objective(self) -> float:
        """Value of the objective."""
        return _solution(self.mesh).objective

    @property
    def limit(self) -> float:
        """Largest error of the objective within `tolerance`."""
        return self.spec.tolerance * abs(self.objective) + NOTHING * self.mesh.size

    @property
    def costates(self) -> Mapping[str, np.ndarray]:
        """Derivatives (T,) of the objective by each state, at the start, the collocation points, and the end."""
        return self.transcription.costates(self.mesh) if self.is_optimum else {}

    @property
    def sensitivities(self) -> dict[str, float]:
        """Derivatives of the optimum: by numbers of the model, fixed durations, and values at the start and the end."""
        slopes, names = _solution(self.mesh).slopes, self.transcription.system.parameter_names
        by_parameter = dict(zip(names, slopes["p"].tolist(), strict=True))
        parts = [np.flatnonzero(self.transcription.phase_of == k) for k in range(len(self.spec.whole))]
        by_duration = {
            f"{place}duration": float(slopes["duration"][own[0]] if len(own) == 1 else slopes[f"duration {k}"][0])
            for k, (own, (place, phase)) in enumerate(zip(parts, self.spec.whole.items(), strict=True))
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
_Solving = Generator[list[Problem], list[Mesh], Mesh]


class _MeshSearch:
    """Refines meshes until the error of the objective is known to be small enough."""

    first: Mesh  #: The solution that begins the sequence of meshes.

    def __init__(self, transcription: Transcription, stop: Stop):
        self.spec, self.transcription, self.stop = transcription.spec, transcription, stop
        self.meshes, self.starts, self.start = list[Mesh](), list[float](), 0
        self.rows, self.wandered = list[SolvedMesh](), False
        self.switching: Switching | None = None
        self.problems = dict[int, Transcription]()  # by number of collocation points
        self.halved = 0  # index of the mesh from which on all intervals are divided

    def run(self) -> _Search:
        """Yield problems to solve, take their solutions, and return the best motion; with jumps held on their sides at
        the ends of phases, and with further phases that end at jumps if the spec asks for these.
        """
        if self.spec.switching:
            original = self.transcription
            first = yield from self._search(is_brief=True)
            found = yield from self._switched(first)
            if self.stop.now and found.mesh is first.mesh:  # an optimum of one mesh, whose phases are whole
                found = replace(found, reason=self._failure(found.mesh))
            if self.stop.now or (found.meshes and not found.is_doubtful):
                return found
            self.transcription, self.switching = original, None  # a jump of the first mesh may be none on a finer one
        return (yield from self._switched((yield from self._search())))

    def _switched(self, found: Optimum) -> _Search:
        """Return the best motion with phases that end at the jumps of another one; that itself without any."""
        for _ in range(SWITCHINGS):
            if self.stop.now or not found.jumps:
                break
            is_passed = self.switching is not None or any(jump.name for jump in found.jumps)
            is_divided = is_passed and self.spec.switching == "auto"
            switching = switching_of(found.transcription, found.mesh, found.jumps, is_divided=is_divided)
            if isinstance(switching, str):
                return replace(found, doubt=switching or found.doubt)
            self.transcription, self.switching = found.transcription.switched(switching), switching
            switched = yield from self._search()
            if not switched.meshes:
                break
            found = self._checked(switched)
            if not found.is_doubtful:
                break
        return found

    def _checked(self, found: Optimum) -> Optimum:
        """Return an optimum with the error that is due to jumps that are held, and a doubt if that is large."""
        change, impulse = change_by_held(found.transcription, found.mesh)
        error = found.error + HIGHER_ORDER * abs(change)
        limit = self.spec.tolerance * abs(found.objective) + NOTHING * found.mesh.size
        doubt = HELD.format(change=change, impulse=impulse)
        durations = found.mesh.values["duration"]
        if durations.min() < TOGETHER * durations.sum():
            return replace(found, error=error, doubt=AT_ONCE)
        is_small = error <= limit and impulse <= math.sqrt(self.spec.tolerance)
        return replace(found, error=error, doubt="" if is_small else doubt)

    def _search(self, *, is_brief: bool = False) -> _Search:
        """Refine meshes; with `is_brief`, return the first one if its motion passes a jump."""
        self.meshes, self.problems, self.wandered = [], {}, False
        mesh, error, reason = (yield from self._begin(is_brief=is_brief)), math.nan, ""
        if is_brief and not self.stop.now:
            jumps, own = jumps_along(self.transcription, mesh), [mesh] * _solution(mesh).is_optimum
            if any(jump.name for jump in jumps):
                return self._optimum(mesh, own, error, self._failure(mesh), jumps)
        divisions, cuts, is_resolved = 0, 0, False
        while _solution(mesh).is_optimum:
            opens, joints = self.transcription.openings(mesh)
            if opens.max() > OPEN and divisions == DIVISIONS:
                reason = self._branches(mesh, opens, joints)
                break
            if opens.max() > OPEN:
                divisions, self.halved = divisions + 1, len(self.meshes)
                mesh = yield from self._refine(mesh, opens > OPEN, "in which joints open")
                continue
            count, limit = len(mesh.grid.phase), self._limit(mesh)
            limits = limit / HIGHER_ORDER, math.sqrt(self.spec.tolerance)
            violations = violations_between(self.transcription, mesh)
            large_ones = [violation for violation in violations if violation.is_large(*limits)]
            if cuts < MOST_CUTS and (narrow := [violation for violation in large_ones if violation.is_narrow]):
                cuts, mesh = cuts + 1, (yield from self._cut(mesh, narrow))
                continue
            self.meshes.append(mesh)
            error, is_known = self._error()
            is_last = len(self.meshes) > self.halved + 1 and 2 * count > MOST_INTERVALS
            is_accurate, chosen = is_known and error <= limit, None
            if is_accurate or is_last or not is_resolved:
                residual = residual_between_points(self.transcription, mesh, NODES if is_accurate or is_last else FEW)
                for violation in violations:
                    residual.change[violation.interval] = abs(residual.change[violation.interval]) + violation.change
                large = residual.is_large(*limits)
                large[[violation.interval for violation in violations if violation.share > limits[1]]] = True
                is_resolved = not large.any()
                if is_accurate or is_last:
                    error = max(error, HIGHER_ORDER * float(abs(residual.change).sum()))
                    if is_last and (error > limit or not is_resolved):
                        reason = _mesh_limit(error, limit, residual, count, large_ones)
                    if is_last or is_resolved:
                        break
                # all intervals are halved unless few of them have almost all that remains
                if is_accurate or 0 < large.sum() <= MOST_UNEVEN * count < MOST_UNEVEN * MOST_INTERVALS / 2:
                    chosen, self.halved = large, len(self.meshes)
            mesh = yield from self._refine(mesh, chosen, "with what remains between the points")
        if not _solution(mesh).is_optimum and not reason:
            reason = self._failure(mesh)
        best = self.meshes[-1] if self.meshes else mesh
        error = error if math.isfinite(error) else math.nan
        jumps = jumps_along(self.problems[len(best.grid.c)], best) if self.meshes and not self.stop.now else []
        return self._optimum(best, self.meshes, error, reason, jumps)

    def _optimum(
        self, mesh: Mesh, meshes: Sequence[Mesh], error: float, reason: str, jumps: Sequence[Jump]
    ) -> Optimum:  # fmt: skip
        method = self.problems[len(mesh.grid.c)]
        flat = _solution(self.first).undetermined
        principle = minimum_principle(method, mesh) if meshes and not self.stop.now else None
        return Optimum(
            method,
            mesh,
            meshes,
            error,
            reason,
            jumps,
            self.starts,
            self.start,
            self.rows,
            self.wandered,
            flat,
            principle,
        )

    def _begin(self, coarser: Mesh | None = None, *, is_brief: bool = False) -> _Solving:
        """Solve from all first guesses, and from the motion of a coarser mesh, without its multipliers; return the best
        solution.
        """
        random, method = np.random.default_rng(self.spec.seed), self.transcription
        moved, grid = list[Mesh](), None
        if coarser is not None:
            method = method.of_high_order()
            halved = coarser.grid.divided(np.full(len(coarser.grid.phase), 2))
            moved = [self.transcription.moved(coarser, method, halved)]
            grid = moved[0].grid
        switching = self.switching if coarser is None else None
        count = 1 if switching else self.spec.starts
        guesses = [method.guess(random if k else None, self.stop, grid) for k in range(count)] + moved
        meshes = yield [
            (method, guess, ITERATIONS_OF_START if k or is_brief else MOST_ITERATIONS)
            for k, guess in enumerate(guesses)
        ]
        self.transcription, self.problems[len(method.c)], self.halved = method, method, len(self.meshes)
        is_credible = [len(meshes) == 1 or self._is_credible(mesh) for mesh in meshes]
        start = min(range(len(meshes)), key=lambda k: (not is_credible[k], *_order(meshes[k])))
        self.first, why = meshes[start], "first mesh" if coarser is None else "anew, all intervals halved"
        if switching:
            why = f"phases end at jumps: t = {listed([f'{t:.4g}' for t in switching.times], 'and')} s"
        else:
            ended = [_solution(x).objective if _solution(x).is_optimum else np.nan for x in meshes]
            self.starts = np.where(np.less(is_credible, is_credible[start]), np.nan, ended).tolist()
            self.start = start
        self._note(self.first, why + f", best of {len(meshes)} starts" * (len(meshes) > 1))
        if coarser is not None and not is_credible[start] and _solution(self.first).is_optimum and self._can_begin:
            return (yield from self._begin(self.first))
        yield from self._vary()
        return self.first

    def _vary(self) -> Generator[list[Problem], list[Mesh], None]:
        """Solve from the controls that make the Hamiltonian least, as long as this leads to a smaller objective."""
        for _ in range(VARIATIONS):
            if self.stop.now or not _solution(self.first).is_optimum:
                break
            method, objective = self.transcription, _solution(self.first).objective
            principle = minimum_principle(method, self.first)
            if principle is None or principle.gain <= self._limit(self.first):
                break
            values = {**self.first.values, "u": principle.controls}
            guess = replace(self.first, values=values, solution=None, slopes=None)
            (other,) = yield [(method, guess, ITERATIONS_OF_START)]
            self._note(other, "from controls that make the Hamiltonian least")
            if not _solution(other).is_optimum or _solution(other).objective >= objective - self._limit(other):
                break
            self.first = other

    def _limit(self, mesh: Mesh) -> float:
        return self.spec.tolerance * abs(_solution(mesh).objective) + NOTHING * mesh.size

    def _cut(self, mesh: Mesh, narrow: Sequence[Violation]) -> _Solving:
        """Solve on a mesh with intervals that end where conditions are exceeded, which begins a new sequence."""
        method, self.halved = self.transcription, len(self.meshes)
        grid = mesh.grid.cut(mesh.values["duration"], [time for violation in narrow for time in violation.cuts])
        (self.first,) = yield [(method, method.moved(mesh, method, grid), MOST_ITERATIONS)]
        self._note(self.first, f"cut where `{narrow[0].name}` is exceeded between the points")
        return self.first

    def _refine(self, mesh: Mesh, chosen: np.ndarray | None, which: str) -> _Solving:
        """Solve on a finer mesh from the optimum on a coarser one, or anew if that wanders."""
        first, method, guess = self.first, self.transcription, self.transcription.refined(mesh, chosen)
        why = "all intervals divided" if chosen is None else f"{chosen.sum()} divided, {which}"
        if self._can_begin:
            (finer,) = yield [(method, guess, WANDERING)]
            if self.stop.now or not _wanders(_solution(mesh), _solution(finer)):
                self._note(finer, why)
                return finer
            self._note(finer, why + "; the start wanders")
            anew = yield from self._begin(self.first)
            if _solution(anew).is_optimum or self.stop.now:
                self.wandered = True
                return anew
            self.transcription, self.first = method, first
        (finer,) = yield [(method, guess, MOST_ITERATIONS)]
        self._note(finer, why)
        return finer

    @property
    def _can_begin(self) -> bool:
        return 2 * len(self.first.grid.phase) <= MOST_INTERVALS

    def _is_credible(self, mesh: Mesh) -> bool:
        """Return whether a motion is an optimum that what remains between the points hardly changes."""
        solution, size = _solution(mesh), NOTHING * mesh.size
        if not solution.is_optimum:
            return False
        change = abs(residual_between_points(self.transcription, mesh, FEW).change).sum()
        return bool(change <= CREDIBLE * abs(solution.objective) + size)

    def _note(self, mesh: Mesh, why: str) -> None:
        solution, counts = _solution(mesh), mesh.grid.counts
        objective = solution.objective if solution.is_optimum else None
        intervals = counts[0] if len(counts) == 1 else counts
        self.rows.append(SolvedMesh(intervals, len(mesh.grid.c), objective, solution.iterations, why))

    def _error(self) -> tuple[float, bool]:
        """Return the estimated error of the objective, and whether it can be trusted.

        It can after three meshes, or if the objective does not change any more. Where conditions become active, two
        meshes may agree by accident: then it takes four meshes, or two changes of nothing.
        """
        last = _solution(self.meshes[-1])
        floor, is_smooth = max(ROUNDING * abs(last.objective), 2.0 * last.gap), last.is_smooth
        changes = np.abs(np.diff([_solution(mesh).objective for mesh in self.meshes[self.halved :]]))
        if not len(changes):
            return np.inf, False
        settled = bool(np.all(changes[-1 if is_smooth else -2 :] <= floor)) and (is_smooth or len(changes) > 1)
        if settled or len(changes) == 1:
            return max(floor, float(changes[-1])), settled
        stages = len(self.transcription.c)
        order = 2 * stages if self.transcription.has_nodes else 2 * stages - 1
        count, accident = (2, ACCIDENT) if is_smooth else (3, ACCIDENT_OF_ACTIVE)
        return max(floor, extrapolated(changes[-count:], order, accident)), is_smooth or len(changes) > 2

    def _branches(self, mesh: Mesh, opens: np.ndarray, joints: Sequence[str]) -> str:
        place, ends = int(opens.argmax()), mesh.values["duration"] @ mesh.grid.ends
        begin = float(ends[place] - mesh.values["duration"] @ mesh.grid.lengths[:, place])
        return (
            f"jump: between t = {begin:.4g} and {float(ends[place]):.4g} s, bodies jump from one position to another: "
            f"the joint '{joints[place]}' is closed at the collocation points only; use revolute joints, "
            "slots, and distances to point masses, whose coordinates cannot jump, another `guess`, or conditions along "
            "the path"
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


def _mesh_limit(
    error: float, limit: float, residual: Residual, count: int, violations: Sequence[Violation]
) -> str:  # fmt: skip
    if violations:
        name, time, _, size, *_ = violations[0]
        why = f"between collocation points, `{name}` is exceeded by {size:.2g} at t = {time:.6g} s,"
    elif error > limit:
        why = f"the error of the objective is still {error:.2g}, which is more than `tolerance`,"
    else:
        why = f"between collocation points, {residual.impulse.sum():.2g} of the impulse of all forces is not balanced"
    return f"mesh-limit: {why} on a mesh of {count} intervals"


def _solution(mesh: Mesh) -> Solution:
    assert mesh.solution is not None
    return mesh.solution


def _wanders(before: Solution, after: Solution) -> bool:
    change = abs(after.objective - before.objective)
    is_elsewhere = after.iterations > FEW_STEPS and change > ELSEWHERE * max(abs(x.objective) for x in (before, after))
    return after.status == LIMITED or (after.is_optimum and is_elsewhere)


def _order(mesh: Mesh) -> tuple[bool, float, float]:
    """Return by what solutions are ordered: optima first, by their objective, and then by violations."""
    solution = _solution(mesh)
    worst = 0.0 if solution.is_optimum else max(solution.violations.values(), default=np.inf)
    return not solution.is_optimum, worst, solution.objective
