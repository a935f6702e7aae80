"""Discontinuities of motions and loads of a run, and of their derivatives: stops of its steps, errors and warnings."""

from __future__ import annotations

import re
from bisect import bisect
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass, field
from mbdkit.base.plain_data import quoted
from mbdkit.engine.input_schedule import same_time
from mbdkit.events.state_program import state_program
from mbdkit.expressions.program import Program, parts_of_time
from mbdkit.integrators.interface import SAME_TIME, on_grid
from mbdkit.integrators.run.sampled_control import sample_times
from mbdkit.mechanism.motion_corners import JUMP, Corner, corners_of, jet_of, overshoot, program_of
from mbdkit.mechanism.motion_pieces import step_limits
from mbdkit.mechanism.values import Motion, Table
from mbdkit.runs.run_seams import spec_criterion
from mbdkit.spec import RunSpec
from mbdkit.trust.finding import Finding

_TIME = re.compile(r"\bt\b")

#: If a motion has more points or discontinuities than this, steps do not end there, except at impacts of drivers.
MOST_STOPS = 5000

#: A point of a table with continuous acceleration is not a stop if it is close to the end of a fixed step.
#:
#: Its distance from this end may be at most this share of the step.
ON_GRID = 1e-4

QUINTIC_ORDER = 4  #: Highest order of methods whose fixed steps may cross the points of a quintic spline.

#: Largest error of a rate beside a corner at which drivers have impacts, relative to the rates there.
ACCURATE = 1e-4

#: A warning is issued if the spline of a table overshoots the range of its values by more than this share of the
#: range.
OVERSHOOT = 0.1


@dataclass(frozen=True)
class Stops:
    """Times [s] at which steps end.

    `margins` [s] are the uncertainties of `times`. `impacts` maps each time at which velocities of drivers are
    discontinuous to the names of these drivers. `samples` are the times at which an output of a controller changes.
    Margins are 0 at times without a discontinuity, at which inputs are set, the spec asks for the end of a step, or
    another limit of controlled steps begins. `step_limits` are these limits: pairs of time and largest step [s].
    """

    times: tuple[float, ...] = ()
    margins: tuple[float, ...] = ()
    impacts: Mapping[float, tuple[str, ...]] = field(default_factory=dict)
    samples: tuple[float, ...] = ()
    step_limits: tuple[tuple[float, float], ...] = ()


def stops_of(
    spec: RunSpec, *, all_knots: bool = False, integrands: Sequence[Program] = (), share: float | None = None
) -> Stops:
    """Return the times at which steps of a run have to end, apart from the grid of fixed steps.

    With `all_knots`, points of tables are stops even if they are close to this grid; this is needed for another run of
    the mechanism, with other steps. `integrands` are quantities that are asked for; `share`: see
    `mbdkit.mechanism.motion_pieces.step_limits`. Raises the errors of `RunSpec.mechanism`, and SpecError if a
    controller would be sampled more often than ``limits.max_steps``.
    """
    start, end = spec.time.start, spec.time.final
    motions = functions_of_time(spec)
    motions += [("measures", part) for program in integrands for part in parts_of_time(program)]
    soft = _soft_stops(spec)
    if not motions and not soft and not spec.mechanism().controllers:
        return Stops()
    programs = [program_of(motion) for _, motion in motions if isinstance(motion, str | tuple)]
    limits = step_limits(programs, start, end, MOST_STOPS, share) if spec.claims.adaptive else []
    places = [(time, 0.0, False, "") for time in [*soft, *(time for time, _ in limits[1:])]]
    places += [(time, margin, True, "") for time, margin in _samples(spec)]
    drivers = _drivers(spec)
    for key, motion in motions:
        corners = corners_of(motion, start, end)
        for corner in corners:
            struck = drivers.get(key, "") if corner.jumps[1] else ""
            if struck or (len(corners) <= MOST_STOPS and (all_knots or _needs_stop(spec, corner, motion))):
                places.append((corner.time, corner.margin, False, struck))
    rounding = same_time(start, end)
    times: list[float] = []
    margins: list[float] = []
    impacts: dict[float, tuple[str, ...]] = {}
    samples: list[float] = []
    for time, margin, is_sample, struck in sorted(places, key=lambda item: item[0]):
        if _is_at_end(time, margin or rounding / SAME_TIME, start, end):
            continue
        if times and time - times[-1] <= max(2.0 * (margin + margins[-1]), rounding):  # count as simultaneous
            if margin or margins[-1]:  # a stop without margin belongs to a discontinuity that is close to it
                margins[-1] = max(margins[-1], time + margin - times[-1])
        else:
            times.append(time)
            margins.append(margin)
        if struck and struck not in impacts.get(times[-1], ()):
            impacts[times[-1]] = (*impacts.get(times[-1], ()), struck)
        if is_sample and times[-1] not in samples[-1:]:
            samples.append(times[-1])
    # where a limit begins, a discontinuity may be close by, at which steps end instead
    limits = [([start, *times][bisect(times, at)], size) for at, size in limits]
    return Stops(tuple(times), tuple(margins), impacts, tuple(samples), tuple(limits))


