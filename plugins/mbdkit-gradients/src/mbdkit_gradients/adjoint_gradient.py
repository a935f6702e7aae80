"""Gradients by the adjoint: the cost of a few runs for each measure, for any number of parameters.

A run records the states at the ends of its steps. The derivatives of a measure with respect to these states are carried
back through the steps to the start; on the way, those with respect to the numbers of the mechanism are added up
(`mbdkit_gradients.kernels.adjoint`). Products with the derivatives of the preparation give the gradient.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property, partial
from itertools import pairwise
from tempfile import SpooledTemporaryFile
from types import SimpleNamespace
from typing import Any

import numpy as np

from mbdkit.base.errors import RunError
from mbdkit.engine.consistent_start import Starts
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.table_rows import INTERACTION, LAW_ROW, SPRING
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
from mbdkit_gradients.adjoint_measures import AdjointMeasure, Bars, LongStates, MakeBars, Nodes, NotByAdjointError
from mbdkit_gradients.backward_sweep import ARRAYS, BackwardSweep, SweptPart, SweptSteps, keep_stages, row_size
from mbdkit_gradients.differentiated_run import Needs, PassedEvent, differentiated_stepper, doubts_of_laws, events_of
from mbdkit_gradients.differentiated_states import nearby
from mbdkit_gradients.law_corners import with_sides
from mbdkit_gradients.measured_derivatives import DerivedMeasure
from mbdkit_gradients.sided_stepper import SidedStepper
from mbdkit_gradients.table_derivatives import contract, touched_laws

AROUND = 8  #: Number of step ends on both sides of a step that may determine the motion in it.
#: Largest number of values of positions at the stages of steps that are computed at once.
WINDOW = 250_000
#: Largest size of the stored states [bytes], and of the derivatives with respect to them; larger arrays are in files.
MOST_BYTES = 256_000_000
#: Memory of the last run of the thread, if it is not larger than `MOST_SPARE` [bytes]; to get new memory can take as
#: long as half of the steps.
_spare = threading.local()
MOST_SPARE = 32_000_000
BLOCK = 1_000_000  #: Number of bytes that are written at once.


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
    starts
        Compiled mechanisms; none by default.

    Raises
    ------
    NotByAdjointError
        If elements of the mechanism do not allow it.
    RunError
        If the run stops early.
    """

    doubts: tuple[str, ...] = ()

    def __init__(self, spec: RunSpec, seeds: Seeds, needs: Needs, starts: Starts | None = None):
        self.spec, self.seeds, self._needs = spec, seeds, needs
        method = make_method(spec)
        assert isinstance(method, ExplicitRungeKutta | ImplicitRungeKutta)
        setup = RunSetup.of(spec, starts, method=method)
        self.method, self.workspace = method, setup.workspace
        self._check()
        self._table = replace(setup.timetable(), every=1)
        self._rows = np.zeros((0, 0))
        self._corners: list[AdjointCorner] = []
        self._sided: SidedStepper | None = None
        sided = with_sides(self.workspace.mechanism)
        self.is_split = sided is not None
        if sided is None:
            stepper = setup.stepper(self._table)
            self._keep_stages(stepper)
        else:
            stepper = differentiated_stepper(spec, NO_SEEDS, Needs(), None, setup, every=1)
            assert isinstance(stepper, SidedStepper)
            self._sided, self.workspace, self.seeds = stepper, stepper.workspace, sided.seeds(seeds)
        self.time, self.q, self.v = self._stepped(stepper)
        size, step = np.diff(self.time), self._table.step
        self.size = size if step is None else np.where(np.abs(size - step) < 1e-9 * step, step, size)
        of_steps = self.size.tolist() if self._sided is None else self._sided.given_sizes
        self.sizes = None if method.traits.tolerances is None else of_steps
        self._observer = StateObserver(self.workspace.with_own_pivots())
        self._adjoint = BackwardSweep(self.workspace, self.seeds)
        if self._sided is not None:
            self._take_corners(self._sided)
        self._pieces: list[SweptSteps] = []
        self._events = [self._event(event) for event in (events_of(spec, None) if spec.events else [])]

    def _keep_stages(self, stepper: Any) -> None:
        """Let fixed steps keep their stages for the way back."""
        is_implicit = isinstance(self.method, ImplicitRungeKutta)
        is_plain = self.method.traits.tolerances is None and not self.workspace.mechanism.treatments
        if is_plain and (is_implicit or not self.method.tableau.is_first_same_as_last):
            count = (self._table.steps + len(self._table.stops)) * len(self.method.tableau.floats()[1])
            self._rows = empty((count, len(self.workspace.q0) if is_implicit else row_size(self.workspace)))
            self._pinned = keep_stages(stepper, self._rows)

    def _stepped(self, stepper: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Take all steps; return times, positions and velocities at the ends of all steps, and at the start."""
        work = self.workspace
        time, files = [work.t0], [new_file(), new_file()]

        def add(q: np.ndarray, v: np.ndarray) -> None:
            for file, x in zip(files, (q, v), strict=True):
                file.write(np.ascontiguousarray(x).tobytes())

        add(work.q0, work.v0)
        while not (stepper.finished or stepper.failure):
            rows = stepper.advance()
            if self._sided is None:
                time.extend(rows.time.tolist())
                add(rows.q, rows.v)
            elif stepper.time > time[-1]:  # parts of steps have no rows
                time.append(stepper.time)
                add(stepper.run_state.q, stepper.run_state.v)
        if stepper.failure:
            text = f"{stepper.failure.code}: {stepper.failure.sentence}"
            raise RunError(f"a run that stops early has no gradient: {text}")
        if len(self._rows) and stepper.run_state.progress.accepted[0] != len(time) - 1:
            self._rows = self._rows[:0]
        q, v = (_array(file, (len(time), len(work.q0))) for file in files)
        return np.array(time), q, v

    def _take_corners(self, stepper: SidedStepper) -> None:
        """Note the discontinuities of force laws, at which steps end; one at the end of the run has no effect."""
        sides = pairwise(one.sides for one in stepper.history)
        for corner, (before, after) in zip(stepper.corners, sides, strict=True):
            node = int(np.argmin(np.abs(self.time - corner.before.time[0])))
            if node == len(self.time) - 1:
                break
            condition = stepper.conditions[corner.number]
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
        piece = SweptSteps(self.method, self.time[ends].copy(), self.size[n : n + 1] * share, self.q[ends].copy(),
                       self.v[ends].copy(), self._rows[:0], part, n)  # fmt: skip
        piece.time[1] = event.time
        if share < 1.0:
            piece.q[1], piece.v[1] = self._adjoint.end(piece)
        self._pieces.append(piece)
        if event.stops:
            self.time, self.q, self.v = (x[: n + 2] for x in (self.time, self.q, self.v))
            self.time[-1], self.q[-1], self.v[-1] = event.time, piece.q[1], piece.v[1]
            self.size = np.append(self.size[:n], piece.size)
            self._corners = [one for one in self._corners if one.node <= n]
            del self.parts
        unit = self.spec.time.step or 1e-3
        return AdjointEvent.at(event, piece.q[1], piece.v[1], unit, partial(self._states, sides=self._sides_at(n)))

    def _check(self) -> None:
        """Raise NotByAdjointError for a mechanism that the kernels do not differentiate."""
        mechanism, top, seeds = self.workspace.mechanism, self.workspace.mechanism.topology, self.seeds
        mechanism.refuse_kinds("gradients")
        kinds = {
            "first-order states, controllers or loads that depend on the motion": (
                len(top.states) + len(top.inputs) + len(top.load_values)
            ),
            "rigid contacts": mechanism.reacting is not None, "redundant joints": len(top.spare),
            "beams": len(top.sections),
        }  # fmt: skip
        if reasons := [name for name, count in kinds.items() if count]:
            raise NotByAdjointError(f"the mechanism has {reasons[0]}")
        points = seeds.get("spring_points")
        if points is not None and np.any(points[top.springs[:, SPRING.segments] != 1]):
            raise NotByAdjointError("parameters change points of a pathway with several segments")
        if self._table_arguments(top):
            raise NotByAdjointError(
                "parameters change the arguments of a table, or numbers of laws that belong to no spring or contact"
            )

    def _table_arguments(self, top: Any) -> bool:
        """Return whether parameters change numbers of laws that the kernels do not differentiate."""
        changed = touched_laws(self.seeds)
        if changed is None:
            return False
        of_springs = np.zeros(len(changed), dtype=bool)
        springs = top.springs[top.springs[:, SPRING.law] >= 0, SPRING.law]
        for law in (*springs, *top.interactions[:, INTERACTION.law]):
            begin = int(top.laws[law, LAW_ROW.parameters])
            of_springs[begin + 1 : begin + 1 + int(top.law_parameters[begin])] = True
            if self.workspace.mechanism.laws[law][1].law is TABLE:
                of_springs[begin + 2 : begin + 4 + int(top.law_parameters[begin + 2])] = False
        return bool(np.any(changed & ~of_springs))

    @cached_property
    def parts(self) -> list[SweptPart]:
        """The motion between stops."""
        table, time = self._table, self.time
        cuts = {0: np.inf, len(time) - 1: np.inf}  # no discontinuities, which have finite margins
        for stop, margin in zip(table.stops, table.stop_margins, strict=True):
            near = np.flatnonzero(np.abs(time - stop) <= SAME_TIME * margin) if margin else ()
            cuts |= {int(k): margin for k in near}
        corners = {one.node for one in self._corners}
        cuts = dict.fromkeys(corners, np.inf) | cuts
        borders, parts, names = sorted(cuts), [], archive_names(self.workspace.mechanism)
        for begin, end in pairwise(borders):
            first, last = cuts[begin], cuts[end]
            sides = (time[begin] + first if first < np.inf else -np.inf, time[end] - last if last < np.inf else np.inf)
            some = slice(begin, end + 1)
            q, v = self.q[some], self.v[some]
            of_laws, no_acc = self._sides_at(begin), self.method.traits.suits_stiff or not self._needs.ends
            acc = None if no_acc else self._observed(np.clip(time[some], *sides), q, v, of_laws).acc
            motion = MotionPart(self._observer, names, StepEnds(time[some], q, v, acc), range(end - begin), sides)
            parts.append(SweptPart(begin, end, motion, begin in corners, partial(self._use, of_laws)))
        return parts

    def at(self, number: int, time: np.ndarray) -> States:
        """Return the states at times [s] in a part of the motion, or at the ends of all steps if `number` is -1."""
        part = self.parts[number].plain
        q, v = part.ends.at(time)
        return self._states(np.clip(time, *part.sides), q, v, self._sides_at(self.parts[number].begin))

    def _states(self, time: np.ndarray, q: np.ndarray, v: np.ndarray, sides: np.ndarray | None = None) -> States:
        return States(self.workspace.mechanism, time, q, v, lambda: self._observed(time, q, v, sides))

    @property
    def ends_at_event(self) -> bool:
        """Whether an event ends the last step."""
        return bool(self._events) and self._events[-1].event.stops

    @cached_property
    def _windows(self) -> list[SweptSteps]:
        """All steps in order, some at once; see `WINDOW`."""
        found, stages = [], len(self.method.tableau.floats()[1])
        most = max(1, WINDOW // (stages * self.q.shape[1]))
        for part in self.parts:
            for begin in range(part.begin, part.end, most):
                end = min(begin + most, part.end)
                ends, own = slice(begin, end + 1), replace(part, begin=0, end=end - begin)
                is_kept = end < len(self.time) - 1 or not self.ends_at_event
                rows = self._rows[begin * stages : end * stages * is_kept]
                arrays = self.time[ends], self.size[begin:end], self.q[ends], self.v[ends], rows
                found.append(SweptSteps(self.method, *arrays, own, begin))
        return found

    def _kept(self, make: Callable[[int], States]) -> Callable[[int], States]:
        """Return a function that keeps the states of windows for all measures if there are few."""
        numbers = sum(x.size for x in Observed.zeros(1, self.workspace.mechanism.topology))
        states = len(self.time) * len(self.method.tableau.floats()[1])
        return cache(make) if 8 * numbers * states <= MOST_BYTES else make

    def _nodes_of(self, number: int) -> States:
        """Return the states of the stages of the steps in a window."""
        window = self._windows[number]
        return self._states(*self._adjoint.stages(window), self._sides_at(window.number))

    def _rows_of(self, number: int) -> States:
        """Return the states at the beginnings of the steps in a window, and at the end of the run."""
        window = self._windows[number]
        end = window.number + len(window.size) + (number == len(self._windows) - 1)
        some = slice(window.number, end)
        time = self._table.before(self.time)[some]
        return self._states(time, self.q[some], self.v[some], self._sides_at(window.number))

    @cached_property
    def rows(self) -> LongStates:
        """The states at the ends of all steps."""
        self.workspace.clamp_motions(-np.inf, np.inf)
        make = self._kept(self._rows_of)

        def pieces() -> Iterator[States]:
            return map(make, range(len(self._windows)))

        def observed() -> Observed:
            return _joined([piece.observed for piece in pieces()])

        time = self._table.before(self.time)
        return LongStates(self.workspace.mechanism, time, self.q, self.v, observed, pieces=pieces)

    @cached_property
    def held(self) -> tuple[States, float]:
        """Position and velocity of the last state at eight times around the end, and the time [s] between these."""
        offsets, distance = nearby(self.spec.time.step or 1e-3)
        q, v = (np.repeat(x[-1:], len(offsets), axis=0) for x in (self.q, self.v))
        return self._states(self.time[-1] + offsets, q, v, self._sides_at(len(self.time) - 2)), distance

    def measures(self, expressions: Mapping[str, MeasureExpression]) -> dict[str, DerivedMeasure]:
        """Return measures with their derivatives; raise NotByAdjointError if the adjoint does not give them."""
        self.doubts = doubts_of_laws(self.workspace.mechanism)
        nodes = None
        if self._needs.nodes:
            weights = self.method.tableau.floats()[1]
            of_windows = [np.multiply.outer(one.size, weights).ravel() for one in self._windows]
            nodes = Nodes(of_windows, self._kept(self._nodes_of))
        motions = [SimpleNamespace(parts=self.parts)] if self._needs.ends else []
        run = {"rows": self.rows, "nodes": nodes, "motions": motions}
        events = [one.event for one in self._events]
        corners = [one.states for one in self._corners]
        found = {name: AdjointMeasure(run, self, one, events, corners).bars() for name, one in expressions.items()}
        slopes = {
            name: derived._replace(slope=self._slope(bars, times, nodes))
            for name, (derived, bars, times) in found.items()
        }
        memory = self._rows.base
        if memory is not None and memory.ndim == 1 and memory.nbytes <= MOST_SPARE:  # not in a file
            _spare.rows = memory
        self._rows = self._rows[:0]  # they are computed again if more measures are asked for
        self.__dict__.pop("_windows", None)
        return slopes

    def _slope(self, bars: list[tuple[int, MakeBars]], times: np.ndarray, nodes: Nodes | None) -> np.ndarray:
        """Return the derivatives (K,) of a measure given those by states and by times of events and corners."""
        own, of_windows = self._adjoint, dict[int, list[MakeBars]]()
        own.clear()
        q_bar, v_bar = (_array(new_file(), self.q.shape) for _ in range(2))
        before = {one.node: np.zeros((2, self.q.shape[1])) for one in self._corners}  # by states before corners
        marker_points = np.zeros(self.workspace.mechanism.topology.marker_points.shape)
        times, of_corners = np.split(times, [len(self._events)])

        def pulled(one: Bars) -> tuple[np.ndarray, np.ndarray]:
            marker_points[...] += one.markers.sum(axis=0)
            return own.pulled(one)

        for number, make in bars:
            if number < -1:
                of_windows.setdefault(-2 - number, []).append(make)
                continue
            one = make(None)
            self.parts[number].use()
            given = pulled(one)
            if number == -1:
                q_bar[-1] += given[0][0]
                v_bar[-1] += given[1][0]
                if self.ends_at_event:  # the end moves along the motion
                    end = self._events[-1].states
                    times = times.copy()
                    times[-1] += given[0][0] @ end.v[0] + given[1][0] @ end.observed.acc[0]
                continue
            part, (first, *ends) = self.parts[number], self._to_ends(one, *given)
            for k, (target, x) in enumerate(zip((q_bar, v_bar), ends, strict=True)):
                place = part.begin + first
                target[place : place + len(x) - 1] += x[:-1]
                last = place + len(x) - 1
                (before[last][k] if last == part.end and last in before else target[last])[...] += x[-1]
        for event, piece, by_time in zip(self._events, self._pieces, times, strict=True):
            if by_time == 0.0:
                continue
            piece.part.use()
            found = pulled(event.bars(by_time, self.workspace.mechanism))
            q, v = (np.concatenate([np.zeros(x.shape), x]) for x in found)
            own.sweep(piece, q, v, [])
            q_bar[piece.number] += q[0]
            v_bar[piece.number] += v[0]
        for number, window in reversed([*enumerate(self._windows)]):
            stage_bars: list[np.ndarray] = []
            window.part.use()
            for make in of_windows.get(number, ()):
                assert nodes is not None
                given = pulled(make(nodes.states(number)))
                stage_bars = [x + y for x, y in zip(stage_bars or (0.0, 0.0), given, strict=True)]
            some = slice(window.number, window.number + len(window.time))
            own.sweep(window, q_bar[some], v_bar[some], stage_bars)
            node = window.number
            for corner, of_corner in [*zip(self._corners, of_corners, strict=True)][::-1] if node in before else ():
                if corner.node == node:
                    self._use(corner.sides)
                    by_time = of_corner + v_bar[node] @ corner.jump
                    found = pulled(corner.bars(by_time, self.workspace.mechanism, own.bundle.law_parameters))
                    q_bar[node] += found[0][0]
                    v_bar[node] += found[1][0]
            if node in before:
                q_bar[node] += before[node][0]
                v_bar[node] += before[node][1]
        slope = np.zeros(self.seeds.count)
        arrays = {**{name: getattr(own.bundle, name) for name in ARRAYS}, "marker_points": marker_points}
        for name, x in (*arrays.items(), ("q", q_bar[0]), ("v", v_bar[0])):
            slope += contract(self.seeds, name, x)
        return slope

    def _to_ends(self, one: Bars, q: np.ndarray, v: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        """Return derivatives with respect to some ends of the steps of a part, given those with respect to states
        between these, and the number of the first of these ends.
        """
        part = self.parts[one.part]
        ends, plain = part.plain.ends, part.plain
        step = np.clip(np.searchsorted(ends.time, one.states.time, side="right") - 1, 0, len(ends.time) - 2)
        first, end = max(0, int(np.min(step)) - AROUND), min(len(ends.time), int(np.max(step)) + AROUND + 2)
        q_bar, v_bar, acc_bar = np.zeros((3, end - first, q.shape[1]))
        for number in np.unique(step):
            some = np.flatnonzero(step == number)
            window = slice(max(0, number - AROUND), min(len(ends.time), number + AROUND + 2))
            weights = _weights(ends.time[window], np.clip(one.states.time[some], *part.span), ends.a is not None)
            for rows, x in zip(weights, (q[some], v[some]), strict=True):
                for target, by in zip((q_bar, v_bar, acc_bar), rows, strict=False):
                    target[window.start - first : window.stop - first] += by.T @ x
        if ends.a is not None and np.any(acc_bar):
            used = np.flatnonzero(np.any(acc_bar, axis=1))
            at = used + first
            seen = np.clip(ends.time[at], *plain.sides)
            given = Bars(one.part, self._states(seen, ends.q[at], ends.v[at]), self.workspace.mechanism)
            given.acc += acc_bar[used]
            part.use()
            more_q, more_v = self._adjoint.pulled(given)
            q_bar[used] += more_q
            v_bar[used] += more_v
        return first, q_bar, v_bar


def new_file() -> SpooledTemporaryFile[bytes]:
    """Return an empty file, which is in memory as long as it is small."""
    return SpooledTemporaryFile(MOST_BYTES)


def empty(shape: tuple[int, int]) -> np.ndarray:
    """Return an array without values: in memory, or in a file if it is large."""
    size = shape[0] * shape[1]
    if 8 * size > MOST_BYTES:
        return _array(new_file(), shape)
    room = _spare.__dict__.pop("rows", None)
    return (np.empty(size) if room is None or room.size < size else room[:size]).reshape(shape)


def _array(file: SpooledTemporaryFile[bytes], shape: tuple[int, int]) -> np.ndarray:
    """Return the numbers in a file, and zeros behind these, as an array: in memory, or in the file if it is large."""
    size = 8 * shape[0] * shape[1]
    if size > MOST_BYTES:
        file.seek(0, os.SEEK_END)
        for begin in range(file.tell(), size, BLOCK):  # really written, so that a full disk is an error here
            file.write(bytes(min(BLOCK, size - begin)))
        file.flush()
        return np.asarray(np.memmap(file, float, "r+", shape=shape))
    file.seek(0)
    given = np.frombuffer(file.read())
    return np.append(given, np.zeros(size // 8 - len(given))).reshape(shape)


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
