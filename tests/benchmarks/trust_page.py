"""`python -m tests.benchmarks.trust_page mbdkit/guide/trust.md`: writes the page on trust, with measured errors.

The limits come from `mbdkit/trust/criteria.py`, the errors from runs of all mechanisms of `tests/witness`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import mbdkit
from mbdkit.archive.accuracy import SMALL_FORCE
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.feature_items import CriterionItem
from mbdkit.runs.accuracy.companion_choice import LOOKS
from mbdkit.runs.accuracy.position_measure import PositionMeasure
from mbdkit.runs.findings import Stage
from mbdkit.runs.findings import criteria as examined_at
from mbdkit.runs.preparation import build
from mbdkit.spec import load_spec
from mbdkit.trust import criteria
from tests.witness.error_bars import FIXED, Truth
from tests.witness.known_motions import known_motions

SETTINGS: tuple[tuple[str, float], ...] = (("rk4", 1.0), ("gauss-2", 4.0), ("gauss-2", 1.0), ("dop853", 1e-6))
"""Methods, with the multiple of the problem's step, or with the tolerance of adaptive steps."""

OUTLINE = """\
# How far can a result be trusted?

<!-- Written by `python -m tests.benchmarks.trust_page mbdkit/guide/trust.md`; do not edit. -->

The verdict on a run, how errors are estimated, what the estimates do not cover, and a comparison with true errors.

Every run has a verdict, which is shown at the top of the summary and in reports. `run.verdict`, `run.verdict_reasons`,
`--json`, the archive and the table of a study contain it too.

| verdict | meaning |
|---|---|
| `good` | the errors were estimated (`--check` or `--accuracy`) for all recorded times, and no value exceeds a limit |
| `unknown` | no value exceeds a limit, but the errors were not estimated; this is the best verdict without a check |
| `doubtful` | a value exceeds its first limit, the errors are known only for a part of the run, or it was interrupted |
| `bad` | a value exceeds its second limit, or the run failed |

A run without a check is never `good`. Its motion can be wrong even if its joints stay closed and its energy balance is
good; an example is a chaotic double pendulum after a few seconds.

## Criteria

| quantity | doubtful above | bad above |
|---|---|---|
{criteria}

Errors of joint forces are divided by at least {small:g} of the largest force of all joints. Joints that carry almost no
force therefore do not make a run `doubtful`.

Energy errors below {rounding:g} times the rounding error of the largest energy count as zero. A run that fails before
its end is `bad`, and a run that was interrupted is at least `doubtful`: its summary says up to which time its results
are valid. Warnings that question the result make a run `doubtful`, as do
[gradients](../../plugins/mbdkit-gradients/src/mbdkit_gradients/guide/gradients.md) that fail their check.

The *branch* of a run is the family of positions that the mechanism can reach continuously from its start. In a singular
position, several branches meet. A run is `bad` if its direction of motion changes sharply there (by at least {angle:g}
rad, and {ratio:g} r, where r is the path on which it changes, divided by the length of the longest link), because it
has then probably left its branch. If joints that are redundant and consistent at the start become inconsistent, the run
stops with the reason `branch-left`.

### Criteria of warnings

Each of these warnings belongs to a criterion. If a warning is known and intended, list its criterion in the spec, as in
`accept: [degrees, left-out]`: the verdict then mentions it without becoming `doubtful`.

| criterion | looks for |
|---|---|
{warnings}

A model that is read from a file of another program may lack effects that the file describes and that change the motion:
these are the doubts of `left-out`. Plugins may add criteria ([items](plugins.md#other-kinds-of-items)).

## What you can ask for

- **`mbdkit run SPEC --check`** (`check: true`) estimates the errors by *comparison runs*: runs by the same method with
  half and a quarter of the step, or with tighter tolerances, and a run by another method. The differences between them
  give an estimated error for every recorded position, velocity, reaction force and reaction torque. From the time at
  which these differences no longer decrease with the step, the estimates are nan; `run.accuracy.known_until` is the
  last recorded time before, and the summary and the verdict give the reason. The summary prints, for example, `largest
  force in J1 24.525000 +- 1.1e-06 N`. In Python, `run.joints["J1"].reaction_force_error` is the error at each time, and
  `print(run.accuracy)` tells what is known. Plots draw the errors as bands, and the group `accuracy` of the archive
  contains them. A force may have its peak between two recorded times: a check determines the largest forces and
  torques there as well, and [states these](#one-number-one-bar). By how much they exceed the recorded ones counts in
  the verdict, except for a joint whose largest force is a measure; smaller steps, or more recorded ones, reduce it. A
  check usually takes 4 to 15 times as long as the run, and longer with beams, controllers or time-stepping methods
  ([performance](performance.md#a-single-run)).
- **`check: true` with estimated parameters** (`parameters: {{from: fit.h5}}`) states the errors by the estimates as
  well, by 2 K more runs for K parameters: bounds of 95 % at each time for normally distributed estimates, to first
  order. They are `run.accuracy.position_error_parameters`, `run.accuracy.reaction_error_parameters`, and
  `run.measures.parameter_errors`; nan where one of these runs stopped early or is not possible. The line `limited` of
  the summary compares both kinds of errors, as in `positions by the data (0.0099 m from parameters, 3e-09 m from
  integration)`. They do not count in the verdict, and include neither an error of the model nor that of parameters that
  are not estimated.
- **`mbdkit run SPEC --accuracy 1e-6`** (`accuracy: 1e-6`) requests that all positions over the whole run are accurate
  to this fraction of the mechanism's size; the error of an angle is multiplied by the distance from the centre of mass
  to the farthest joint point of the body. mbdkit chooses the method and the step from short trial runs (*pilots*), and
  confirms the accuracy by a check. `integrator` and `time.step` may be omitted; if the spec gives an integrator, only
  its step or tolerance is chosen. The summary says what was chosen and why, and `rerun` repeats the run bit for bit. If
  no attempt reaches the accuracy, the best one is returned, and its verdict says so. The request does not apply to
  forces, which are less accurate than positions; add `--check` if their errors matter: with explicit adaptive methods,
  errors are otherwise estimated from the pilots, usually several times too large, in 13 of 147 runs with known motions
  too small, by a factor of 12 at most.
- **`limits`** stop a run. `limits.misalignment` (default 1) limits the misalignment of joints as a share of the
  mechanism's size, or of 1 rad for angles. `limits.energy_jump` (off by default) limits the change of the energy
  balance in one step, as a share of the largest kinetic energy so far. `limits.law_range: stop` stops the run when a
  force law leaves the range in which it is valid. `limits.max_steps` and `limits.wall_time` limit steps and time.
- **`stabilization: projection`** returns positions and velocities to the constraints after every step. Misalignments
  are then at the level of rounding errors, and adaptive methods stay on their branch in singular positions. Projection
  alone does not make the motion more accurate.

## One number, one bar

A number has the same value and the same bar in the summary, `--json`, the report, plots, the workload and the
archive. Its *id* is the expression of a largest value, such as `max(abs(joints.A.force))`, or `measures.NAME`;
`d(NAME)/d(PARAMETER)` is that of a derivative. `mbdkit run --json` and `mbdkit inverse --json` list all such numbers
under `answers`, with `id`, `label`, `value`, `unit`, `lower`, `upper` and `text`; the root attribute `answers` of
checked archives is the same list, elements of reports have the attribute `data-id`, and titles of plots as SVG have
the id.

A bar says how far the true value may lie below (`lower`) and above (`upper`). It is written `1970 +- 700 N` if both are
equal, and `1970 (-380, +900) N` otherwise.

| number | its bar contains | what it leaves out, and where that is said |
|---|---|---|
| largest load of a checked run | the error of the method at any time, and of the value between recorded times | errors by estimated parameters: a second bar, `by parameters`; what the line `error bars` names, such as the mesh of beams |
| measure, derivative | the error of the method | the same |
| largest load of inverse dynamics | with 95 %: noise of the data, and, with `uncertainty`, the person, muscles, plates and devices | what the line `error bars` names, such as muscles that the model lacks |
| change by a [worn device](../../plugins/mbdkit-wearable/src/mbdkit_wearable/guide/misfit.md) | with 95 %: the person, muscles, misfit and tissue | noise of the data, which changes the force with and without the device alike: the line `devices` |

The largest value is that of the whole motion, not of the recorded rows. Where the value between rows is not known, the
number is that `in the recorded rows`: in runs without check that have no measure of it, unless all ends of steps are
recorded and parabolas through them exceed it by less than 1e-5 of it. Errors at single times, such as
`run.accuracy.reaction_error`, are no bars of largest values.

## What is not promised

- **Chaos.** If small differences grow exponentially, no method and no step size gives the right states after a certain
  time, because even rounding errors make the comparison runs diverge. `known_until` gives this time. With `--accuracy`,
  such a run has the verdict `doubtful`.
- **Short pulses of loads.** Steps end at the points of tables, and wherever an expression of time or one of its
  derivatives is discontinuous. An adaptive method can miss a smooth pulse that is shorter than its step; `max_step`
  prevents this. The comparison runs of a check take at least {looks} steps, and can miss a pulse that is shorter than
  these steps.
- **Narrow forces.** Adaptive steps end where expressions of the state and laws switch (`max`, `min`, `abs`, `atan2`,
  conditions of laws in SymPy, one-sided springs), so that they see a stop or a barrier of any width. They can pass over
  a *smooth* force that acts on a way shorter than a step, such as `exp(-((b.x - 1)/1e-5)**2)`, over an interval of a
  table that is as short, and over what a law written as a Python function does; so can comparison runs. Set `max_step`
  to a fraction of this way divided by the largest speed.
- **Forces that hold a motion at their own jump**, such as friction given by `-b.vx/abs(b.vx)`: the force switches without
  end. Steps then pass over its jumps, and the run is doubtful.
- **Impacts of drivers.** A driver with a discontinuous velocity is refused unless `impacts: allow` is set; the driver
  then applies an impulse.
- **Singular positions.** If several motions are possible in a singular position, the equations do not determine which
  one is right. A sharp change of direction is reported; a smooth change of branch may remain unnoticed.
- **Redundant joints.** Their reactions are not unique. The reactions of least norm are recorded.
- **The model.** All estimates concern the numerical solution of the equations of the model, not the model itself.
- **The mesh of beams.** Comparison runs have the same elements as the run, so that estimates do not include the error
  of the mesh. Compare the run with one that has twice as many elements. Elements that are clearly too coarse cause a
  warning and the verdict `doubtful` ([beams](beams.md#elements)).

An estimate is not a bound. On the mechanisms below, with six methods and four steps each, the true error is between 1/5
and 3 times the estimate for at least 95 % of all values with a known error, and never above ten times the estimate.
`python -m tests.benchmarks.error_bars` prints this comparison.

## Measured errors

Every row of the table is a run with `check: true`. The true motion of the mechanism is known independently: from a
closed form, or from equations in minimal coordinates that are integrated with a tolerance of 1e-13. The errors are the
largest errors up to the time in the column "known until". Errors of positions are shares of the mechanism's size,
errors of joint forces are shares of the largest force in the joint. Estimates of 0 or at the level of rounding errors
cannot be tested, because the reference motion has rounding errors too. `-` means that the error is unknown. A verdict
is `doubtful` in spite of small errors where the force in a joint exceeds that in the recorded rows by more than 1 %
between two of them.

| mechanism | method | position: true | estimate | force: true | estimate | known until | verdict |
|---|---|---|---|---|---|---|---|
{rows}
"""  # noqa: E501 (tables)


