"""Companions: comparison runs of the same mechanism from the same start with another method, step or tolerance."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import numpy as np
from pydantic import BaseModel

from mbdkit.base.errors import MbdkitError
from mbdkit.base.frozen import dataclass, replace
from mbdkit.base.text import one_line
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.stabilization import Stabilization
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import SAME_TIME, Stepper, Stretch, Timetable, on_grid
from mbdkit.integrators.run.impulse import ReactingMemory, reacting_memory
from mbdkit.integrators.run.sampled_control import states_at_start
from mbdkit.integrators.start import start_method
from mbdkit.mechanism.element_kinds import ChosenTreatment
from mbdkit.methods.kinds import Method
from mbdkit.methods.step_controls import controlled
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.items import IntegratorPlugin
from mbdkit.registry.manager import registry
from mbdkit.runs.recorded_states import ObservedRows
from mbdkit.runs.run_seams import Progress

if TYPE_CHECKING:
    from mbdkit.events.watch import Watch

#: Value of `Timetable.every` with which no end of a step is recorded, for companions with rows within their steps.
NEVER = 2**53


@dataclass(frozen=True)
class Comparison:
    """How a comparison run differs from the run.

    - `name`: description for the user, such as ``step 0.005 s``.
    - `item`, `options`: the integrator and its options.
    - `formulation`, `stabilization`: those of the equations; empty and None if they are those of the run.
    - `factor`: factor by which steps or tolerances are smaller.
    - `treatment`: treatment of elements whose reactions the steps determine; None for that of the run.
    """

    name: str
    item: Registered
    options: BaseModel
    formulation: str = ""
    stabilization: Stabilization | None = None
    factor: int = 1
    treatment: ChosenTreatment | None = None

    @property
    def plugin(self) -> IntegratorPlugin:
        """The integrator plugin."""
        return cast(IntegratorPlugin, self.item.plugin)

    @property
    def is_adaptive(self) -> bool:
        """Whether the step size is controlled."""
        return self.plugin.claims(self.options).adaptive

    def method(self) -> Method:
        """Create the method."""
        return controlled(cast(Method, self.plugin.create(self.options)), self.options, self.item.name)

    @classmethod
    def of_other(
        cls, integrator: str, name: str, formulation: str, stabilization: Stabilization, **options: object
    ) -> Comparison:
        """Return a run with a built-in method."""
        item = registry().get("integrator", integrator)
        return cls(name, item, cast(IntegratorPlugin, item.plugin).options(**options), formulation, stabilization)


@dataclass(frozen=True)
class Companion:
    """A comparison run that is evaluated at the times of the main run.

    `run`: method and settings. `timetable`: times of the companion. If `within_steps`, the companion is evaluated by a
    shortened step from the start of the step in which each time lies. Otherwise, the timetable records rows at these
    times.
    """

    run: Comparison
    timetable: Timetable
    within_steps: bool


@dataclass(frozen=True)
class CompanionRows:
    """Rows of a companion at the times of the main run; nan where the companion has none.

    `failure`: reason why the companion stopped early, as the end of a sentence; empty if it did not stop early.
    `memory`: memory of the reactions of elements at the end, with their impacts; None if there are none.
    """

    rows: ObservedRows
    failure: str
    memory: ReactingMemory | None = None


def run_companion(
    companion: Companion,
    workspace: Workspace,
    times: np.ndarray,
    stopped: Callable[[], str],
    progress: Progress | None = None,
    watch: Callable[[Workspace, Stepper], Watch] | None = None,
) -> CompanionRows:
    """Run a companion.

    - `workspace`: workspace of the main run. Its mechanism and start are shared; working arrays and pivots are not.
    - `times`: (T,) times of the main run [s], the first one its start.
    - `stopped`: function that returns the reason why the companion must stop now; an empty text if it need not stop.
    - `progress`: called with (time reached, end time) [s].
    - `watch`: function that wraps the stepper so that events set states; None if the run has no such events.

    Returns rows of the companion. An exception of a plugin is reported as a failure.
    """
    run = companion.run
    if run.treatment is not None:
        workspace = replace(workspace, mechanism=replace(workspace.mechanism, treatments=(run.treatment,)))
    own = workspace.for_another_run(
        run.formulation or workspace.formulation, run.stabilization or workspace.stabilization
    )
    states = _States(times, own, companion)
    stepper: Stepper | None = None
    try:
        table = companion.timetable
        stepper = start_method(run.method(), own, table if watch is None else replace(table, single=True))
        watched = None if watch is None else watch(own, stepper)
        failure = _advance(stepper, watched, companion, states, stopped, progress)
    except SingularSystemError:
        failure = "its equations are singular at the start"
    except MbdkitError as error:
        failure = str(error)
    except (Exception, SystemExit) as error:  # exception of a plugin
        failure = f"its method raised {one_line(error)}"
    rows = ObservedRows.at(own, times, states.q, states.v, states.z, seen=states.seen)
    return CompanionRows(rows, failure.rstrip("."), reacting_memory(stepper))


class _States:
    def __init__(self, times: np.ndarray, workspace: Workspace, companion: Companion):
        self.times = times
        self.seen = companion.timetable.before(times)
        self.q, self.v = (np.full((len(times), len(x)), np.nan) for x in (workspace.q0, workspace.v0))
        z0 = states_at_start(workspace)
        self.z = np.full((len(times), len(z0)), np.nan)
        self.q[0], self.v[0], self.z[0] = workspace.q0, workspace.v0, z0
        self.done = 1

    def take(self, stretch: Stretch) -> None:
        """Store the recorded states at the next times of the main run; states at other times are ignored."""
        for row, at in enumerate(stretch.time):
            if self.done < len(self.times) and _equal(at, self.times[self.done], self.times):
                self.q[self.done], self.v[self.done] = stretch.q[row], stretch.v[row]
                if stretch.z is not None:
                    self.z[self.done] = stretch.z[row]
                self.done += 1

    def take_within(self, stepper: Stepper) -> None:
        """Store the states at times of the main run within the last step and at its end."""
        step = stepper.last_step
        while step is not None and self.done < len(self.times):
            at = self.seen[self.done]
            is_end = _equal(at, step.t1, self.times)
            if at > step.t1 and not is_end:
                return
            state = step.between(1.0) if is_end else stepper.within((at - step.t0) / (step.t1 - step.t0))
            self.q[self.done], self.v[self.done], self.z[self.done] = state
            self.done += 1


def _equal(a: float, b: float, times: np.ndarray) -> bool:
    return bool(abs(a - b) <= 1e-13 * max(abs(times[0]), abs(times[-1]), times[-1] - times[0]))


def _advance(
    stepper: Stepper,
    watched: Watch | None,
    companion: Companion,
    states: _States,
    stopped: Callable[[], str],
    progress: Progress | None,
) -> str:
    """Advance to the last of the times; return the reason if this fails, otherwise an empty string."""
    while states.done < len(states.times):
        if stepper.finished:
            return ""
        if why := stopped():
            return why
        if failed := stepper.failure or (watched and watched.failure):
            # the limit is that of the comparison run, not `limits.max_steps` of the spec
            most = companion.timetable.max_steps
            return f"it needs more than {most} steps" if failed.code == "max-steps" else failed.sentence
        try:
            stretch = stepper.advance() if watched is None else watched.step()
        except Exception:
            if (rows := stepper.rows_before_error()) is not None:
                states.take(rows)
            raise
        if companion.within_steps:
            states.take_within(stepper)
        else:
            states.take(stretch)
        if progress is not None:
            progress(stepper.time, float(states.times[-1]))
    return ""


class Budget:
    """Determines when companions must stop: after a time limit, or on an interrupt by the user.

    `seconds`: limit of the wall time of all companions together [s]; None for no limit. `interrupted`: function that
    returns whether the user has asked to stop.
    """

    def __init__(self, seconds: float | None, interrupted: Callable[[], bool]):
        self._begin, self._seconds, self._interrupted = time.perf_counter(), seconds, interrupted

    @property
    def left(self) -> float | None:
        """Wall time that is left [s], at least a microsecond; None without a limit."""
        return None if self._seconds is None else max(1e-6, self._seconds - (time.perf_counter() - self._begin))

    def stopped(self) -> str:
        """Return the reason why companions must stop now; empty if they need not stop."""
        if self._interrupted():
            return "stopped by the user"
        if self._seconds is not None and time.perf_counter() - self._begin > self._seconds:
            return f"stopped after limits.wall_time = {self._seconds:g} s"
        return ""


def until(timetable: Timetable, end: float) -> Timetable:
    """Return a timetable that ends at `end` [s], without the stops at or after it."""
    stops = zip(timetable.stops, timetable.stop_margins, strict=True)
    margins = {stop: margin for stop, margin in stops if stop < end - SAME_TIME * margin}
    impacts = tuple(stop for stop in timetable.impacts if stop in margins)
    return replace(timetable, end=end, stops=tuple(margins), stop_margins=tuple(margins.values()), impacts=impacts)


def finer(timetable: Timetable, times: np.ndarray, factor: int) -> Timetable:
    """Return the timetable of a fixed-step companion whose steps are shorter by `factor`, with rows at `times`."""
    assert timetable.step is not None
    step = timetable.step / factor
    start, end = timetable.start, float(times[-1])
    table = until(timetable, end)
    stops = zip(table.stops, table.stop_margins, strict=True)
    return replace(
        table,
        stops=tuple(stop if margin else on_grid(stop, start, step, end) for stop, margin in stops),
        step=step,
        steps=max(1, int(np.ceil((end - start) / step - 1e-9))),
        every=factor * timetable.every,
        max_steps=factor * timetable.max_steps,
        single=False,
    )


def row_interval(timetable: Timetable) -> float:
    """Return the interval between the recorded rows of a fixed-step run [s]; the last interval may be shorter."""
    if timetable.interval is not None:
        return timetable.interval
    assert timetable.step is not None
    return timetable.every * timetable.step
