"""Steps of a method in Python: the plan of a step, attempts at it, and the check of what the method returns."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.integrators.host.python_projection import StabilizedSteps, Taken
from mbdkit.integrators.interface import SAME_INSTANT, SAME_TIME, Timetable
from mbdkit.integrators.run.reached import Planned, Reached, RejectedError
from mbdkit.integrators.run.splitting import margin_of_stops
from mbdkit.integrators.run.step_control import SOLVER_FAILURE_FACTOR, fitted_size
from mbdkit.integrators.run.step_results import Inside, StepResults, called, kept, protect
from mbdkit.methods.step_methods import ExternalMethod, Step, StepMethod, StepState, Why

if TYPE_CHECKING:
    from mbdkit.engine.equations_of_motion import EquationsOfMotion
    from mbdkit.integrators.host.host_control import HostControl
    from mbdkit.integrators.host.host_energies import HostEnergies

#: Codes of failures after which a controlled step is repeated with a smaller size.
_REPEATED = ("newton-failed", "not-finite", "singular")


class Attempt(NamedTuple):
    """A step that has been taken: its end, the step with its projection, the step of the method, and dense output."""

    end: Reached
    taken: Taken
    made: Step
    inside: Inside


class StepAttempts:
    """Takes the steps of a run, with as many attempts as they need.

    `equations`: the equations of motion, with the counters of the run. `timetable`: times of the run. `control`:
    control of the step size by error estimates; None if steps are fixed or the method chooses their sizes. `energies`:
    sums of the energies.
    """

    def __init__(
        self,
        method: StepMethod | ExternalMethod,
        equations: EquationsOfMotion,
        timetable: Timetable,
        control: HostControl | None,
        energies: HostEnergies,
    ):
        self.method, self.equations, self.timetable, self.control = method, equations, timetable, control
        self.name, self._is_external = type(method).__name__, isinstance(method, ExternalMethod)
        self.is_fixed = method.tolerances is None and not self._is_external  # otherwise steps are controlled
        self.results = StepResults(self.name, equations, len(equations.z0), method.carries_multipliers)
        self.stabilized = StabilizedSteps(self._own_step, self._after_projection, equations)
        self._energies = energies
        self._begin: Reached
        self._made: Step
        #: Time of a soft stop besides those of the timetable, at which an open run pauses [s].
        self.pause = math.inf
        self._judged = math.inf, 0.0  # size of the next step, and error of this one over its tolerance
        self._retrying, self._rejected, self._iterations = False, 0, 0  # the latter two before the first attempt

    def begun(self, t: float, state: StepState, why: Why) -> StepState:
        """Return a state with the memory for a step that begins anew."""
        if not isinstance(self.method, StepMethod):
            return state
        protect(state)
        memory = called(f"{self.name}.begin", self.method.begin, self.equations, t, state, why)
        return replace(state, memory=kept(memory))

    def _after_projection(self, t: float, state: StepState) -> StepState:
        is_default = getattr(type(self.method), "begin", None) is StepMethod.begin
        return state if is_default else self.begun(t, state, "projection")

    def accepted(self, begin: Reached, worst: np.ndarray) -> tuple[Reached, Attempt]:
        """Take a step, with as many attempts as it needs, each of at most nine tenths of the size of the one before.

        Returns its start, with the size of the step that was accepted, and the step. The largest squared misalignments
        `worst` (P,) are updated. Raises StepError and any exception of the method.
        """
        counters = self.equations.counters
        self._retrying, self._rejected, self._iterations = False, counters.rejected, counters.newton_iterations
        while True:
            self._begin, plan = begin, self._next(begin)
            try:
                return begin, self._attempt(begin, plan, worst)
            except RejectedError as rejected:
                if not rejected.size < plan.size:
                    raise ValueError(
                        f"{self.name} rejects a step of {plan.size!r} s and asks for one of {rejected.size!r} s, no "
                        "smaller one"
                    ) from None
                counters.rejected += 1
                begin, self._retrying = begin._replace(size=min(rejected.size, 0.9 * plan.size)), True
                if not rejected.size > 4.0 * margin_of_stops(self.timetable):
                    if rejected.reason is not None:
                        raise rejected.reason from None
                    raise StepError("step-too-small", "no step is small enough to be accepted") from None

    def shortened(self, begin: Reached, now: Reached, theta: float, worst: np.ndarray) -> Reached | None:
        """Repeat the step from `begin` to `now` with the share `theta` of its size; return None if that is impossible.

        It is impossible if the method raises StepError, or if it ends this step early too. Any other exception is
        passed on.
        """
        plan, share = self._next(begin), 1.0
        if now.is_event:  # the step ended earlier than planned
            share = (now.begin - plan.begin) / plan.size
        self._begin, self._retrying, self._iterations = begin, False, self.equations.counters.newton_iterations
        try:
            end, wanted = self._attempt(begin, plan, worst, theta * share).end, share * theta
        except (StepError, RejectedError):
            return None
        gap = plan.begin + wanted * plan.size - end.begin
        return end if gap <= SAME_TIME * margin_of_stops(self.timetable) else None

    def next_stop(self, begin: Reached) -> tuple[float | None, float, bool]:
        """Return the next stop after `begin` [s], its margin [s], and whether it is the pause of an open run."""
        table, n = self.timetable, begin.passed
        stop, margin = (table.stops[n], table.stop_margins[n]) if n < len(table.stops) else (None, 0.0)
        if begin.begin < self.pause < (math.inf if stop is None else stop):
            return self.pause, 0.0, True
        return stop, margin, False

    def _next(self, begin: Reached) -> Planned:
        """Return the plan of the step that starts at `begin`."""
        table, t = self.timetable, begin.begin
        stop, margin, _ = self.next_stop(begin)
        if not self.is_fixed:
            end = table.end if stop is None else stop
            wanted = min(begin.size, table.longest_step(t))
            size = end - t if self._is_external else float(fitted_size(t, wanted, end))
            is_last = t + size >= end or size == end - t
            if is_last and stop is not None:
                return Planned(t, end - t, stop - margin, True, False)
            return Planned(t, size, table.end if is_last else t + size, False, is_last)
        assert table.step is not None
        n = begin.whole + 1
        end = table.start + n * table.step if n < table.steps else table.end
        plan: Planned | None = None
        if stop is not None and (stop != end or margin):  # a soft stop on the grid leaves the step unchanged
            is_end = abs(stop - end) <= SAME_TIME * margin
            if stop < end or is_end:
                before = stop - margin  # so that a row there shows the left-hand limit
                is_on_grid = is_end and stop not in table.impacts
                plan = Planned(t, stop - t, end if is_on_grid else before, True, is_end)
        if plan is None:
            size = table.last_step if n == table.steps else table.step
            plan = Planned(t, size if begin.restart is None else end - t, end, False, True)
        if begin.size < plan.size and (size := float(fitted_size(t, begin.size, t + plan.size))) < plan.size:
            return Planned(t, size, t + size, False, False, is_part=True)
        return plan

    def _attempt(self, begin: Reached, plan: Planned, worst: np.ndarray, theta: float = 1.0) -> Attempt:
        """Take the fraction `theta` of a planned step from `begin`.

        The largest squared misalignments `worst` (P,) are updated. Raises StepError, RejectedError, and any exception
        of the method.
        """
        table, counters = self.timetable, self.equations.counters
        done, t, h = begin.done + 1, plan.begin, theta * plan.size
        # a sum of steps would accumulate rounding errors
        is_grid = self.is_fixed and h == table.step
        end = table.start + (begin.whole + 1) * h if is_grid else t + h
        taken = self.stabilized.take(t, end, begin.state, h, done)
        new, is_short = taken.reached, taken.end != end
        if is_short:
            end = taken.end
            h = end - t
        if not self.equations.arrive(end, new.q, new.v, worst):
            raise self._unsolved(h, StepError("not-finite", "positions or velocities overflowed"))
        inside = self.results.inside(self._made)
        energy, low = self._energies.booked(begin, t, h, taken, inside)
        iterations, rejected = counters.newton_iterations - self._iterations, counters.rejected - self._rejected
        size, error = self._judged
        if plan.is_at_stop and not self._retrying:
            size = max(size, begin.size)  # the stop has shortened the step, not its error
        whole, passed, restart = begin.whole, begin.passed, None
        why: Why | Literal[""] = ""
        if self._is_external and new is not taken.made:
            why = "projection"  # the library continues from the projected state, but only after this step has been used
        is_part = is_short or plan.is_part
        if is_part and self.is_fixed:
            restart = end
        elif not is_part and plan.is_at_stop and theta == 1.0:
            stop, _, is_pause = self.next_stop(begin)
            whole, passed = whole + plan.is_whole, passed + (not is_pause)
            restart, why, end = stop, "stop", plan.reached
        elif not is_part:
            whole += 1
            is_over = plan.is_whole if not self.is_fixed else whole == table.steps
            end = table.end if is_over and theta == 1.0 else end
            if self.is_fixed and theta == 1.0 and not is_over and self.next_stop(begin)[:2] == (end, 0.0):
                passed, why = passed + 1, "stop"
        there = Reached(
            done=done, whole=whole, passed=passed, restart=restart, time=end, state=new, energy=energy, energy_low=low,
            interval=begin.interval.after(h, iterations, rejected, taken.correction), is_event=is_part, why=why,
            size=size, history=(error, begin.history[0], h, begin.history[2]), order=self._made.next_order,
            event=self._made.event,
        )  # fmt: skip
        return Attempt(there, taken, self._made, inside)

    def _own_step(self, t: float, state: StepState, h: float, end: float) -> tuple[StepState, float]:
        """Take a step of the method; return the new state, and the time at which the step has ended.

        Raises StepError, RejectedError, any ordinary exception of the method, and TypeError or ValueError for an
        invalid result.
        """
        method, name, what = self.method, self.name, "advance" if self._is_external else "step"
        protect(state)
        try:
            given: Step | StepState
            if isinstance(method, ExternalMethod):
                given = called(f"{name}.advance", method.advance)
            else:
                given = called(f"{name}.step", method.step, self.equations, t, state, h)
            result, new = self.results.step(given, what)
        except StepError as error:
            raise self._unsolved(h, error) from None
        self._judged = math.inf, 0.0
        if self.control is not None:
            self._judged = self.control.judge(result, new, h, self._begin, retrying=self._retrying)
        elif not result.accepted and self._is_external:
            raise ValueError(f"{name}.advance returned a step that is not accepted")
        elif not result.accepted:
            raise RejectedError(0.5 * h if result.next_step is None else result.next_step)
        elif result.next_step is not None:
            self._judged = result.next_step, 0.0
        self._made = result
        if result.event is not None:
            ended = result.event.time
        elif result.time is not None:
            ended = float(result.time)
            if not t < ended <= end + 4.0 * margin_of_stops(self.timetable):
                raise ValueError(
                    f"{name}.{what} returned time = {ended!r}, which is not later than the start of the step, {t!r}, "
                    f"and at most its end, {end!r}"
                )
        elif self._is_external:
            raise ValueError(f"{name}.advance returned a Step without `time`")
        else:
            return new, end
        return new, ended if ended < t + h - SAME_INSTANT * max(abs(end), 1.0) else end

    def _unsolved(self, h: float, error: StepError) -> Exception:
        """Return the exception for a step that could not be taken; a controlled one is repeated with a smaller size."""
        if self.control is None or error.code not in _REPEATED:
            return error
        return RejectedError(SOLVER_FAILURE_FACTOR * h, error)
