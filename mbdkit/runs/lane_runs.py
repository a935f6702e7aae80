"""Vectorized runs: prepares specs, advances runs that differ only in numbers together, and finishes them.

Each run is computed in a lane, an element of the SIMD vectors with which one loop advances several runs at once.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress

import numpy as np

from mbdkit.archive.finished_runs import FinishedRuns
from mbdkit.base.frozen import dataclass
from mbdkit.engine.consistent_start import CompiledForStarts, MechanismAtStart, Starts
from mbdkit.integrators.lane_stepper import PivotsAtStart
from mbdkit.integrators.lanes.lane_mechanisms import suits_lanes, topology_of
from mbdkit.mechanism.size import mechanism_sizes
from mbdkit.methods.kinds import Method
from mbdkit.runs.corners import check_jumps
from mbdkit.runs.findings import findings
from mbdkit.runs.integrals import functionals_of
from mbdkit.runs.lane_group import LaneGroup, LaneMember, PreparedRuns
from mbdkit.runs.law_ranges import has_ranges, steps_are_rows
from mbdkit.runs.preparation import make_method, timetable
from mbdkit.spec.run_spec import RunSpec
from mbdkit.trust.finding import Finding

#: Largest number of loops that are stored for later batches; each loop is for one mechanism and method.
MOST_GROUPS = 8


@dataclass(frozen=True)
class _Compiled:
    """A run whose settings can be vectorized, and its mechanism, which has not been assembled yet."""

    spec: RunSpec
    method: Method
    cautions: Sequence[Finding]
    compiled: CompiledForStarts


def why_alone(spec: RunSpec, measures: Sequence[str] = ()) -> str:
    """Return the reason why runs with these settings are not vectorized, as a clause; empty if they can be.

    Parameters
    ----------
    measures
        See `LaneRuns`.
    """
    reasons = (
        (spec.formulated.solves_multipliers, f"their formulation is {spec.formulated.name}"),
        (spec.stabilized.kind != "none", f"their stabilization is {spec.stabilized.kind}"),
        (bool(spec.events), "they have events"),
        (bool(spec.inputs), "their inputs are set by tables"),
        (spec.impacts == "allow", "their drivers may have impacts"),
        (spec.is_to_be_chosen, "`accuracy` chooses a method or step for each of them"),
        (spec.estimates_errors, "their errors are estimated"),
        (spec.limits.wall_time is not None, "their wall time is limited"),
    )
    if found := next((clause for holds, clause in reasons if holds), ""):
        return found
    functionals = functionals_of(spec, measures)
    if any(one.is_nested or not (one.is_extremum or one.is_value) for one in functionals):
        return "their measures contain integrals over time"
    if has_ranges(spec.mechanism()) and not steps_are_rows(spec):
        return "the ranges of their force laws are watched between the recorded states"
    if functionals and not steps_are_rows(spec):
        return "their measures contain extrema or `at`, and they do not record every step"
    mechanism = spec.mechanism()
    if functionals and (mechanism.state_names() or mechanism.controllers or mechanism.inputs):
        return "their measures contain extrema or `at`, and their mechanism has first-order states or inputs"
    method = make_method(spec)
    if method.traits.lanes is None or spec.claims.adaptive != (method.traits.tolerances is not None):
        return f"{spec.integrator_item.id} cannot be vectorized with these options"
    if spec.formulated.coordinates == "joint" and not method.traits.is_explicit:
        return f"{spec.integrator_item.id} cannot be vectorized in joint coordinates"
    return ""


def _starts(runs: Sequence[_Compiled | None]) -> Iterator[tuple[int, _Compiled, MechanismAtStart, float]]:
    """Yield index, mechanism at its start, and its size [m], of all runs with a consistent initial state."""
    alike: dict[CompiledForStarts, list[tuple[int, _Compiled]]] = defaultdict(list)
    for place, run in enumerate(runs):
        if run is not None:
            alike[run.compiled].append((place, run))
    for compiled, members in alike.items():
        some = []
        for place, run in members:
            with suppress(Exception, SystemExit):
                some.append((place, run, compiled.at_start(run.spec.mechanism(), run.spec.time.final)))
        if some:
            positions = np.stack([start.assembled.q for *_, start in some])
            sizes = mechanism_sizes([run.spec.mechanism() for _, run, _ in some], positions)
            for (place, run, start), size in zip(some, sizes.tolist(), strict=True):
                yield place, run, start, size


class LaneRuns:
    """Computes vectorized runs, and stores their loops for later runs.

    Parameters
    ----------
    starts
        Computes consistent initial states, and stores compiled mechanisms.
    measures
        Expressions that will be evaluated for the runs, in addition to the measures of their specs.
    """

    def __init__(self, starts: Starts, measures: Sequence[str]) -> None:
        self.measures = measures
        self._groups: dict[tuple[object, ...], LaneGroup] = {}
        self.starts, self.pivots = starts, PivotsAtStart()
        self._settings: tuple[tuple[object, ...], Method | None] | None = None

    def members(self, specs: Iterable[RunSpec]) -> list[LaneMember | None]:
        """Prepare runs for vectorization; None for a run that has to be computed alone.

        A run is computed alone if it cannot be vectorized, or if its preparation fails.
        """
        begin = time.perf_counter()
        runs = []
        for spec in specs:
            try:
                runs.append(self._compiled(spec))
            except (Exception, SystemExit):
                runs.append(None)
        members: list[LaneMember | None] = [None] * len(runs)
        for place, run, start, size in _starts(runs):
            with suppress(Exception, SystemExit):
                members[place] = self._member(run, start, size)
        seconds = (time.perf_counter() - begin) / max(1, len(members))
        for member in members:
            if member is not None:
                member.seconds = seconds
        return members

    def _compiled(self, spec: RunSpec) -> _Compiled | None:
        """Compile the mechanism of a run; None if it cannot be vectorized.

        Raises the same errors as a single run.
        """
        if (method := self._method(spec)) is None:
            return None
        check_jumps(spec)
        cautions = findings("spec", spec, self.measures)
        return _Compiled(spec, method, cautions, self.starts.compiled(spec.mechanism(), spec.time.start))

    def _method(self, spec: RunSpec) -> Method | None:
        """Return the method of a run; None if a run with these settings cannot be vectorized.

        Results are cached, because specs often share settings; methods of others that are not pure are created anew.
        """
        settings = (
            spec.formulation, spec.stabilization, spec.events, spec.check, spec.accuracy, spec.choose, spec.limits,
            spec.integrator, spec.measures, spec.inputs, spec.impacts,
        )  # fmt: skip
        chosen = filter(None, (spec.integrator_item, spec.step_control_item))
        if self._settings is None or settings != self._settings[0] or not all(item.is_pure for item in chosen):
            self._settings = settings, None if why_alone(spec, self.measures) else make_method(spec)
        return self._settings[1]

    def _member(self, run: _Compiled, start: MechanismAtStart, size: float) -> LaneMember | None:
        """Return the `LaneMember` of a run with its initial state; None if it cannot be vectorized."""
        spec, method = run.spec, run.method
        extent, size = size, size or start.mechanism.length
        table = timetable(spec, size)
        # Quantities of contacts and of plugins' elements are computed from numbers of the mechanism that all runs in a
        # vector would share.
        if start.mechanism.extensions or not suits_lanes(method, start.mechanism, table):
            return None
        pivots = self.pivots.of(method, start, table)
        found = (*run.cautions, *findings("start", spec, start.assembled))
        return LaneMember(spec, method, start, table, pivots, size, extent, found, topology_of(start.mechanism))

    def finished(self, members: Sequence[LaneMember]) -> Iterator[tuple[list[int], FinishedRuns | None]]:
        """Carry out runs, and yield indices and results of similar runs when they have ended.

        The results are None for runs that must be repeated alone.
        """
        groups: dict[tuple[object, ...], list[int]] = defaultdict(list)
        for place, member in enumerate(members):
            groups[member.key].append(place)
        for places in groups.values():
            group = self.group(members[places[0]])
            if members[places[0]].method.traits.tolerances:
                places = _by_cost(members, places)
            for first in range(0, len(places), group.size):
                some = places[first : first + group.size]
                prepared = PreparedRuns.of_members([members[place] for place in some])
                ended, runs = group.concluded(prepared, group.advanced(prepared), self.measures)
                if runs is not None:
                    yield [some[number] for number in ended], runs
                if len(ended) < len(some):
                    yield [place for number, place in enumerate(some) if number not in {*ended}], None

    def group(self, first: LaneMember) -> LaneGroup:
        """Return the group of runs with the key of `first`."""
        key = first.key
        group = self._groups.pop(key, None) or LaneGroup(first)
        self._groups[key] = group  # moves the group to the end; the group used least recently is discarded first
        if len(self._groups) > MOST_GROUPS:
            self._groups.pop(next(iter(self._groups)))
        return group


def _by_cost(members: Sequence[LaneMember], places: Sequence[int]) -> list[int]:
    """Return the indices of similar runs, sorted by their initial kinetic and gravitational energy.

    A loop ends when the run with the most steps does, so that runs in the same loop should have similar numbers of
    steps. In ensembles of double pendulums with different starts, this order keeps lanes busy in 83 to 87 % of the
    iterations, compared with 75 to 77 % without sorting. Sorting by the numbers of steps, which are not known in
    advance, would give 94 %.
    """
    starts = [members[place].start for place in places]
    tops = [start.mechanism.topology for start in starts]
    mass, gravity = np.stack([top.mass.ravel() for top in tops]), np.stack([top.gravity for top in tops])
    q, v = np.stack([start.q0 for start in starts]), np.stack([start.v0 for start in starts])
    with np.errstate(all="ignore"):
        fall = np.einsum("mbi,mi->m", (mass * q).reshape(len(places), -1, 3)[:, :-1, :2], gravity)
        energy = 0.5 * np.sum((mass * v * v)[:, :-3], axis=1) - fall
    return [places[place] for place in np.argsort(energy, kind="stable")]
