"""Control of the steps of methods in Python, by the error estimates of the method or by the method itself."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.integrators.run.reached import Reached, RejectedError
from mbdkit.integrators.run.step_control import (
    MIN_LAST_ERROR,
    Control,
    ControlData,
    control_data,
    factor_after_acceptance,
    factor_after_rejection,
    first_step,
    unit_of_length,
)

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace
    from mbdkit.integrators.interface import Timetable
    from mbdkit.methods.kinds import Tolerances
    from mbdkit.methods.step_methods import Step, StepState

MEMORY = 0.2  #: Influence of the previous error on the size of the next step; see `Control.memory`.


class _Past(NamedTuple):
    """The steps before, as `factor_after_acceptance` reads them; each tuple has one number."""

    last_error: tuple[float]
    earlier_error: tuple[float]
    last_size: tuple[float]
    earlier_size: tuple[float]
    retrying: tuple[bool]


class HostControl:
    """Accepts and rejects controlled steps, and chooses their sizes.

    `tolerances`: tolerances of the method. `error_order`: order p of its error estimate, whose size is O(h^(p + 1)).
    `workspace`, `timetable`: the run. `z0`: (Z,) first-order states at its start.
    """

    def __init__(
        self, tolerances: Tolerances, error_order: float, workspace: Workspace, timetable: Timetable, z0: np.ndarray
    ):
        self._rtol, mechanism = tolerances.rtol, workspace.mechanism
        length = unit_of_length(tolerances.by_size, mechanism)
        bodies = np.tile([length, length, 1.0], 2 * len(mechanism.bodies))
        self._atol = tolerances.atol * np.concatenate([bodies, np.ones(len(mechanism.states))])
        self._begin, self._end = self._ends = np.zeros((2, len(self._atol)))
        self._given = tolerances
        self._data: dict[float, ControlData] = {}
        self._longest = math.inf if tolerances.max_step is None else tolerances.max_step
        span = timetable.end - timetable.start
        self._order = error_order
        if timetable.step is not None:
            self.first = min(span, timetable.step)
        else:
            self.first = min(span, first_step(workspace, span, self._of_order(error_order), z0), self._longest)

    def _of_order(self, order: float) -> Control:
        k = order + 1.0
        given = self._given
        return Control(given.rtol, given.atol, order=k, estimate_order=k, memory=MEMORY, filter=given.control)

    def norm(self, error: np.ndarray, begin: StepState, end: StepState) -> float:
        """Return the root mean square of an error (2 n + Z,) over ``atol + rtol |y|``, y the larger of both ends."""
        scale = np.concatenate((begin.q, begin.v, begin.z), out=self._begin)
        np.concatenate((end.q, end.v, end.z), out=self._end)
        with np.errstate(all="ignore"):
            np.abs(self._ends, out=self._ends)
            np.maximum(scale, self._end, out=scale)
            scale *= self._rtol
            scale += self._atol
            ratio = np.divide(error, scale, out=scale)
            square = float(np.sum(np.square(ratio, out=ratio))) / len(ratio)
        return math.sqrt(square) if square >= 0.0 else math.inf

    def judge(self, made: Step, end: StepState, h: float, begin: Reached, *, retrying: bool) -> tuple[float, float]:
        """Return the size of the next step [s], and the error of this one, which ends in `end`, over its tolerance.

        Raises RejectedError if the step is not accepted, and SpecError if a method with a controller chooses its steps.
        """
        if made.next_step is not None and made.accepted and self._given.control is not None:
            raise SpecError(
                "the method chooses its steps itself, so that no other controller can be used",
                key="integrator.step_control",
            )
        if made.next_step is not None or not made.accepted or made.error is None:
            if not made.accepted:
                raise RejectedError(self._limited(0.5 * h if made.next_step is None else made.next_step))
            return self._limited(begin.size if made.next_step is None else made.next_step), 0.0
        order = self._order if begin.order is None else begin.order
        if order not in self._data:
            arrays = control_data(self._of_order(order), 0.0)
            self._data[order] = ControlData(*(x.tolist() for x in arrays))  # numbers of Python are faster
        data = self._data[order]
        error = self.norm(made.error, begin.state, end)
        if not error <= 1.0:
            raise RejectedError(h * float(factor_after_rejection(data, math.isfinite(error), error)))
        last_error, earlier_error, last_size, earlier_size = begin.history
        past = _Past((last_error,), (earlier_error,), (last_size,), (earlier_size,), (retrying,))
        factor = float(factor_after_acceptance(data, h, max(error, 1e-10), past))
        return self._limited(h * factor), max(error, MIN_LAST_ERROR)

    def _limited(self, size: float) -> float:
        return min(size, self._longest)
