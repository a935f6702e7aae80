"""The last step of a method in Python: states within it, and its division at an event."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.kernels.interpolation import fade
from mbdkit.integrators.host.host_rows import HostRows
from mbdkit.integrators.interface import SAME_TIME, Failure, Moment, StepTaken, Stretch
from mbdkit.integrators.run.reached import Interval, Planned, Reached, RejectedError, Row
from mbdkit.integrators.run.splitting import Change, margin_of_stops
from mbdkit.integrators.run.step_results import called
from mbdkit.methods.step_methods import ExternalMethod, StepState

if TYPE_CHECKING:
    from mbdkit.engine.counters import HostCounters
    from mbdkit.integrators.host.python_projection import StabilizedSteps, Taken
    from mbdkit.integrators.loop.step_watch import StepWatch


class LastStep(HostRows):
    """Base class of `mbdkit.integrators.host.step_host.StepHost`: its last step."""

    counters: HostCounters
    failure: Failure | None
    stabilized: StabilizedSteps
    time: float
    worst_pairs: np.ndarray
    _from: Reached
    _judged: tuple[float, float]
    _retrying: bool
    _rows_before: tuple[int, Interval]
    _taken: Taken | None
    _watch: StepWatch

    @abstractmethod
    def _next(self, begin: Reached) -> Planned: ...

    @abstractmethod
    def _after(self, begin: Reached, plan: Planned, worst: np.ndarray, theta: float = 1.0) -> tuple[Reached, Taken]: ...

    def _go_to(self, there: Reached) -> None:
        self.now, self.time = there, there.time
        self.counters.steps = self.counters.accepted = there.done
        table = self.timetable
        self.finished = there.whole == table.steps if self._is_fixed else there.time >= table.end

    def _keep_nodes(self, before: Reached, there: Reached, theta: float = 1.0) -> None:
        """Store quadrature nodes in a step, or in its share `theta`."""
        if self.timetable.nodes:
            dense = (lambda share: self.inside(theta * share)[:2]) if isinstance(self.method, ExternalMethod) else None
            self._nodes.keep_step(self.equations, before, there, self._made, dense, whole=theta == 1.0)

    def inside(self, theta: float) -> Moment:
        """See `Stepper.inside`."""
        step, taken = self.last_step, self._taken
        assert step is not None
        found = None
        if theta not in (0.0, 1.0) and not self.stabilized.wanted.symmetric:
            found = self._results.within(self._made, theta)
        if found is None or taken is None:
            return step.between(theta)
        q, v, z = found[:3]
        if taken.made is not taken.reached:
            share = fade(theta)
            q, v = q + share * (taken.reached.q - taken.made.q), v + share * (taken.reached.v - taken.made.v)
        return with_ground(q), with_ground(v), z

    def within(self, theta: float) -> Moment:
        """See `Stepper.within`."""
        step = self.last_step
        assert step is not None
        if theta in (0.0, 1.0):
            return step.between(theta)
        there = self._again(theta)
        if there is None:
            return self.inside(theta)
        return (*self._with_ground(there.state), there.state.z)

    def _again(self, theta: float) -> Reached | None:
        """Repeat the last step with the fraction `theta` of its size; return None if that is impossible.

        It is impossible if the method raises StepError, if it is a library, or if it ends this step early too. Any
        other exception is passed on.
        """
        before, now = self._before, self.now
        if isinstance(self.method, ExternalMethod):
            return self._cut_by_library(theta)
        plan, share = self._next(before), 1.0
        if now.is_event:  # the step ended earlier than planned
            share = (now.begin - plan.begin) / plan.size
        kept_step = self._made, self._judged, self._retrying
        self._from, self._retrying = before, False
        try:
            there, wanted = self._after(before, plan, self.worst_pairs.copy(), theta * share)[0], share * theta
            gap = plan.begin + wanted * plan.size - there.begin
            return there if gap <= SAME_TIME * margin_of_stops(self.timetable) else None
        except (StepError, RejectedError):
            return None
        finally:
            self._made, self._judged, self._retrying = kept_step

    def _cut_by_library(self, theta: float) -> Reached | None:
        """Return the point at the share `theta` of the last step, as the library gives it; None if it does not."""
        step, method = self.last_step, self.method
        assert step is not None
        assert isinstance(method, ExternalMethod)
        found = called(f"{type(method).__name__}.cut", method.cut, step.time(theta))
        return None if found is None else self._at(theta, self._results.state(found, "cut"))

    def _at(self, theta: float, state: StepState) -> Reached:
        """Return the point at the share `theta` of the last step with a given state, projected if steps are."""
        before, now, step = self._before, self.now, self.last_step
        assert step is not None
        t, size = step.time(theta), theta * (step.t1 - step.t0)
        energy = self._energies.at(theta, before, now, self._made, self._results)
        taken = self.stabilized.project(t, before.state, state, now.done)
        interval = before.interval.after(size, 0, 0, taken.correction)
        return now._replace(
            state=taken.reached, energy=energy, interval=interval, event=None, time=t, restart=None, why=""
        )

    def _shortened(self, theta: float) -> Reached:
        """Return the point at the share `theta` of the last step, by a repeated step or else by dense output."""
        there = self._again(theta) if theta > 0.0 else self._before
        if there is None:
            q, v, z = self.inside(theta)
            n = self.equations.n
            there = self._at(theta, replace(self._before.state, q=q[:n], v=v[:n], z=z, low=(0.0, 0.0)))
        assert self.last_step is not None
        return there._replace(time=self.last_step.time(theta))

    def cut(self, theta: float) -> Stretch:
        """See `Stepper.cut`."""
        assert self.last_step is not None
        there = self._shortened(theta)
        if self.timetable.nodes:
            self._nodes.drop_last()
            if theta > 0.0:
                self._keep_nodes(self._before, there, theta)
        if self._inner_rows and self._inner_rows[0] < there.time:  # that row has the counts of the step
            there = there._replace(interval=Interval())
        self._go_to(there)
        self.finished, self.failure = True, None
        return self.last_state()

    def split(self, theta: float, change: Change) -> tuple[Stretch, list[StepTaken]]:
        """See `mbdkit.integrators.run.splitting.Splitting.split`."""
        step = self.last_step
        assert step is not None
        t, close = step.time(theta), SAME_TIME * margin_of_stops(self.timetable)
        taken: list[StepTaken] = [step]
        rows: list[Row] = []
        if step.t1 - t <= close:
            there = self.now
        else:
            is_start = t - step.t0 <= close
            there = self._before if is_start else self._shortened(theta)
            self.finished, self.failure = False, None
            if self.timetable.nodes:
                self._nodes.drop_last()
            taken = []
            if not is_start:
                there = there._replace(
                    whole=self._before.whole, passed=self._before.passed, restart=t, is_event=True, event=None
                )  # fmt: skip
                if self.timetable.nodes:
                    self._keep_nodes(self._before, there, theta)
                taken = [replace(step, t1=t, q1=with_ground(there.state.q), v1=with_ground(there.state.v),
                                 z1=there.state.z)]  # fmt: skip
        end = (*self._with_ground(there.state), there.state.z)
        self.next_row = self._rows_before[0]
        self._go_to(there)
        if taken:
            rows = self._due(end=t)
        self.last_step = taken[0] if taken else None
        if not self.finished:
            state = replace(self.now.state, z=change(t, end), low=self.now.state.low[:2], multipliers=None)
            self._watch.forget_energy()
            self.now = self.now._replace(state=state, why="stop" if self.now.why == "stop" else "event")
        return self._stretch(rows), taken