@dataclass(frozen=True)
class Row:
    """A line of the table: names, true and estimated shares, times [s], and the verdict."""

    problem: str
    method: str
    position: tuple[float, float]
    force: tuple[float, float]
    known_until: float
    end: float
    verdict: str

    def __str__(self) -> str:
        known = math.isfinite(self.known_until)
        until = f"{self.known_until:.3g} of {self.end:.3g} s" if known else "-"
        values = [_number(value) for pair in (self.position, self.force) for value in pair]
        return f"| {' | '.join([self.problem, self.method, *values, until, self.verdict])} |"


def _number(value: float) -> str:
    return f"{value:.1e}" if math.isfinite(value) and value else "0" if value == 0 else "-"


def row(truth: Truth, method: str, setting: float) -> Row:
    """Run a problem with a check, and compare."""
    known = truth.known
    time: dict[str, Any] = {"end": known.end}
    if method == "dop853":
        integrator: dict[str, Any] = {"name": "dop853", "adaptive": True, "rtol": setting, "atol": setting}
        name = f"dop853, tolerance {setting:g}"
    else:
        integrator, time["step"] = FIXED[method], setting * known.step
        name = f"{method}, step {time['step']:g} s"
    spec = load_spec({"mbdkit": 1, "model": known.model, "integrator": integrator, "time": time, "check": True})
    run = mbdkit.run(spec)
    accuracy = run.accuracy
    count = 0 if accuracy is None else accuracy.rows_known
    position = force = (math.nan, math.nan)
    if accuracy is not None and count:
        values, _ = truth.at(run.time[:count])
        measure = PositionMeasure.of(spec, build(spec)[0])
        true = measure.share(run.array("trajectory/position")[:count] - values[0])
        position = float(np.max(true)), float(measure.share(accuracy.position_error[count - 1 : count])[0])
        reaction = run.array("joints/reaction_force")
        peaks = np.max(np.linalg.norm(reaction, axis=-1), axis=0, initial=0.0)
        loaded = peaks > 1e-9 * np.max(peaks, initial=0.0)
        wrong = np.max(np.linalg.norm(reaction[:count] - values[2], axis=-1), axis=0, initial=0.0)
        if np.any(loaded):
            worst = int(np.argmax(np.where(loaded, wrong / np.where(loaded, peaks, 1.0), -1.0)))
            force = wrong[worst] / peaks[worst], accuracy.reaction_error[count - 1, worst] / peaks[worst]
        else:
            force = 0.0, 0.0
    until = math.nan if accuracy is None else accuracy.known_until
    return Row(known.name, name, position, force, until, known.end, run.verdict)


