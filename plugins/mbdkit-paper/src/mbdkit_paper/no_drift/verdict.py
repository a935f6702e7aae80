"""Verdict on the packaged study `no-drift`: whether misalignment stays at round-off level over many steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mbdkit_paper.drift.combination import COMBINATION, state_of, two
from mbdkit_paper.wording import Words, reported
from mbdkit_report import Answer, Claim, Verdict, exceeds
from mbdkit_studies import Study, StudyPoint, value
from mbdkit_studies.results.judge import study_verdict

#: Bound on misalignment [1] and on velocity misalignment [1/s], both relative to the size of the mechanism.
HELD = 1e-12

WORDS = Words(__file__)


@dataclass(frozen=True)
class HeldJoints:
    """Misalignment of one long run.

    Attributes
    ----------
    mechanism, method
        Family of the study, and label on the axis `method`.
    position, velocity
        Largest misalignments relative to the size of the mechanism [1, 1/s]; nan if the run is not complete.
    state
        Reason why the run is not complete: `failed`, `missing` or `not installed`; empty otherwise.
    """

    mechanism: str
    method: str
    position: float
    velocity: float
    state: str

    @property
    def name(self) -> str:
        """Mechanism and method in one line."""
        return f"{self.mechanism}, {self.method}"


@study_verdict
def verdict(study: Study) -> Verdict:
    """Return the verdict on the packaged study `no-drift`.

    Parameters
    ----------
    study
        A study of long runs with the axis `method` and one family for each mechanism.

    Raises
    ------
    LookupError
        If the study has no such axis.
    """
    results = [_held(point) for point in study.points]
    rows = [
        (
            result.mechanism,
            result.method,
            result.state or int(value(point, "steps")),
            result.state or two(result.position),
            result.state or two(result.velocity),
            result.state or two(value(point, "wall_s")),
            result.state or int(value(point, "projections")),
        )
        for result, point in zip(results, study.points, strict=True)
    ]
    own = [result for result in results if result.method not in study.spec.added]
    positions, velocities = ([getattr(result, name) for result in own] for name in ("position", "velocity"))
    claims = reported(
        (
            _holds(own, "positions", positions, "misalignment over all steps"),
            _holds(own, "velocities", velocities, "velocity misalignment per second over all steps"),
        )
    )
    return WORDS.verdict("no-drift", study.spec.title, claims, (WORDS.table("no-drift", rows),))


def _held(point: StudyPoint) -> HeldJoints:
    size = value(point, "mechanism_size")
    position, velocity = value(point, "misalignment_max"), value(point, "velocity_misalignment_every_step")
    return HeldJoints(
        point.family,
        str(point.axes[COMBINATION]),
        position / size if size > 0 else math.nan,
        velocity / size if size > 0 else math.nan,
        state_of([point]),
    )


def _holds(results: Sequence[HeldJoints], name: str, values: Sequence[float], what: str) -> Claim:
    """Return the claim that all values lie below the bound: no if any value does not, open if any is unknown."""
    answers = [exceeds(HELD, each) for each in values]
    worst = max(
        ((each, result.name) for each, result in zip(values, results, strict=True) if math.isfinite(each)), default=None
    )
    beyond = [result.name for result, answer in zip(results, answers, strict=True) if answer is Answer.NO]
    unknown = [result.name for result, each in zip(results, values, strict=True) if not math.isfinite(each)]
    answer = Answer.NO if beyond else Answer.OPEN if Answer.OPEN in answers or not answers else Answer.YES
    computed = "no run is complete" if worst is None else f"at most {worst[0]:.1e} ({worst[1]})"
    computed += f"; unknown for {'; '.join(unknown)}" if unknown else ""
    exceptions = f" Exceptions: {'; '.join(beyond)}." if beyond else ""
    held = sum(answer is Answer.YES for answer in answers)
    words = {"limit": HELD, "computed": computed, "what": what, "held": held, "count": len(answers)}
    return WORDS.claim("drift", answer, name, claim=name, exceptions=exceptions, **words)
