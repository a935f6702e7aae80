"""The interface of steppers, which advance a run: its timetable, the states recorded in a part of it, and failures."""

from __future__ import annotations

import math
import time
from bisect import bisect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from mbdkit.engine.counters import Counters
from mbdkit.engine.input_schedule import same_time
from mbdkit.engine.linear_systems import product
from mbdkit.trust.criteria import BranchSuspicion

#: A stop and the end of a fixed step, or of the run, count as equal if they differ by less than this number times the
#: margin of the stop.
SAME_TIME = 16.0

SAME_INSTANT = 4e-16  #: Times that differ by less than this, in seconds or relative to their size, are equal.

#: Times that differ by less than this, in seconds or relative to times above 1 s, are the same instant.
SIMULTANEOUS = 1e-12

ROUNDING = 2e-15  #: Rows and ends of steps that differ by less than this, relative to the times of the run, are equal.

#: Seconds after which a compiled loop should return to Python, so that it stays well below the promised 0.2 s.
STRETCH = 0.1


@dataclass(frozen=True)
class Guards:
    """Limits that stop a run; by default there are none.

    Parameters
    ----------
    misalignment
        Largest misalignment of a joint [m]; a run that exceeds it stops with the code ``fell-apart``.
    angle_misalignment
        The same for misaligned angles [rad].
    energy_jump
        Largest change of the energy balance in one step, as a share of the largest kinetic energy so far; a run that
        exceeds it stops with the code ``energy-jump``.
    """

    misalignment: float = math.inf
    angle_misalignment: float = math.inf
    energy_jump: float = math.inf


@dataclass(frozen=True)
class Impact:
    """An impulse of the drivers, due to a discontinuous velocity of one of them.

    Parameters
    ----------
    time
        Time of the discontinuity [s].
    energy
        Work of the impulse [J], which is the change of the kinetic energy; it is part of the recorded work.
    velocity
        Change of the velocities, as a root mean square over the mass [m/s].
    """

    time: float
    energy: float
    velocity: float


@dataclass(frozen=True)
class StepEvidence:
    """Quantities observed over all steps so far, recorded or not.

    Parameters
    ----------
    energy_jump, energy_jump_time
        Largest absolute change of the energy balance in one step [J], without the changes due to projections,
        Baumgarte's terms and impulses, and the time at the end of that step [s].
    kinetic
        Largest kinetic energy [J].
    branch
        Sharp turns of the velocity near singular positions, in order of time. There the run may have changed to another
        branch, that is, another possible motion.
    impacts
        Impulses of the drivers, which are not part of the energy jumps.
    """

    energy_jump: float
    energy_jump_time: float
    kinetic: float
    branch: tuple[BranchSuspicion, ...] = ()
    impacts: tuple[Impact, ...] = ()


