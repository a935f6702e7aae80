"""The motion between the ends of the steps of a differentiated run.

The polynomials of `mbdkit.runs.step_interpolation` are linear in the positions, velocities and accelerations at the
ends of steps. Because the times of the ends are fixed, the derivatives of the polynomials are the polynomials through
the derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from mbdkit.engine.native.number_arrays import Duals, new_duals
from mbdkit.engine.observed_states import StateObserver
from mbdkit.integrators.duals.differentiated_stepper import DifferentiatedStepper
from mbdkit.integrators.interface import SAME_TIME
from mbdkit.quantities.names import archive_names
from mbdkit.runs.continuous_motion import MotionPart
from mbdkit.runs.step_interpolation import StepEnds
from mbdkit_gradients.differentiated_states import DifferentiatedStates, StateEvaluator, joined_states, merged_states
from mbdkit_gradients.sided_stepper import LawCorner, SidedStepper, sides_of, use_sides


@dataclass
class _Part:
    """Ends of consecutive steps between two discontinuities of motions, loads or force laws."""

    #: The discontinuity of a force law at which this part begins; None if there is none.
    before: LawCorner | None = None
    law_sides: np.ndarray | None = None
    #: First and last time at which motions and loads are evaluated [s].
    sides: tuple[float, float] = (-np.inf, np.inf)
    time: list[float] = field(default_factory=list)
    q: list[np.ndarray] = field(default_factory=list)
    v: list[np.ndarray] = field(default_factory=list)

    def add(self, time: float, q: np.ndarray, v: np.ndarray) -> None:
        self.time.append(time)
        self.q.append(q)
        self.v.append(v)


class DifferentiatedMotion:
    """The motion of a run between the ends of its steps, with derivatives with respect to up to `DIRECTIONS`
    parameters.

    Parameters
    ----------
    stepper
        The run at its start.
    evaluator
        Evaluates states of the run.
    uses_accelerations
        See `StepEnds`.
    """

    def __init__(self, stepper: DifferentiatedStepper, evaluator: StateEvaluator, *, uses_accelerations: bool):
        self._stepper, self._evaluator, self._uses_accelerations = stepper, evaluator, uses_accelerations
        self._corners = 0
        self._parts = [_Part()]
        self._begin_at(stepper.time, *self._state())

    def _state(self) -> tuple[np.ndarray, np.ndarray]:
        run = self._stepper.steps.run
        return self._used(run.q), self._used(run.v)

    def _used(self, x: np.ndarray) -> np.ndarray:
        """Return an array without the derivatives that no measure needs."""
        return np.array(np.asarray(x)[..., : self._evaluator.width])

    def _begin_at(self, time: float, q: np.ndarray, v: np.ndarray, corner: LawCorner | None = None) -> None:
        """Begin a new part of the motion. If the last part has no step, the new part replaces it."""
        if len(self._parts[-1].time) < 2:
            self._parts.pop()
        law_sides = sides_of(self._stepper) if corner is None else corner.sides
        part = _Part(corner, law_sides, (self._beside_stop(time, 1.0), np.inf))
        part.add(time, q, v)
        self._parts.append(part)

    def _beside_stop(self, time: float, side: float) -> float:
        """Return the time just before (`side` -1) or after (1) the discontinuity of a motion at `time`.

        Without a discontinuity, the result is -side * inf.
        """
        table = self._stepper.timetable
        for stop, margin in zip(table.stops, table.stop_margins, strict=True):
            if abs(time - stop) <= SAME_TIME * margin:
                return stop + side * margin
        return -side * np.inf

    def add(self) -> None:
        """Add the corners (discontinuities of force laws) that the last step has passed, and the end of this step."""
        reached = self._stepper.time
        for corner in self._stepper.corners[self._corners :] if isinstance(self._stepper, SidedStepper) else ():
            self._corners += 1
            time, before, after = float(corner.before.time[0]), corner.before, corner.after
            if time > self._parts[-1].time[-1]:
                self._parts[-1].add(time, before.q[0], before.v[0])
            v = after.v[0].copy()  # a jump of the accelerations changes the derivatives at a fixed time
            v[:, 1:] += np.outer(before.observed.acc[0, :, 0] - after.observed.acc[0, :, 0], corner.slope)
            self._begin_at(time, after.q[0], v, corner)
        if reached > self._parts[-1].time[-1]:
            state = self._state()
            self._parts[-1].add(reached, *state)
            if np.isfinite(end := self._beside_stop(reached, -1.0)):
                self._parts[-1].sides = self._parts[-1].sides[0], end
                self._begin_at(reached, *state)

    def end_at(self, time: float, q: np.ndarray, v: np.ndarray) -> None:
        """End the motion at the event that ends the run."""
        if time > self._parts[-1].time[-1]:
            self._parts[-1].add(time, self._used(q), self._used(v))

    @cached_property
    def parts(self) -> Sequence[DifferentiatedPart]:
        """The parts of the motion."""
        whole = [part for part in self._parts if len(part.time) > 1]
        return [DifferentiatedPart(part, self._stepper, self._evaluator, self._uses_accelerations) for part in whole]


class DifferentiatedPart:
    """A part of the motion between two discontinuities of motions, loads or force laws.

    Attributes
    ----------
    plain
        This part without derivatives.
    corner
        The discontinuity of a force law at which this part begins; None if there is none.
    """

    def __init__(
        self, part: _Part, stepper: DifferentiatedStepper, evaluator: StateEvaluator, uses_accelerations: bool
    ):
        self._evaluator, self._stepper, self._law_sides = evaluator, stepper, part.law_sides
        self.corner, self._sides = part.before, part.sides
        time, q, v = np.array(part.time), np.array(part.q), np.array(part.v)
        accelerations = self._evaluated(time, q, v).observed.acc if uses_accelerations else None
        self._ends = StepEnds(time, q, v, accelerations)
        plain = StepEnds(time, q[..., 0], v[..., 0], None if accelerations is None else accelerations[..., 0])
        observer = StateObserver(evaluator.workspace.with_own_pivots())
        names = archive_names(evaluator.workspace.mechanism)
        self._plain = MotionPart(observer, names, plain, range(len(time) - 1), part.sides)

    @property
    def plain(self) -> MotionPart:
        """The motion without derivatives, with the sides of force laws that apply in this part."""
        use_sides(self._stepper, self._law_sides)
        return self._plain

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the part [s]."""
        return float(self._ends.time[0]), float(self._ends.time[-1])

    def states(self, time: np.ndarray) -> DifferentiatedStates:
        """Return the states at times (T,) [s], with the quantities computed from them."""
        return self._evaluated(time, *self._ends.at(time))

    def _evaluated(self, time: np.ndarray, q: np.ndarray, v: np.ndarray) -> DifferentiatedStates:
        use_sides(self._stepper, self._law_sides)
        return self._evaluator.states(np.clip(time, *self._sides), _whole(q), _whole(v), new_duals(len(time), 0))


