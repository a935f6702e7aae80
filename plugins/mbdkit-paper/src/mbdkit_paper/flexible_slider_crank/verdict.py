"""Verdict on the packaged study `flexible-slider-crank`: relation between misalignment and errors of forces in a
flexible linkage.

Errors of joint forces are differences from the run of Gauss 3 with the smallest step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbdkit.archive.run import Run
from mbdkit_paper.drift.combination import state_of, two
from mbdkit_paper.wording import Words, reported
from mbdkit_report import Answer, Claim, Column, Figure, Line, Table, Verdict, columns_of, exceeds
from mbdkit_studies import METHOD, STEP, Study, value
from mbdkit_studies.results.judge import study_verdict

REFERENCE = ("Gauss 3", 2e-6)
HELD = 1e-7  #: Joints count as closed if their misalignment [m] is below this.
#: Joint forces are right if their errors, relative to the root mean squares of the forces, are below `SMALL`, and wrong
#: if the errors are above `LARGE`.
SMALL, LARGE = 0.1, 0.2
EXPLICIT = 2e-6
#: Largest stable step of explicit methods, which is limited by the fastest oscillation of the rod [s].
WORDS = Words(__file__)


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
    joints, cranks = _runs(study)
    own = [crank for crank in cranks if crank.method not in study.spec.added]
    claims = reported((_held(own), _stable(own), _agree(own), _hidden(own)))
    tables = (_table(joints, cranks),)
    return WORDS.verdict("flexible-slider-crank", study.spec.title, claims, tables, _figure(cranks))


def _runs(study: Study) -> tuple[list[str], list[CrankRun]]:
    joints: list[str] = []
    cranks = []
    for point in study.points:
        crank = CrankRun(
            point.family, str(point.axes[METHOD]), float(point.axes[STEP]), value(point, "wall_s"), (),
            np.zeros((0, 0, 2)), (), state_of([point]),
        )  # fmt: skip
        run = study.run(point) if point.status == "complete" else None
        if run is not None:
            with run:
                joints, crank = _with_forces(run, crank)
        cranks.append(crank)
    exact = next((one.forces for one in cranks if (one.method, one.step) == REFERENCE and not one.state), None)
    if exact is not None:
        cranks = [crank if crank.state else replace(crank, errors=_errors(crank, exact)) for crank in cranks]
    return joints, cranks


def _with_forces(run: Run, crank: CrankRun) -> tuple[list[str], CrankRun]:
    # the motor has a torque, but no force
    joints = [name for name in run.joint_names if np.any(run.joints[name].reaction_force)]
    forces = np.stack([np.asarray(run.joints[name].reaction_force) for name in joints], axis=1)
    gaps = tuple(run.joints[name].misalignment_max for name in joints)
    return joints, replace(crank, misalignment=gaps, forces=forces)


def _errors(crank: CrankRun, exact: np.ndarray) -> tuple[float, ...]:
    if crank.forces.shape != exact.shape:
        return ()
    difference, size = (np.sqrt(np.mean(np.sum(x**2, axis=-1), axis=0)) for x in (crank.forces - exact, exact))
    return tuple((difference / size).tolist())


def _names(cranks: Sequence[CrankRun]) -> str:
    return "; ".join(f"{crank.method}, {crank.step:g} s" for crank in cranks) or "none"


def _held(cranks: Sequence[CrankRun]) -> Claim:
    complete = [crank for crank in cranks if not crank.state]
    worst = max((max(crank.misalignment) for crank in complete), default=math.nan)
    return WORDS.claim("held", exceeds(HELD, worst), limit=HELD, worst=worst, count=len(complete))


def _stable(cranks: Sequence[CrankRun]) -> Claim:
    explicit = [item for item in cranks if item.family == "explicit"]
    right = {method: [item.step for item in explicit if item.method == method and item.error < SMALL]
             for method in dict.fromkeys(item.method for item in explicit)}  # fmt: skip
    largest = {method: max(steps, default=math.nan) for method, steps in right.items()}
    implicit = max((item.step for item in cranks if item.family == "implicit" and item.error < SMALL), default=math.nan)
    told_steps = ", ".join(f"{method} {step:g} s" for method, step in largest.items())
    unknown = not explicit or any(item.state in ("missing", "not installed") for item in explicit)
    holds = all(step <= EXPLICIT for step in largest.values())  # also false for nan
    answer = Answer.OPEN if unknown else Answer.YES if holds else Answer.NO
    return WORDS.claim("stable", answer, limit=EXPLICIT, percent=100 * SMALL, steps=told_steps, implicit=implicit)


def _agree(cranks: Sequence[CrankRun]) -> Claim:
    methods = dict.fromkeys(crank.method for crank in cranks)
    finest = [min((one for one in cranks if one.method == method), key=lambda one: one.step) for method in methods]
    worst = max((crank.error for crank in finest), default=math.nan)
    answer = exceeds(SMALL, worst) if all(math.isfinite(crank.error) for crank in finest) else Answer.OPEN
    return WORDS.claim("agree", answer, percent=100 * SMALL, worst=100 * worst, count=len(finest))


def _hidden(cranks: Sequence[CrankRun]) -> Claim:
    wrong = [crank for crank in cranks if crank.error > LARGE]
    gap = max((max(crank.misalignment) for crank in wrong), default=math.nan)
    decided = any(crank.error >= 0 for crank in cranks)
    answer = exceeds(HELD, gap) if wrong else Answer.NO if decided else Answer.OPEN
    values = {"limit": HELD, "percent": 100 * LARGE, "count": len(wrong), "gap": gap, "runs": _names(wrong)}
    return WORDS.claim("hidden", answer, **values)


def _table(joints: Sequence[str], cranks: Sequence[CrankRun]) -> Table:
    columns = [*columns_of("method; step [s]; time [s]")]
    columns += [Column(f"misalignment, {name}", "m") for name in joints]
    columns += [Column(f"error of the force, {name}", "%") for name in joints]
    rows = []
    for crank in cranks:
        gaps = [two(gap) for gap in crank.misalignment] or [crank.state] * len(joints)
        errors = [two(100 * error) for error in crank.errors] or [crank.state] * len(joints)
        rows.append((crank.method, f"{crank.step:g}", crank.state or two(crank.seconds), *gaps, *errors))
    return WORDS.table("joints", rows, columns)


def _figure(cranks: Sequence[CrankRun]) -> Figure:
    lines = []
    for method in dict.fromkeys(crank.method for crank in cranks):
        curve = sorted((crank.step, crank.error) for crank in cranks if crank.method == method and crank.error > 0)
        if curve:
            step, error = np.array(curve).T
            lines.append(Line(method, step, error, "both", method))
    return WORDS.figure("force-error", lines)