@dataclass(frozen=True)
class Timetable:
    """Start, end and steps of a run, and the states that are recorded.

    Parameters
    ----------
    start, end
        Time span [s].
    step
        Fixed step, or first step of an adaptive method [s]; None if the method chooses it.
    steps
        Number of fixed steps N.
    every
        Number k: every k-th step, the start and the end are recorded.
    interval
        Time between recorded states [s], which dense output computes; an alternative to `every`.
    max_steps
        Steps after which the run stops.
    nodes
        Whether states within the steps are stored as quadrature nodes of time integrals; see `Advancing.taken_nodes`.
    single
        Whether `Stepper.advance` takes one accepted step per call, so that it can be searched for events.
    guards
        Limits that stop the run.
    stops
        Times at which motions or loads, or their derivatives, are discontinuous, in order, between `start` and `end`
        and farther than `SAME_TIME` margins from both [s]. Steps end there, and the step after a stop uses no values of
        the previous step. A fixed step is split; N, `every` and the rows then still refer to whole steps, while
        `max_steps` and the counters count the parts.
    stop_margins
        Margin of each stop [s]. In the step that ends at a stop, motions are evaluated no later than the stop less its
        margin; in the next step, no earlier than the stop plus its margin. Each step thus uses one-sided limits of the
        motions; see `sides`. The margin is 0 where motions are continuous, as where inputs are set.
    impacts
        Stops at which the velocity of a driver is discontinuous, so that an impulse changes the velocities.
    samples
        Stops at which the values that sampled controllers hold change.
    step_limits
        Largest controlled steps, so that none misses what a function of time does: pairs of the time from which on a
        limit applies and the step, in order [s]. Limits change at stops only.

    A state that is recorded at a stop is the limit from before; `before` returns the times for its evaluation.
    """

    start: float
    end: float
    step: float | None = None
    steps: int = 0
    every: int = 1
    interval: float | None = None
    max_steps: int = 10_000_000
    nodes: bool = False
    single: bool = False
    guards: Guards = Guards()
    stops: tuple[float, ...] = ()
    stop_margins: tuple[float, ...] = ()
    impacts: tuple[float, ...] = ()
    samples: tuple[float, ...] = ()
    step_limits: tuple[tuple[float, float], ...] = ()

    def longest_step(self, t: float) -> float:
        """Return the largest controlled step from time `t` on, up to the next stop [s]; infinite without a limit."""
        number = bisect(self.step_limits, (t, math.inf))
        return self.step_limits[number - 1][1] if number else math.inf

    def sides(self, passed: int) -> tuple[float, float]:
        """Return the earliest and the latest time [s] at which motions are evaluated after `passed` stops.

        They are infinite before the first stop and after the last one, respectively, and beside a stop without margin.
        """
        margins = self.stop_margins
        begin = self.stops[passed - 1] + margins[passed - 1] if passed and margins[passed - 1] else -math.inf
        is_limited = passed < len(self.stops) and margins[passed]
        return begin, self.stops[passed] - margins[passed] if is_limited else math.inf

    def before(self, times: np.ndarray) -> np.ndarray:
        """Return times (T,) [s], in place of those at stops with a margin the latest times before these stops."""
        if not self.stops:
            return times
        stops, margins = np.array(self.stops), np.array(self.stop_margins)
        last = np.maximum(0, np.searchsorted(stops, times + closeness(self.end), side="right") - 1)
        is_same = (np.abs(times - stops[last]) <= closeness(self.end)) & (margins[last] > 0.0)
        return np.where(is_same, np.minimum(times, stops[last] - margins[last]), times)

    @property
    def last_step(self) -> float:
        """Size of the last fixed step [s]: ``step`` unless it would pass the end."""
        assert self.step is not None
        rest = self.end - (self.start + (self.steps - 1) * self.step)
        return self.step if abs(rest - self.step) <= 1e-9 * self.step else rest


def closeness(time: float) -> float:
    """Return the largest distance of times [s] that are the same instant as a time."""
    return SIMULTANEOUS * max(1.0, abs(time))


class Goal(NamedTuple):
    """Where an open run pauses: after a number of whole fixed steps, at a stop of its plan, or at a stop of its own."""

    time: float  #: The time [s].
    reached: float  #: The time less the margin of the stop there [s].
    whole: int = -1  #: Number of fixed steps after which the run pauses; -1 if it pauses at a stop.
    pause: float = math.inf  #: Time of the additional stop [s]; infinite if there is none.


ENDLESS = Goal(math.inf, math.inf)  #: The goal of a run that does not pause.


def on_grid(time: float, start: float, step: float, end: float) -> float:
    """Return the end of a whole fixed step that equals a time of a run up to rounding errors; otherwise, the time [s].

    `start`, `step`, `end`: start of the run, size of its fixed steps, and end [s].
    """
    whole = start + round((time - start) / step) * step
    return whole if abs(whole - time) <= same_time(start, end) else time


#: A state: positions and velocities (3 (B + 1),), ground last, and first-order states (Z,).
Moment = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass
class Stretch:
    """The recorded states of one stretch (part) of a run: T rows."""

    time: np.ndarray
    q: np.ndarray  #: (T, 3 (B + 1)) positions, ground last.
    v: np.ndarray
    work: np.ndarray
    dissipated: np.ndarray
    #: (T, 6) float: time, steps, size, iterations, iterations_max, rejected of the interval that ends with each row.
    intervals: np.ndarray
    multipliers: np.ndarray | None = None  #: (T, m) multipliers computed by the method itself, if there are any.
    #: (T, 4) of the interval that ends with each row, if the run is stabilized: number of projections, largest
    #: correction of positions [m] and of velocities [m/s] in the mass metric, largest Baumgarte term [m/s^2, rad/s^2].
    corrections: np.ndarray | None = None
    z: np.ndarray | None = None  #: (T, Z) first-order states of force elements; may be None if there are none.

    def rows(self, part: slice | np.ndarray) -> Stretch:
        """Return the rows in a slice or a mask (T,)."""
        chosen: dict[str, Any] = {}
        for item in fields(self):
            values = getattr(self, item.name)
            chosen[item.name] = None if values is None else values[part]
        return Stretch(**chosen)


