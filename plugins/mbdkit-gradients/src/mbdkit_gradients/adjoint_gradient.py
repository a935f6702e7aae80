"""Gradients by the adjoint: the cost of a few runs for each measure, for any number of parameters.

A run records the states at the ends of its steps. The derivatives of a measure with respect to these states are carried
back through the steps to the start; on the way, those with respect to the numbers of the mechanism are added up
(`mbdkit_gradients.kernels.adjoint`). Products with the derivatives of the preparation give the gradient.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np

from mbdkit.base.errors import RunError
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.table_rows import LAW_ROW, SPRING
from mbdkit.engine.observed_states import StateObserver
from mbdkit.integrators.duals.dual_run import NO_SEEDS, Seeds
from mbdkit.integrators.interface import SAME_TIME
from mbdkit.laws.tabulated import LAW as TABLE
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.methods.kinds import ExplicitRungeKutta, ImplicitRungeKutta, Method
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.states import States
from mbdkit.runs.continuous_motion import MotionPart, observed_at
from mbdkit.runs.preparation import RunSetup, make_method
from mbdkit.runs.step_interpolation import StepEnds
from mbdkit.spec.run_spec import RunSpec
from mbdkit_gradients.adjoint_events import AdjointCorner, AdjointEvent
from mbdkit_gradients.adjoint_measures import AdjointMeasure, Bars, Nodes, NotByAdjointError
from mbdkit_gradients.backward_sweep import ARRAYS, BackwardSweep, SweptPart
from mbdkit_gradients.differentiated_run import Needs, PassedEvent, differentiated_stepper, events_of
from mbdkit_gradients.differentiated_states import nearby
from mbdkit_gradients.law_corners import ForceCondition, doubts_of_kinds, with_sides, with_unknown_corners
from mbdkit_gradients.measured_derivatives import DerivedMeasure
from mbdkit_gradients.sided_stepper import SidedStepper

AROUND = 8  #: Number of step ends on both sides of a step that may determine the motion in it.


def why_forward(spec: RunSpec, method: Method, seeds: Seeds) -> str:
    """Return why the adjoint does not give gradients of runs of a spec, as a clause; empty if it does.

    What depends on the compiled mechanism is told by `AdjointRun`.
    """
    if not isinstance(method, ExplicitRungeKutta | ImplicitRungeKutta) or not method.traits.has_derivatives:
        return "the method is neither an explicit Runge-Kutta method nor a collocation method"
    if spec.formulated.name != "index-1":
        return f"the formulation is {spec.formulated.name}"
    if spec.stabilized.kind == "projection":
        return "states are projected"
    # lines of joints are read by their travel alone, which the adjoint does not differentiate
    taken = (*ARRAYS, "weight", "q", "v", "marker_points", "joint_lines")
    if unknown := [name for name in seeds.arrays if name not in taken]:
        known = {"motion_values": "motions or loads that are functions of time", "section_parameters": "beams"}
        of_measure = "numbers of measures" if "." in unknown[0] else "other elements"
        return f"parameters change {known.get(unknown[0], of_measure)}"
    return ""


@dataclass(eq=False)
class _Piece:
    """The first part of step `number`, up to an event; see `AdjointRun` for the other attributes."""

    method: ExplicitRungeKutta | ImplicitRungeKutta
    time: np.ndarray
    size: np.ndarray
    q: np.ndarray
    v: np.ndarray
    parts: Sequence[SweptPart]
    number: int


class AdjointRun:
    """A run whose measures are differentiated by the adjoint.

    Parameters
    ----------
    spec
        The run, for which `why_forward` gives no reason.
    seeds
        Derivatives of the prepared run with respect to the parameters.
    needs
        Data that the measures need.

    Raises
    ------
    NotByAdjointError
        If elements of the mechanism do not allow it.
    RunError
        If the run stops early.
    """

    is_split = False
    doubts: tuple[str, ...] = ()

    def __init__(self, spec: RunSpec, seeds: Seeds, needs: Needs):
        self.spec, self.seeds, self._needs = spec, seeds, needs
        method = make_method(spec)
        assert isinstance(method, ExplicitRungeKutta | ImplicitRungeKutta)
        setup = RunSetup.of(spec, method=method)
        self.method, self.workspace = method, setup.workspace
        self._check()
        self._table = replace(setup.timetable(), every=1)
        self._corners: list[AdjointCorner] = []
        self._sided: SidedStepper | None = None
        sided = with_sides(self.workspace.mechanism)
        if sided is None:
            stepper = setup.stepper(self._table)
        else:
            stepper = differentiated_stepper(spec, NO_SEEDS, Needs(), None, setup, every=1)
            assert isinstance(stepper, SidedStepper)
            self._sided, self.workspace, self.seeds = stepper, stepper.workspace, sided.seeds(seeds)
        time, q, v = self._stepped(stepper)
        self.time, self.q, self.v = np.array(time), np.array(q), np.array(v)
        size, step = np.diff(self.time), self._table.step
        self.size = size if step is None else np.where(np.abs(size - step) < 1e-9 * step, step, size)
        self.sizes = None if method.traits.tolerances is None else self.size.tolist()
        self._observer = StateObserver(self.workspace.with_own_pivots())
        self._adjoint = BackwardSweep(self.workspace, self.seeds)
        if self._sided is not None:
            self._take_corners(self._sided)
        self._pieces: list[_Piece] = []
        self._events = [self._event(event) for event in (events_of(spec, None) if spec.events else [])]

    def _stepped(self, stepper: Any) -> tuple[list[float], list[np.ndarray], list[np.ndarray]]:
        """Take all steps; return times, positions and velocities at the ends of all steps, and at the start."""
        work = self.workspace
        time, q, v = [work.t0], [work.q0], [work.v0]
        while not (stepper.finished or stepper.failure):
            rows = stepper.advance()
            if self._sided is None:
                time.extend(rows.time.tolist())
                q.extend(rows.q)
                v.extend(rows.v)
            elif stepper.time > time[-1]:  # parts of steps have no rows
                time.append(stepper.time)
                q.append(stepper.run_state.q.copy())
                v.append(stepper.run_state.v.copy())
        if stepper.failure:
            text = f"{stepper.failure.code}: {stepper.failure.sentence}"
            raise RunError(f"a run that stops early has no gradient: {text}")
        return time, q, v

    def _take_corners(self, stepper: SidedStepper) -> None:
        """Note the discontinuities of force laws, at which steps end; one at the end of the run has no effect."""
        for corner, (before, after) in zip(
            stepper.corners, pairwise(one.sides for one in stepper.history), strict=True
        ):
            node = int(np.argmin(np.abs(self.time - corner.before.time[0])))
            if node == len(self.time) - 1:
                break
            condition = stepper.conditions[corner.number]
            assert isinstance(condition, ForceCondition)
            if node == 0 or (self._corners and self._corners[-1].node == node):
                raise NotByAdjointError("force laws change their form at the start, or twice at one time")
            time, q, v = (np.repeat(x[node : node + 1], 2, axis=0) for x in (self.time, self.q, self.v))
            observed = [self._observed(time[:1], q[:1], v[:1], sides) for sides in (before, after)]
            states = States(self.workspace.mechanism, time, q, v, partial(_joined, observed))
            self._corners.append(AdjointCorner(node, condition, corner.rate, states, before))

    def _use(self, sides: np.ndarray | None) -> None:
        """Make force laws use the given sides of their discontinuities."""
        if self._sided is not None and sides is not None:
            self._sided.set_sides(sides)
            self._adjoint.use(sides, [one.side for one in self._sided.conditions])

    def _sides_at(self, node: int) -> np.ndarray | None:
        """Return the sides of force laws in the step that begins at the end of a step."""
        passed = sum(one.node <= node for one in self._corners)
        return None if self._sided is None else self._sided.history[passed].sides

    def _observed(self, time: np.ndarray, q: np.ndarray, v: np.ndarray, sides: np.ndarray | None) -> Observed:
        self._use(sides)
        return observed_at(self._observer, time, q, v, np.zeros((len(time), 0)))

    def _event(self, event: PassedEvent) -> AdjointEvent:
        """Return an event with its state, at the end of a piece of a step; end the run there if the event does."""
        n = int(np.clip(np.searchsorted(self.time, event.time), 1, len(self.time) - 1)) - 1
        share = min(1.0, (event.time - self.time[n]) / (self.time[n + 1] - self.time[n]))
        (number,) = (k for k, part in enumerate(self.parts) if part.begin <= n < part.end)
        part = replace(self.parts[number], begin=0, end=1)
        ends = slice(n, n + 2)
        piece = _Piece(self.method, self.time[ends].copy(), self.size[n : n + 1] * share, self.q[ends].copy(),
                       self.v[ends].copy(), [part], n)  # fmt: skip
        piece.time[1] = event.time
        if share < 1.0:
            piece.q[1], piece.v[1] = self._adjoint.end(piece)
        self._pieces.append(piece)
        if event.stops:
            self.time, self.size = np.append(self.time[: n + 1], event.time), np.append(self.size[:n], piece.size)
            self.q, self.v = (np.concatenate([x[: n + 1], y[1:]]) for x, y in ((self.q, piece.q), (self.v, piece.v)))
            self._corners = [one for one in self._corners if one.node <= n]
            del self.parts
        unit = self.spec.time.step or 1e-3
        states = partial(self._states, sides=self._sides_at(n))
        return AdjointEvent.at(event, piece.q[1], piece.v[1], unit, states)

    def _check(self) -> None:
        """Raise NotByAdjointError for a mechanism that the kernels do not differentiate."""
        mechanism, top, seeds = self.workspace.mechanism, self.workspace.mechanism.topology, self.seeds
        mechanism.refuse_kinds("gradients")
        kinds = {
            "first-order states or controllers": len(top.states) + len(top.inputs) + len(top.load_values),
            "friction in joints": len(top.frictions), "forces between bodies": len(top.interactions),
            "contacts": mechanism.reacting is not None, "redundant joints": len(top.spare),
            "kinds of plugins": len(mechanism.extensions), "beams": len(top.sections),
        }  # fmt: skip
        if reasons := [name for name, count in kinds.items() if count]:
            raise NotByAdjointError(f"the mechanism has {reasons[0]}")
        sided = with_sides(mechanism)
        is_known = sided is None or self.method.traits.tolerances is None
        for condition in () if sided is None else sided.conditions:
            is_known &= isinstance(condition, ForceCondition) and not len(condition.multipliers)
        if not is_known or with_unknown_corners(mechanism) or doubts_of_kinds(mechanism):
            raise NotByAdjointError(
                "force laws have, or may have, discontinuities at which steps do not end, or that depend on reactions"
            )
        points = seeds.get("spring_points")
        if points is not None and np.any(points[top.springs[:, SPRING.segments] != 1]):
            raise NotByAdjointError("parameters change points of a pathway with several segments")
        if self._table_arguments(top):
            raise NotByAdjointError(
                "parameters change the arguments of a table, or numbers of other laws than those of springs"
            )

    def _table_arguments(self, top: Any) -> bool:
        """Return whether parameters change numbers of laws that the kernels do not differentiate."""
        slopes = self.seeds.get("law_parameters")
        if slopes is None:
            return False
        changed, of_springs = np.any(slopes, axis=-1), np.zeros(len(slopes), dtype=bool)
        for law in top.springs[top.springs[:, SPRING.law] >= 0, SPRING.law]:
            begin = int(top.laws[law, LAW_ROW.parameters])
            count = int(top.law_parameters[begin])
            of_springs[begin + 1 : begin + 1 + count] = True
            if self.workspace.mechanism.laws[law][1].law is TABLE:
                pieces = int(top.law_parameters[begin + 2])
                of_springs[begin + 2 : begin + 4 + pieces] = False
        return bool(np.any(changed & ~of_springs))

    @cached_property
    def parts(self) -> list[SweptPart]:
        """The motion between stops."""
        table, time = self._table, self.time
        cuts = {0: np.inf, len(time) - 1: np.inf}  # no discontinuities, which have finite margins
        for stop, margin in zip(table.stops, table.stop_margins, strict=True):
            near = np.flatnonzero(np.abs(time - stop) <= SAME_TIME * margin) if margin else ()
            cuts |= {int(k): margin for k in near}
        corners = {one.node: number for number, one in enumerate(self._corners)}
        cuts = dict.fromkeys(corners, np.inf) | cuts
        borders, parts = sorted(cuts), []
        for begin, end in pairwise(borders):
            first, last = cuts[begin], cuts[end]
            sides = (time[begin] + first if first < np.inf else -np.inf, time[end] - last if last < np.inf else np.inf)
            some = slice(begin, end + 1)
            q, v = self.q[some], self.v[some]
            stiff, of_laws = self.method.traits.suits_stiff, self._sides_at(begin)
            acc = None if stiff else self._observed(np.clip(time[some], *sides), q, v, of_laws).acc
            ends = StepEnds(time[some], q, v, acc)
            motion = MotionPart(
                self._observer, archive_names(self.workspace.mechanism), ends, range(end - begin), sides
            )
            parts.append(SweptPart(begin, end, motion, corners.get(begin), partial(self._use, of_laws)))
        return parts

    def at(self, number: int, time: np.ndarray) -> States:
        """Return the states at times [s] in a part of the motion, or at the ends of all steps if `number` is -1."""
        part = self.parts[number].plain
        q, v = part.ends.at(time)
        return self._states(np.clip(time, *part.sides), q, v, self._sides_at(self.parts[number].begin))

    def _states(self, time: np.ndarray, q: np.ndarray, v: np.ndarray, sides: np.ndarray | None = None) -> States:
        return States(self.workspace.mechanism, time, q, v, lambda: self._observed(time, q, v, sides))

    def _states_of_parts(self, time: np.ndarray, q: np.ndarray, v: np.ndarray, each: int) -> States:
        """Return states in order of time, `each` for each step; one may be at the end."""
        if self._sided is None:
            return self._states(time, q, v)

        def observed() -> Observed:
            ends = [each * part.end for part in self.parts[:-1]] + [len(time)]
            some = [slice(*both) for both in pairwise([0, *ends])]
            sides = [self._sides_at(part.begin) for part in self.parts]
            return _joined([self._observed(time[x], q[x], v[x], one) for x, one in zip(some, sides, strict=True)])

        return States(self.workspace.mechanism, time, q, v, observed)

    @cached_property
    def rows(self) -> States:
        """The states at the ends of all steps."""
        self.workspace.clamp_motions(-np.inf, np.inf)
        return self._states_of_parts(self._table.before(self.time), self.q, self.v, 1)

    @cached_property
    def held(self) -> tuple[States, float]:
        """Position and velocity of the last state at eight times around the end, and the time [s] between these."""
        offsets, distance = nearby(self.spec.time.step or 1e-3)
        q, v = (np.repeat(x[-1:], len(offsets), axis=0) for x in (self.q, self.v))
        return self._states(self.time[-1] + offsets, q, v, self._sides_at(len(self.time) - 2)), distance

    def measures(self, expressions: Mapping[str, MeasureExpression]) -> dict[str, DerivedMeasure]:
        """Return measures with their derivatives; raise NotByAdjointError if the adjoint does not give them."""
        nodes = None
        if self._needs.nodes:
            time, weight, q, v = self._adjoint.stages(self)
            nodes = Nodes(self._states_of_parts(time, q, v, len(self.method.tableau.floats()[1])), weight)
        motions = [SimpleNamespace(parts=self.parts)] if self._needs.ends else []
        run = {"rows": self.rows, "nodes": nodes, "motions": motions}
        events = [one.event for one in self._events]
        corners = [one.states for one in self._corners]
        found = {name: AdjointMeasure(run, self, one, events, corners).bars() for name, one in expressions.items()}
        return {
            name: derived._replace(slope=self._slope(bars, times)) for name, (derived, bars, times) in found.items()
        }

    def _slope(self, bars: list[Bars], times: np.ndarray) -> np.ndarray:
        """Return the derivatives (K,) of a measure given those by states and by times of events and corners."""
        own, stages = self._adjoint, len(self.method.tableau.floats()[1])
        own.clear()
        q_bar, v_bar, *before = np.zeros((4, *self.q.shape))  # `before`: with respect to states before corners
        nodes = {one.node for one in self._corners}
        stage_bars: list[np.ndarray] = []
        marker_points = np.zeros(self.workspace.mechanism.topology.marker_points.shape)
        times, of_corners = np.split(times, [len(self._events)])
        for one in bars:
            given = self._pulled(one, stages)
            marker_points += one.markers.sum(axis=0)
            if one.part == -1:
                q_bar[-1] += given[0][0]
                v_bar[-1] += given[1][0]
                if self._events and self._events[-1].event.stops:  # the end moves along the motion
                    end = self._events[-1].states
                    times = times.copy()
                    times[-1] += given[0][0] @ end.v[0] + given[1][0] @ end.observed.acc[0]
            elif one.part == -2:
                stage_bars = [
                    x + y for x, y in zip(stage_bars or given, given if stage_bars else (0.0, 0.0), strict=True)
                ]
            else:
                part = self.parts[one.part]
                for target, last, x in zip((q_bar, v_bar), before, self._to_ends(one, *given), strict=True):
                    target[part.begin : part.end] += x[:-1]
                    (last if part.end in nodes else target)[part.end] += x[-1]
        for event, piece, by_time in zip(self._events, self._pieces, times, strict=True):
            if by_time == 0.0:
                continue
            one = event.bars(by_time, self.workspace.mechanism)
            piece.parts[0].use()
            q, v = (np.concatenate([np.zeros(x.shape), x]) for x in own.pulled(one))
            marker_points += one.markers.sum(axis=0)
            own.sweep(piece, q, v, [])
            q_bar[piece.number] += q[0]
            v_bar[piece.number] += v[0]

        def pass_corner(number: int) -> None:
            corner = self._corners[number]
            by_time = of_corners[number] + v_bar[corner.node] @ corner.jump
            self._use(corner.sides)
            one = corner.bars(by_time, self.workspace.mechanism, own.bundle.law_parameters)
            for target, last, x in zip((q_bar, v_bar), before, own.pulled(one), strict=True):
                target[corner.node] += last[corner.node] + x[0]

        own.sweep(self, q_bar, v_bar, stage_bars, pass_corner)
        slope = np.zeros(self.seeds.count)
        arrays = {**{name: getattr(own.bundle, name) for name in ARRAYS}, "marker_points": marker_points}
        for name, x in (*arrays.items(), ("q", q_bar[0]), ("v", v_bar[0])):
            if (seeds := self.seeds.get(name)) is not None:
                slope += np.tensordot(x, seeds, x.ndim)
        return slope

    def _pulled(self, one: Bars, stages: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives (T, n + 3) with respect to positions and velocities of T states."""
        if self._sided is None:
            return self._adjoint.pulled(one)
        if one.part != -2:
            self.parts[one.part].use()
            return self._adjoint.pulled(one)
        found = []
        for part in self.parts:
            part.use()
            found.append(self._adjoint.pulled(one.rows(slice(stages * part.begin, stages * part.end))))
        q, v = (np.concatenate(x) for x in zip(*found, strict=True))
        return q, v

    def _to_ends(self, one: Bars, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return derivatives with respect to the ends of the steps of a part, given those with respect to states
        between these.
        """
        part = self.parts[one.part]
        ends, plain = part.plain.ends, part.plain
        q_bar, v_bar, acc_bar = np.zeros((3, len(ends.time), q.shape[1]))
        step = np.clip(np.searchsorted(ends.time, one.states.time, side="right") - 1, 0, len(ends.time) - 2)
        for number in np.unique(step):
            some = np.flatnonzero(step == number)
            window = slice(max(0, number - AROUND), min(len(ends.time), number + AROUND + 2))
            weights = _weights(ends.time[window], np.clip(one.states.time[some], *part.span), ends.a is not None)
            for rows, x in zip(weights, (q[some], v[some]), strict=True):
                for target, by in zip((q_bar, v_bar, acc_bar), rows, strict=False):
                    target[window] += by.T @ x
        if ends.a is not None and np.any(acc_bar):
            used = np.flatnonzero(np.any(acc_bar, axis=1))
            seen = np.clip(ends.time[used], *plain.sides)
            given = Bars(one.part, self._states(seen, ends.q[used], ends.v[used]), self.workspace.mechanism)
            given.acc += acc_bar[used]
            more_q, more_v = self._pulled(given, 0)
            q_bar[used] += more_q
            v_bar[used] += more_v
        return q_bar, v_bar


def _joined(observed: Sequence[Observed]) -> Observed:
    return Observed(*(np.concatenate(x) for x in zip(*observed, strict=True)))


def _weights(time: np.ndarray, at: np.ndarray, uses_accelerations: bool) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return positions and velocities at times (T,) as weights (T, N) of positions, velocities and accelerations at N
    ends of steps.
    """
    count, axes = len(time), 3 if uses_accelerations else 2
    unit = np.eye(axes * count).reshape(axes, count, -1)
    ends = StepEnds(time, unit[0], unit[1], unit[2] if uses_accelerations else None)
    return tuple(np.split(x, axes, axis=1) for x in ends.at(at))  # type: ignore[return-value]
