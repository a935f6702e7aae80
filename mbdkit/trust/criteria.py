"""The verdict on a run, computed from a few numbers with the limits defined here.

A verdict is one of four levels. ``good`` needs an estimate of the error. Without an estimate the best level is
``unknown``, because a run with small misalignments and a good energy balance can still be wrong. An example is a
chaotic double pendulum after a few seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Literal, TypeVar

import numpy as np

from mbdkit.base.frozen import dataclass, field

V = TypeVar("V", float, np.ndarray)

Level = Literal["good", "unknown", "doubtful", "bad"]

LEVELS: tuple[Level, ...] = ("good", "unknown", "doubtful", "bad")  #: All levels, from the best to the worst.

#: Reason shown with the level ``unknown`` if the verdict has no other reason.
NOTHING_SUSPICIOUS = "nothing suspicious seen; error not estimated"


@dataclass(frozen=True)
class Limits:
    """Two limits of a quantity: a run is doubtful above the first and bad above the second."""

    doubtful: float
    bad: float

    def level(self, value: float) -> Level | None:
        """Return the level of a value; None if the value is above neither limit. Values that are not finite are bad."""
        if not value <= self.bad:  # also true for nan
            return "bad"
        return "doubtful" if value > self.doubtful else None

    def __str__(self) -> str:
        return f"doubtful above {self.doubtful:g}, bad above {self.bad:g}"


#: Limits of the largest misalignment, as a share of the mechanism's size; for angles, in radians.
#:
#: Measured in 246 runs of 2 to 3 s (eight mechanisms, seven methods, five steps) against Gauss with five stages. A
#: joint force was wrong by more than 5 % of its peak in 64 % of the bad runs, in 11 % of the doubtful runs, in 7 % of
#: the runs with misalignments of 1e-5 to 1e-4, and in no run with smaller misalignments.
MISALIGNMENT = Limits(1e-4, 1e-3)

#: Limits of the largest absolute energy balance, as a share of the largest kinetic energy.
#:
#: In the 246 runs measured for `MISALIGNMENT`, a joint force was wrong by more than 5 % of its peak in 97 % of the bad
#: runs, in 35 % of the doubtful runs, in 3 % of the runs with energy balances of 1e-4 to 1e-3, and in no run with
#: smaller ones.
ENERGY = Limits(1e-3, 0.05)

#: A run is bad if the energy balance changes in one step by more than this share of the largest kinetic energy.
#:
#: All of 61 runs in which an implicit step had accepted a spurious solution of its stage equations exceeded this limit.
#: Of 1,671 other runs, 2 exceeded it, both with errors above 1e-3.
ENERGY_JUMP = 0.05

#: Limits of a turn of the motion near a minimum of the distance to singularity. From these limits on, a run has
#: probably left its branch of the motion.
#:
#: The turn is measured on the shortest path around the minimum that is at least 2 % of the mechanism's characteristic
#: length long. The run is bad if the line of the velocity turns on this path by at least `BRANCH_ANGLE` [rad], and by
#: at least `BRANCH_RATIO` times the length of the path as a share of the characteristic length. The criterion is an
#: angle because another branch of the motion starts in a different direction.
BRANCH_ANGLE, BRANCH_RATIO = 0.25, 4.0

#: Energy errors up to this multiple of `EPS` times the largest energy count as zero. This matters for mechanisms at
#: rest.
ROUNDING = 1e4

#: A misalignment up to this share of the mechanism's size counts as round-off in double precision.
ROUND_OFF = 1e-12

EPS = 2.0**-52


@dataclass(frozen=True)
class BranchSuspicion:
    """A sharp turn of the motion near a singular position.

    `time`: time of the smallest distance to singularity [s]. `angle`: angle between the lines of the velocities before
    and after `time`, in the mass metric [rad]. `path`: length of the path between the states before and after `time` in
    the mass metric, as a share of the mechanism's characteristic length, which is the longest link.
    """

    time: float
    angle: float
    path: float

    @property
    def counts(self) -> bool:
        """Whether the turn is so sharp that the run has probably left its branch of the motion."""
        return self.angle >= BRANCH_ANGLE and self.angle >= BRANCH_RATIO * self.path


@dataclass(frozen=True)
class EstimatedErrors:
    """Estimated errors of a run, over the rows up to `known_until`.

    - `position`: largest error of a position, as a share of the mechanism's size. The error of an angle is multiplied
      by the distance of the farthest joint point of the body.
    - `reaction`: largest error of a joint's force, as a share of the largest force in that joint, or of a thousandth of
      the largest force of all joints, if that is larger; nan if rows skip steps and the force between them is unknown.
    - `known_until`: time up to which the errors are known [s]; nan if no error is known.
    - `asked`, `reached`: requested accuracy of positions and largest estimated error of positions, both as shares of
      the mechanism's size.
    - `missed`: reason why the accuracy was not reached, as a clause; empty if it was reached or if the reason is
      unknown.
    - `between`: a clause with the largest force between recorded rows and in these rows, and advice; empty unless rows
      miss a part of the peak that is larger than the other errors.
    - `unknown`: why errors are unknown after `known_until`, as a clause; empty if all are known.
    - `peak`, `peak_of`: largest error of the largest force of an element of a plugin's kind, as a share of this force,
      and a phrase that names the force; nan if an error is unknown, 0 without such elements.
    """

    position: float
    reaction: float
    known_until: float
    asked: float = math.inf
    reached: float = 0.0
    missed: str = ""
    between: str = ""
    unknown: str = ""
    peak: float = 0.0
    peak_of: str = ""


#: Limits of the estimated errors of positions and angles, as a share of the mechanism's size.
KNOWN_POSITION = Limits(1e-2, 0.1)

#: Limits of the estimated errors of joint forces, as a share of the largest force in the joint; also those of the
#: largest forces of elements of a plugin's kind.
KNOWN_REACTION = Limits(1e-2, 0.1)


@dataclass(frozen=True)
class Evidence:
    """The numbers from which a run is judged, up to its last recorded row.

    - `status`, `status_reason`: status of the run and its reason, as in the archive.
    - `end`: time of the last recorded row [s].
    - `size`: size of the mechanism [m].
    - `misalignment`, `joint`: largest misalignment of a joint over all steps [m], and the name of that joint.
    - `angle_misalignment`, `angle_joint`: largest misalignment of an angle in the recorded rows [rad], and the name of
      the joint.
    - `kinetic`: largest kinetic energy [J].
    - `energy`: largest absolute value of any energy: kinetic, potential, work or dissipated [J]. It determines the
      round-off of the energy balance.
    - `balance`: largest absolute energy balance [J].
    - `energy_jump`, `energy_jump_time`: largest change of the energy balance in one step [J], without the changes that
      stabilization makes, and the time of this change [s].
    - `branch`: sharp turns near singular positions.
    - `warnings`: warnings about the spec or the run that cast doubt on the result, as sentences.
    - `faults`: findings that make the run bad, as sentences.
    - `accepted`: findings that the spec accepts, as sentences. They are among the reasons, but do not lower the level.
    - `finer`: what makes the error of the integration smaller: ``smaller steps`` or, with controlled steps, ``smaller
      tolerances``.
    - `coarse`: returns a sentence if the step is too long, the first cause of an inaccurate or failed run, or "".
    """

    status: str = "complete"
    status_reason: str = ""
    end: float = 0.0
    size: float = 1.0
    misalignment: float = 0.0
    joint: str = ""
    angle_misalignment: float = 0.0
    angle_joint: str = ""
    kinetic: float = 0.0
    energy: float = 0.0
    balance: float = 0.0
    energy_jump: float = 0.0
    energy_jump_time: float = 0.0
    branch: Sequence[BranchSuspicion] = ()
    warnings: Sequence[str] = ()
    faults: Sequence[str] = ()
    accepted: Sequence[str] = ()
    finer: str = "smaller steps"
    coarse: Callable[[], str] = str


@dataclass(frozen=True)
class Judgement:
    """The level of trust in a run, and the reasons for it as sentences with their limits."""

    level: Level
    reasons: tuple[str, ...] = field(default=())


def judge(evidence: Evidence, accuracy: EstimatedErrors | None = None) -> Judgement:
    """Return the verdict on a run.

    `evidence`: the numbers from which the run is judged. `accuracy`: estimated errors; None if they were not estimated,
    so that the verdict is ``unknown`` at best.
    """
    causes: list[tuple[Level, str]] = [
        *_ending(evidence),
        *(("bad", fault) for fault in evidence.faults),
        *(("doubtful", warning) for warning in evidence.warnings),
    ]
    effects = [
        *_energies(evidence),
        *_joints(evidence),
        *_branches(evidence),
        *(() if accuracy is None else _errors(evidence, accuracy)),
    ]
    is_coarse = evidence.coarse() if effects or evidence.status == "failed" else ""
    steps: list[tuple[Level, str]] = [("doubtful", is_coarse)] if is_coarse else []
    findings = [*steps, *causes, *sorted(effects, key=lambda item: -LEVELS.index(item[0]))]
    best: Level = "unknown" if accuracy is None else "good"
    level = max((best, *(level for level, _ in findings)), key=LEVELS.index)
    accepted = (f"Accepted by the spec: {doubt}" for doubt in evidence.accepted)
    return Judgement(level, (*(reason for _, reason in findings), *accepted))


def is_inconspicuous(
    share: np.ndarray, angle: np.ndarray, kinetic: np.ndarray, energy: np.ndarray, errors: Sequence[np.ndarray]
) -> np.ndarray:
    """Return whether the numbers of runs that have no estimated errors give no reason for a verdict, (R,).

    `share`: largest misalignments, as shares of the mechanisms' sizes. `angle`, `kinetic`, `energy`: see `Evidence`.
    `errors`: largest changes of the energy balance in a step, and largest energy balances [J].
    """
    plain = (share <= MISALIGNMENT.doubtful) & (angle <= MISALIGNMENT.doubtful)
    level = rounding(np.maximum(kinetic, energy))
    for error, limit in zip(errors, (ENERGY_JUMP, ENERGY.doubtful), strict=True):
        plain &= (np.abs(error) <= level) | (np.abs(error) <= limit * kinetic * (1.0 - 4.0 * EPS))
    return plain


Found = Iterator[tuple[Level, str]]


def _ending(evidence: Evidence) -> Found:
    if evidence.status == "failed":
        yield "bad", f"The run stopped at t = {evidence.end:.6g} s, before its end: {evidence.status_reason}"
    elif evidence.status == "interrupted":
        yield "doubtful", f"The run was {evidence.status_reason}"


def _joints(evidence: Evidence) -> Found:
    advice = "forces become wrong long before a misalignment is visible"
    gap, angle = evidence.misalignment, evidence.angle_misalignment
    share = gap / evidence.size if evidence.size > 0 else gap
    if level := MISALIGNMENT.level(share):
        off = f"misaligned by up to {gap:.3g} m, {share:.2g} of the mechanism's size"
        yield level, f"Joint '{evidence.joint}' is {off} ({MISALIGNMENT}); {advice}."
    if level := MISALIGNMENT.level(angle):
        off = f"misaligned by up to {angle:.3g} rad"
        yield level, f"The angle of joint '{evidence.angle_joint}' is {off} ({MISALIGNMENT}); {advice}."


def rounding(largest: V) -> V:
    """Return the energy [J] up to which an energy error counts as round-off, if `largest` [J] is the largest energy of
    the run.
    """
    return ROUNDING * EPS * largest


def _share(energy: float, evidence: Evidence) -> float:
    """Return an energy error as a share of the largest kinetic energy; 0 if the error is round-off."""
    if abs(energy) <= rounding(max(evidence.kinetic, evidence.energy)):
        return 0.0
    return abs(energy) / evidence.kinetic if evidence.kinetic > 0 else math.inf


def _energies(evidence: Evidence) -> Found:
    share = _share(evidence.energy_jump, evidence)
    if not share <= ENERGY_JUMP:
        jump = f"by {evidence.energy_jump:.3g} J in one step at t = {evidence.energy_jump_time:.6g} s"
        limit = f"{share:.2g} of the largest kinetic energy (bad above {ENERGY_JUMP:g})"
        yield "bad", f"The energy balance changes {jump}, {limit}. This step is wrong; use {evidence.finer}."
    share = _share(evidence.balance, evidence)
    if level := ENERGY.level(share):
        off = f"by up to {evidence.balance:.3g} J, {share:.2g} of the largest kinetic energy ({ENERGY})"
        yield level, f"The energy balance is violated {off}; use {evidence.finer} or a method of higher order."


def _branches(evidence: Evidence) -> Found:
    limits = f"bad from {BRANCH_ANGLE:g} rad and {BRANCH_RATIO:g} times the path"
    advice = "the run has probably left its branch; compare it with a run with `stabilization: projection`"
    for left in evidence.branch:
        if left.counts:
            turn = f"by {left.angle:.2g} rad on a path of {left.path:.2g} of the longest link ({limits})"
            yield (
                "bad",
                f"The motion changes its direction in a singular position at t = {left.time:.6g} s, {turn}: {advice}.",
            )


def _errors(evidence: Evidence, accuracy: EstimatedErrors) -> Found:
    unconfirmed = accuracy.asked < math.inf and not accuracy.known_until >= evidence.end
    if unconfirmed or accuracy.reached > accuracy.asked:
        known = "unknown" if unconfirmed else f"{accuracy.reached:.2g}"
        because = f": {accuracy.missed}" if accuracy.missed else ""
        what = f"accuracy of positions is {accuracy.asked:g} of the mechanism's size"
        yield "doubtful", f"The requested {what}, but their estimated error is {known}{because}."
    if math.isnan(accuracy.known_until):
        yield (
            "doubtful",
            f"The error could not be estimated: {accuracy.unknown or 'the comparison runs do not converge'}.",
        )
        return
    if accuracy.known_until < evidence.end:
        because = f": {accuracy.unknown}" if accuracy.unknown else ""
        until = f"t = {accuracy.known_until:.6g} s of {evidence.end:.6g} s"
        yield "doubtful", f"The error is known only until {until}{because}."
    if math.isnan(accuracy.reaction):
        yield "bad", "The largest joint forces are unknown, because rows skip steps; record every step."
    for what, value, limits in (
        ("positions", accuracy.position, KNOWN_POSITION),
        ("joint forces", accuracy.reaction, KNOWN_REACTION),
    ):
        if not (what == "joint forces" and math.isnan(value)) and (level := limits.level(value)):
            share = "the mechanism's size" if what == "positions" else "the largest force"
            rows = f" Between rows, the force in {accuracy.between}."
            advice = rows if what == "joint forces" and accuracy.between else ""
            yield level, f"The estimated error of {what} is {value:.2g} of {share} ({limits}).{advice}"
    if math.isnan(accuracy.peak):
        yield "doubtful", f"The error of {accuracy.peak_of} is unknown: its values in comparison runs do not converge."
    elif level := KNOWN_REACTION.level(accuracy.peak):
        share = f"{accuracy.peak:.2g} of this force ({KNOWN_REACTION})"
        yield level, f"The estimated error of {accuracy.peak_of} is {share}."