def joined(stretches: Sequence[Stretch]) -> Stretch:
    """Return consecutive stretches as one; an optional array that is None in one of them is None in the result."""
    if len(stretches) == 1:
        return stretches[0]
    whole: dict[str, Any] = {}
    for item in fields(Stretch):
        parts = [getattr(stretch, item.name) for stretch in stretches]
        whole[item.name] = None if any(part is None for part in parts) else np.concatenate(parts)
    return Stretch(**whole)


@dataclass(frozen=True)
class Nodes:
    """States within steps, with weights: a time integral is the sum of ``weight`` times the values in the states.

    Parameters
    ----------
    time, weight
        (N,) times and weights [s].
    q, v
        (N, 3 (B + 1)) positions and velocities, ground last.
    """

    time: np.ndarray
    weight: np.ndarray
    q: np.ndarray
    v: np.ndarray

    def part(self, some: slice) -> Nodes:
        """Return the nodes in the slice `some`."""
        return Nodes(*(getattr(self, field.name)[some] for field in fields(self)))

    @classmethod
    def none(cls, size: int) -> Nodes:
        """Return an empty set of nodes of a mechanism with `size` coordinates, those of the ground included."""
        return cls(np.zeros(0), np.zeros(0), np.zeros((0, size)), np.zeros((0, size)))

    @classmethod
    def joined(cls, parts: Sequence[Nodes]) -> Nodes:
        """Return consecutive nodes as one."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))


class ConsecutiveSteps(NamedTuple):
    """States at the start and at the ends of K steps, between which no velocity or first-order state jumps."""

    time: np.ndarray  #: (K + 1,) times [s].
    q: np.ndarray  #: (K + 1, 3 (B + 1)) positions and velocities, ground last.
    v: np.ndarray
    z: np.ndarray  #: (K + 1, Z) first-order states.

    def every(self, count: int) -> ConsecutiveSteps:
        """Return each `count`-th state, from the first one on."""
        return ConsecutiveSteps(*(values[::count] for values in self))


@dataclass(frozen=True)
class StepTaken:
    """One accepted step: the times [s] of its start and its end, positions and velocities there (3 (B + 1),), ground
    last, and first-order states (Z,).
    """

    t0: float
    t1: float
    q0: np.ndarray
    v0: np.ndarray
    q1: np.ndarray
    v1: np.ndarray
    z0: np.ndarray = field(default_factory=lambda: np.zeros(0))
    z1: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def ends(self) -> ConsecutiveSteps:
        """The states at the start and at the end of the step."""
        pairs = (self.t0, self.t1), (self.q0, self.q1), (self.v0, self.v1), (self.z0, self.z1)
        return ConsecutiveSteps(*map(np.array, pairs))

    def between(self, theta: float) -> Moment:
        """Return the state at the share `theta` of the step: exact at its ends, otherwise by interpolation.

        Positions and velocities are those of `hermite`, first-order states are interpolated linearly.
        """
        if theta in (0.0, 1.0):
            return (self.q1, self.v1, self.z1) if theta else (self.q0, self.v0, self.z0)
        return *self.hermite(theta), self.z0 + theta * (self.z1 - self.z0)

    def time(self, theta: float) -> float:
        """Return the time [s] at the share `theta` of the step; exact at both ends."""
        return self.t1 if theta == 1.0 else self.t0 + theta * (self.t1 - self.t0)

    def hermite(self, theta: float) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and velocities of the cubic Hermite interpolant of both ends, of order 3."""
        h, square = self.t1 - self.t0, theta * theta
        powers = [[1.0, theta, square, theta * square], [0.0, 1.0 / h, 2.0 * theta / h, 3.0 * square / h]]
        q, v = product(np.array(powers), self._cubic)
        return q, v

    def quintic(self, a0: np.ndarray, a1: np.ndarray) -> Callable[[float], tuple[np.ndarray, np.ndarray]]:
        """Return a function of the share of the step: positions and velocities of its quintic Hermite interpolant.

        Parameters
        ----------
        a0, a1
            Accelerations (3 (B + 1),) at both ends.
        """
        h = self.t1 - self.t0
        slope, curve = h * self.v0, 0.5 * h * h * a0
        d, e, f = self.q1 - self.q0 - slope - curve, h * self.v1 - slope - 2.0 * curve, h * h * a1 - 2.0 * curve
        highest = np.array([6.0 * d - 3.0 * e + 0.5 * f, -15.0 * d + 7.0 * e - f, 10.0 * d - 4.0 * e + 0.5 * f])
        q = np.concatenate([highest, [curve, slope, self.q0]])
        v = np.array([5.0, 4.0, 3.0, 2.0, 1.0])[:, None] * q[:-1] / h
        return lambda theta: (np.polyval(q, theta), np.polyval(v, theta))

    @cached_property
    def _cubic(self) -> np.ndarray:
        """(4, 3 (B + 1)) coefficients of the powers of theta."""
        h = self.t1 - self.t0
        change, slope0, slope1 = self.q1 - self.q0, h * self.v0, h * self.v1
        return np.array([self.q0, slope0, 3 * change - 2 * slope0 - slope1, slope0 + slope1 - 2 * change])