def functions_of_time(spec: RunSpec) -> list[tuple[str, Motion | Program]]:
    """Return (key path, function) of every function of time that acts in a run, or that its events look at.

    These are motions, loads and excitations, and the largest parts of expressions of the state that depend on t alone.
    """
    mechanism = spec.mechanism()
    programs = [
        (key, state_program(text, mechanism)[0])
        for key, text in mechanism.expressions()
        if _TIME.search(text) and not key.startswith("model.controllers.")  # sampled
    ]
    programs += [(f"events.{quoted(name)}.when", event.program) for name, event in spec.watched().items()]
    parts = [(key, part) for key, program in programs for part in parts_of_time(program)]
    return [*mechanism.motions(), *parts]


def _soft_stops(spec: RunSpec) -> list[float]:
    """Return the times in a run at which inputs are set, and those of `time.stops` [s].

    Motions are continuous there. A time that equals the end of a fixed step, or else the time of a row, up to rounding
    errors is replaced by it: a fixed step then remains whole, and a row shows the state before the change. Raises
    SpecError if an input is set more often than ``limits.max_steps``.
    """
    start, end, schedules = spec.time.start, spec.time.final, spec.schedules()
    within = [[time for time in schedule.times if start < time < end] for schedule in schedules]
    for name, times in zip(spec.mechanism().inputs, within, strict=True):
        if len(times) > spec.limits.max_steps:
            message = f"the input would be set more often than limits.max_steps = {spec.limits.max_steps}"
            raise spec.placed(SpecError(message, key=f"inputs.{quoted(name)}"))
    every = {*spec.time.stops, *(time for times in within for time in times)}
    for grid in (spec.output.interval, None if spec.claims.adaptive else spec.time.step):
        every = every if grid is None else {on_grid(time, start, grid, end) for time in every}
    return sorted(every)


def _samples(spec: RunSpec) -> Iterator[tuple[float, float]]:
    start, end = spec.time.start, spec.time.final
    controllers = spec.mechanism().controllers
    for name, controller in controllers.items():
        if (end - start) / controller.period > spec.limits.max_steps:
            message = f"the controller would be sampled more often than limits.max_steps = {spec.limits.max_steps}"
            raise spec.placed(SpecError(message, key=f"model.controllers.{quoted(name)}.period"))
    margin = 4.0 * float(np.spacing(max(abs(start), abs(end))))
    sampled = [(controller.period, controller.delay) for controller in controllers.values()]
    yield from ((time, margin) for time in sample_times(sampled, start, end))


def check_jumps(spec: RunSpec) -> None:
    """Check that the motions of all drivers are continuous, and their velocities too unless the spec allows impacts.

    Raises SpecError with the key path of the first motion that violates this.
    """
    for name, joint in spec.mechanism().joints.items():
        for key, motion in joint.motions():
            try:
                _check_driver(spec, motion, joint.units[0])
            except SpecError as error:
                raise spec.placed(error.located(prefix=f"model.joints.{quoted(name)}.{key}")) from None


def _check_driver(spec: RunSpec, motion: Motion, unit: str) -> None:
    start, end = spec.time.start, spec.time.final
    for corner in corners_of(motion, start, end):
        if _is_at_end(corner.time, corner.margin, start, end):
            _check_end(motion, corner, start, end, unit)
        elif corner.jumps[0]:
            raise SpecError(
                f"the value of this motion jumps from {corner.before[0]:.6g} to {corner.after[0]:.6g} {unit} "
                f"at t = {corner.time:.6g} s, which no driver can follow; write it without the jump "
                "(atan2 jumps by 2 pi where its first argument changes sign and the second is negative)"
            )
        elif corner.jumps[1] and spec.impacts == "refuse":
            raise SpecError(
                f"the rate of this motion jumps from {corner.before[1]:.6g} to {corner.after[1]:.6g} {unit}/s "
                f"at t = {corner.time:.6g} s, which needs an impulse; smooth the motion there, for example by a "
                "ramp such as 0.5*(1 - cos(pi*t)) or a table with a few points around the jump, or set "
                "`impacts: allow` to change the velocities there by an impulse"
            )
        elif corner.jumps[1]:
            _check_accuracy(motion, corner, unit)