class MotionStates:
    """The states of a motion with the derivatives with respect to all parameters.

    States that several measures use are evaluated together, and kept.

    Parameters
    ----------
    motions
        The motion, for up to `DIRECTIONS` parameters each.
    """

    def __init__(self, motions: Sequence[DifferentiatedMotion]):
        self._motions = motions
        self._kept: dict[int, DifferentiatedStates] = {}

    def keep(self, number: int, time: np.ndarray) -> None:
        """Evaluate the states at times [s] in part `number`, counted from 0, and keep them."""
        if len(time):
            self._kept[number] = self._evaluated(number, np.unique(time))

    def at(self, number: int, time: np.ndarray) -> DifferentiatedStates:
        """Return the states at times (T,) [s] in part `number`."""
        if number not in self._kept:
            return self._evaluated(number, time)
        known = self._kept[number]
        rows = np.minimum(np.searchsorted(known.time, time), len(known.time) - 1)
        is_known = known.time[rows] == time
        if not is_known.any():
            return self._evaluated(number, time)
        others = None if is_known.all() else self._evaluated(number, time[~is_known])
        return merged_states(known, rows[is_known], others, is_known)

    def _evaluated(self, number: int, time: np.ndarray) -> DifferentiatedStates:
        return joined_states([motion.parts[number].states(time) for motion in self._motions])


def _whole(x: np.ndarray) -> Duals:
    """Return an array of dual numbers with `DIRECTIONS` derivatives; those that `x` does not have are zero."""
    whole = new_duals(*x.shape[:-1])
    whole[..., : x.shape[-1]] = x
    return whole
