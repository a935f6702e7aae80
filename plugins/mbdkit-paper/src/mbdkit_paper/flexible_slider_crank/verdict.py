"""Verdict on the packaged study `flexible-slider-crank`: relation between misalignment and errors of forces in a
flexible linkage.

Errors of joint forces are differences from the run of Gauss 3 with the smallest step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mbdkit_paper.drift.combination import state_of, two
from mbdkit_report.analysis.verdict import (
    Answer,
    Axis,
    Claim,
    Column,
    Figure,
    Line,
    Table,
    Verdict,
    columns_of,
    exceeds,
    told,
)
from mbdkit_studies.results.judge import study_verdict
from mbdkit_studies.results.point_selection import METHOD, STEP, value

if TYPE_CHECKING:
    from mbdkit.plugin import Run
    from mbdkit_studies.study import Study

REFERENCE = ("Gauss 3", 2e-6)
HELD = 1e-7
"""Joints count as closed if their misalignment [m] is below this."""
SMALL, LARGE = 0.1, 0.2
"""Joint forces are right if their errors, relative to the root mean squares of the forces, are below `SMALL`, and wrong
if the errors are above `LARGE`."""
EXPLICIT = 2e-6
"""Largest stable step of explicit methods, which is limited by the fastest oscillation of the rod [s]."""


@dataclass(frozen=True)
class CrankRun:
    """One run of the study.

    Attributes
    ----------
    misalignment
        Largest misalignment of each joint [m]; empty if the run is not complete.
    forces
        (T, J, 2) joint forces [N].
    errors
        Error of the force of each joint, relative to the root mean square of the force; empty if unknown.
    state
        Reason why the run is not complete; empty otherwise.
    """

    family: str
    method: str
    step: float
    seconds: float
    misalignment: tuple[float, ...]
    forces: np.ndarray
    errors: tuple[float, ...]
    state: str

    @property
    def error(self) -> float:
        """Largest error of a joint; nan if the errors are unknown."""
        return max(self.errors, default=math.nan)


@study_verdict
def verdict(study: Study) -> Verdict:
    """Return the verdict on the packaged study `flexible-slider-crank`."""
    joints, found = _runs(study)
    own = [one for one in found if one.method not in study.spec.added]
    claims = told((_held(own), _stable(own), _agree(own), _hidden(own)))
    return Verdict(
        "flexible-slider-crank",
        study.spec.title,
        " ".join(claim.sentence for claim in claims),
        claims,
        (_table(joints, found),),
        (_figure(found),),
        (
            (
                "Errors of joint forces are root mean squares of the difference from Gauss 3 with a step of 2e-06 s, "
                "relative to those of the force, over one turn, of every 0.1 ms."
            ),
            (
                "The rod has no damping, so that the waves which the start causes in it last: methods that keep them "
                "and methods that damp them compute different joint forces."
            ),
        ),
    )


def _runs(study: Study) -> tuple[list[str], list[CrankRun]]:
    joints: list[str] = []
    found = []
    for point in study.points:
        one = CrankRun(
            point.family, str(point.axes[METHOD]), float(point.axes[STEP]), value(point, "wall_s"), (),
            np.zeros((0, 0, 2)), (), state_of([point]),
        )  # fmt: skip
        run = study.run(point) if point.status == "complete" else None
        if run is not None:
            with run:
                joints, one = _with_forces(run, one)
        found.append(one)
    exact = next((one.forces for one in found if (one.method, one.step) == REFERENCE and not one.state), None)
    return joints, [one if one.state or exact is None else replace(one, errors=_errors(one, exact)) for one in found]


def _with_forces(run: Run, one: CrankRun) -> tuple[list[str], CrankRun]:
    # the motor has a torque, but no force
    joints = [name for name in run.joint_names if np.any(run.joints[name].reaction_force)]
    forces = np.stack([np.asarray(run.joints[name].reaction_force) for name in joints], axis=1)
    gaps = tuple(run.joints[name].misalignment_max for name in joints)
    return joints, replace(one, misalignment=gaps, forces=forces)


def _errors(one: CrankRun, exact: np.ndarray) -> tuple[float, ...]:
    if one.forces.shape != exact.shape:
        return ()
    difference, size = (np.sqrt(np.mean(np.sum(x**2, axis=-1), axis=0)) for x in (one.forces - exact, exact))
    return tuple((difference / size).tolist())


def _names(found: Sequence[CrankRun]) -> str:
    return "; ".join(f"{one.method}, {one.step:g} s" for one in found) or "none"


def _held(found: Sequence[CrankRun]) -> Claim:
    complete = [one for one in found if not one.state]
    worst = max((max(one.misalignment) for one in complete), default=math.nan)
    return Claim(
        "held",
        f"Every complete run holds all joints to {HELD:g} m without stabilization.",
        "",
        f"at most {worst:.1e} m in {len(complete)} runs",
        exceeds(HELD, worst),
        f"In {len(complete)} complete runs, explicit and implicit ones, no joint opens by more than {worst:.1e} m.",
    )


def _stable(found: Sequence[CrankRun]) -> Claim:
    explicit = [one for one in found if one.family == "explicit"]
    right = {method: [one.step for one in explicit if one.method == method and one.error < SMALL]
             for method in dict.fromkeys(one.method for one in explicit)}  # fmt: skip
    largest = {method: max(steps, default=math.nan) for method, steps in right.items()}
    implicit = max((one.step for one in found if one.family == "implicit" and one.error < SMALL), default=math.nan)
    told_steps = ", ".join(f"{method} {step:g} s" for method, step in largest.items())
    unknown = not explicit or any(one.state in ("missing", "not installed") for one in explicit)
    holds = all(step <= EXPLICIT for step in largest.values())  # also false for nan
    return Claim(
        "stable",
        f"Explicit methods need steps of {EXPLICIT:g} s or less, although the crank turns in 0.042 s.",
        "",
        f"largest steps with errors below {100 * SMALL:g} %: {told_steps}; implicit methods: {implicit:g} s",
        Answer.OPEN if unknown else Answer.YES if holds else Answer.NO,
        f"Explicit methods need small steps, because nodes of the rod oscillate fast: {told_steps}. Implicit methods "
        f"compute forces to {100 * SMALL:g} % with steps of up to {implicit:g} s.",
    )


def _agree(found: Sequence[CrankRun]) -> Claim:
    methods = dict.fromkeys(one.method for one in found)
    finest = [min((one for one in found if one.method == method), key=lambda one: one.step) for method in methods]
    worst = max((one.error for one in finest), default=math.nan)
    return Claim(
        "agree",
        f"With the smallest step of each method, all compute the same joint forces, within {100 * SMALL:g} %.",
        "",
        f"differences of at most {100 * worst:.2g} % between {len(finest)} methods",
        exceeds(SMALL, worst) if all(math.isfinite(one.error) for one in finest) else Answer.OPEN,
        f"With small steps, joint forces of explicit and implicit methods differ by at most {100 * worst:.2g} %.",
    )


def _hidden(found: Sequence[CrankRun]) -> Claim:
    wrong = [one for one in found if one.error > LARGE]
    gap = max((max(one.misalignment) for one in wrong), default=math.nan)
    decided = any(one.error >= 0 for one in found)
    return Claim(
        "hidden",
        f"Joints that hold to {HELD:g} m do not mean that their forces are right: errors can exceed {100 * LARGE:g} %.",
        "",
        f"{len(wrong)} complete runs, with misalignments of at most {gap:.1e} m: {_names(wrong)}",
        exceeds(HELD, gap) if wrong else Answer.NO if decided else Answer.OPEN,
        f"Misalignment does not tell whether forces are right: {len(wrong)} runs hold their joints to {gap:.1e} m with "
        f"forces that are off by more than {100 * LARGE:g} %, because their steps do not resolve the waves in the rod "
        f"({_names(wrong)}).",
    )


def _table(joints: Sequence[str], found: Sequence[CrankRun]) -> Table:
    columns = [*columns_of("method; step [s]; time [s]")]
    columns += [Column(f"misalignment, {name}", "m") for name in joints]
    columns += [Column(f"error of the force, {name}", "%") for name in joints]
    rows = []
    for one in found:
        gaps = [two(gap) for gap in one.misalignment] or [one.state] * len(joints)
        errors = [two(100 * error) for error in one.errors] or [one.state] * len(joints)
        rows.append((one.method, f"{one.step:g}", one.state or two(one.seconds), *gaps, *errors))
    note = "Largest misalignment over all steps. Times are those of this machine."
    return Table("joints", "Joints of the flexible slider-crank", tuple(columns), tuple(rows), note, headline=True)


def _figure(found: Sequence[CrankRun]) -> Figure:
    lines = []
    for method in dict.fromkeys(one.method for one in found):
        curve = sorted((one.step, one.error) for one in found if one.method == method and one.error > 0)
        if curve:
            step, error = np.array(curve).T
            lines.append(Line(method, step, error, "both", method))
    caption = (
        "Largest relative error of a joint force over one turn; lower is better. Explicit runs that failed are absent."
    )
    return Figure("force-error", "Error of joint forces against the step", caption, Axis("step", "s", log=True),
                  Axis("relative error of joint forces", log=True), tuple(lines))  # fmt: skip