def _check_accuracy(motion: Motion, corner: Corner, unit: str) -> None:
    """Check that a motion gives its rates beside a corner; those of ``asin(sin(t))``, for example, are rounding errors.

    Raises SpecError if it does not.
    """
    beside = np.array([corner.time - corner.margin, corner.time + corner.margin])
    given, right = jet_of(motion, beside).rate, np.array([corner.before[1], corner.after[1]])
    if not np.all(np.abs(given - right) <= ACCURATE * np.max(np.abs(right))):
        raise SpecError(
            f"the rate of this motion jumps from {corner.before[1]:.6g} to {corner.after[1]:.6g} {unit}/s at t = "
            f"{corner.time:.6g} s, and rounding errors of the expression hide its derivatives near this time; write "
            "the motion with abs, min or max, or as a table with `interpolation: linear`"
        )


@spec_criterion
def overshoots_and_corners(spec: RunSpec, _measures: Sequence[str] = ()) -> Iterator[Finding]:
    """Yield doubts about tables that overshoot, and motions with too many discontinuities."""
    for key, motion in spec.mechanism().motions():
        if isinstance(motion, Table) and (share := overshoot(motion)) > OVERSHOOT:
            sentence = (
                f"the {motion.interpolation} spline of the table at {key} leaves the range of its values by "
                f"{share:.3g} times this range; use points closer together where the values change quickly, or "
                "`interpolation: linear`"
            )
            yield Finding("overshoots", "doubtful", sentence, key, is_named=False)
        count = len(corners_of(motion, spec.time.start, spec.time.final))
        if count > MOST_STOPS and not (isinstance(motion, Table) and not motion.period):
            what = "periodic table" if isinstance(motion, Table) else "expression"
            sentence = (
                f"the {what} at {key} has {count} discontinuities of its value or derivatives, more than "
                f"{MOST_STOPS}, so that steps do not end there; methods of high order lose their order"
            )
            yield Finding("corners", "doubtful", sentence, key, is_named=False)


def _is_at_end(time: float, margin: float, start: float, end: float) -> bool:
    return min(time - start, end - time) <= SAME_TIME * margin


def _drivers(spec: RunSpec) -> dict[str, str]:
    """Return the name of the driver that follows each motion, by the key path of the motion."""
    joints = spec.mechanism().joints
    return {f"model.joints.{quoted(name)}.{key}": name for name, joint in joints.items() for key, _ in joint.motions()}


def _needs_stop(spec: RunSpec, corner: Corner, motion: Motion | Program) -> bool:
    """Return whether steps have to end at a discontinuity.

    Fixed steps need not end at points of tables that are close to the grid. Fixed steps of methods of up to order 4
    need not end at points of quintic splines either, where only the fifth derivative is discontinuous. If a driver
    follows such a spline, this is the third derivative of the accelerations, and a step across the point has an error
    of order 4.
    """
    step = spec.time.step
    if spec.claims.adaptive or step is None or not (corner.is_knot and corner.is_smooth):
        return True
    if isinstance(motion, Table) and motion.interpolation == "quintic":
        orders = spec.claims.orders_on(spec.formulated.name)
        if orders is not None and max(orders.positions, orders.velocities) <= QUINTIC_ORDER:
            return False
    steps = (corner.time - spec.time.start) / step
    return abs(steps - round(steps)) > ON_GRID


def _check_end(motion: Motion, corner: Corner, start: float, end: float, unit: str) -> None:
    """Raise SpecError if a motion is discontinuous at the start or end of the run and its value there is the outer
    limit.

    The value exactly at the start or end must be the limit from within the run.
    """
    is_start = corner.time - start <= end - corner.time
    inner = corner.after if is_start else corner.before
    here = jet_of(motion, np.array([start if is_start else end])).derivatives[0]
    for k, (what, per) in enumerate((("value", ""), ("rate", "/s"))):
        scale = max(abs(corner.before[k]), abs(corner.after[k]))
        if corner.jumps[k] and not abs(here[k] - inner[k]) <= 1e3 * JUMP * scale:
            where, side = ("start", "after") if is_start else ("end", "before")
            raise SpecError(
                f"the {what} of this motion jumps from {corner.before[k]:.6g} to {corner.after[k]:.6g} {unit}{per} at "
                f"the {where} of the run, t = {corner.time:.6g} s; write the motion that applies {side} this time"
            )