def criteria_rows() -> list[str]:
    """Return the lines of the table of criteria."""
    size, kinetic = "as a share of the mechanism's size", "as a share of the largest kinetic energy"
    named: Sequence[tuple[str, criteria.Limits]] = (
        (f"largest misalignment of a joint, {size}; of an angle, in rad", criteria.MISALIGNMENT),
        (f"largest energy balance, {kinetic}", criteria.ENERGY),
        (f"estimated error of positions, {size}", criteria.KNOWN_POSITION),
        ("estimated error of a joint force, as a share of the largest force in the joint", criteria.KNOWN_REACTION),
    )
    rows = [f"| {what} | {limits.doubtful:g} | {limits.bad:g} |" for what, limits in named]
    return [*rows, f"| change of the energy balance in one step, {kinetic} | - | {criteria.ENERGY_JUMP:g} |"]


def warning_rows() -> list[str]:
    """Return the lines of the table of criteria of warnings."""
    rows = {" ".join(f"`{name}`" for name in one.accepted): one.summary for _, one in every_criterion() if one.accepted}
    rows["`law-ranges`"] = "Arguments that leave the range in which a force law is defined."
    return [f"| {names} | {summary[0].lower()}{summary[1:].removesuffix('.')} |" for names, summary in rows.items()]


def every_criterion() -> list[tuple[Registered, CriterionItem]]:
    """Return the criteria of mbdkit that examine runs."""
    stages: tuple[Stage, ...] = ("spec", "start", "rows", "end")
    found = [one for stage in stages for one in examined_at(stage)]
    return [one for one in found if one[0].origin.distribution == "mbdkit"]


def measured_rows() -> Iterator[str]:
    """Yield the lines of the table of measured errors."""
    for known in known_motions():
        truth = Truth(known)
        for method, setting in SETTINGS:
            line = str(row(truth, method, setting))
            print(line, file=sys.stderr, flush=True)
            yield line


def page(rows: Iterable[str]) -> str:
    """Return the page with lines of the table of measured errors."""
    return OUTLINE.format(
        criteria="\n".join(criteria_rows()),
        warnings="\n".join(warning_rows()),
        small=SMALL_FORCE,
        rounding=criteria.ROUNDING,
        angle=criteria.BRANCH_ANGLE,
        ratio=criteria.BRANCH_RATIO,
        looks=LOOKS,
        rows="\n".join(rows),
    )


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(measured_rows()), encoding="utf-8")