@dataclass(frozen=True)
class Failure:
    """Reason why a run stopped early: the code in ``status_reason`` of the archive, and a sentence."""

    code: str
    sentence: str


class Advancing(Protocol):
    """An object that advances a run: a `Stepper`, or the wrapper that detects events."""

    @property
    def counters(self) -> Counters:
        """Cost so far."""
        ...

    @property
    def finished(self) -> bool:
        """Whether the run has reached its end."""
        ...

    @property
    def failure(self) -> Failure | None:
        """Why the run stopped early, or None."""
        ...

    @property
    def worst_pairs(self) -> np.ndarray:
        """(P,) largest squared norm of each pair's Phi over all steps so far."""
        ...

    @property
    def time(self) -> float:
        """Time reached [s]."""
        ...

    @property
    def evidence(self) -> StepEvidence:
        """Quantities observed over all steps so far, recorded or not."""
        ...

    def advance(self) -> Stretch:
        """Advance until about `STRETCH` seconds have passed, or to the end or a failure; return the recorded states.

        Under ``Timetable.single``, advance by one accepted step instead.
        """
        ...

    def rows_before_error(self) -> Stretch | None:
        """Return the rows of the last `advance` before the exception that it has raised; None if there are none.

        An exception is raised where it occurs, and never kept for a later call, so that it cannot be lost.
        """
        ...

    def last_state(self) -> Stretch:
        """Return the state reached as one row, for a run that is stopped between two recorded states."""
        ...

    def taken_nodes(self) -> Nodes:
        """Return the nodes of integrals of the steps since the last call; none unless ``Timetable.nodes``.

        They are the stages of the method with its weights, or nodes on an interpolant of the step.
        """
        ...


class Stepper(Advancing, Protocol):
    """Advances one run with a method; returned by `mbdkit.integrators.start.start_method`.

    `last_step` and the methods after it refer to the step taken by the last `advance`, and require
    ``Timetable.single``.
    """

    @property
    def is_fixed(self) -> bool:
        """Whether steps have a fixed size; otherwise, they are controlled."""
        ...

    @property
    def whole(self) -> int:
        """Number of whole fixed steps that are complete."""
        ...

    @property
    def passed(self) -> int:
        """Number of stops that the run has passed."""
        ...

    @property
    def first_size(self) -> float | None:
        """Size of the first step [s], if no stop comes earlier; None if a library chooses it."""
        ...

    def begin_again(self) -> None:
        """Forget that the run has ended and what it has not given yet, before the state of a checkpoint is restored."""
        ...

    def aim(self, goal: Goal) -> None:
        """Let `advance` go no further than a goal."""
        ...

    @property
    def at_goal(self) -> bool:
        """Whether the goal is reached."""
        ...

    @property
    def steps_to_goal(self) -> int:
        """Largest number of steps that do not go beyond the goal, if it is a number of fixed steps."""
        ...

    def hold(self, values: Mapping[int, float]) -> None:
        """Set first-order states by index before the next step, which uses no values of the previous one."""
        ...

    @property
    def last_step(self) -> StepTaken | None:
        """The step that the last `advance` has taken; None if it took none."""
        ...

    def inside(self, theta: float) -> Moment:
        """Return the state at the share `theta` of the last step, by dense output.

        A method without dense output uses the cubic through both ends of the step.
        """
        ...

    def within(self, theta: float) -> Moment:
        """Return the state at the share `theta` of the last step, computed by a shorter step from the same start.

        This does not change the run, apart from the counters. If the step fails, and for methods that cannot repeat a
        step, the result is that of `inside`.
        """
        ...

    def cut(self, theta: float) -> Stretch:
        """End the run at the share `theta` of the last step, at the state given by `within`; return it as a row.

        The caller discards rows that `advance` has returned for this time and later times.
        """
        ...


@dataclass
class Pace:
    """Chooses the number of steps in a stretch (one call of the compiled loop) from the speed so far."""

    steps: int

    def timed(self, done: int, since: float) -> None:
        """Update `steps` after `done` steps since `since` (`time.perf_counter`)."""
        elapsed = max(time.perf_counter() - since, 1e-7)
        if done:
            self.steps = max(1, min(int(done * STRETCH / elapsed), 8 * self.steps))
