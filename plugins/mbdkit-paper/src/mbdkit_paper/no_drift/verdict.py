"""Verdict on the packaged study `no-drift`: whether misalignment stays at round-off level over many steps."""

from __future__ import annotations

import math
from collections.abc import Sequence

from mbdkit_paper.drift.combination import COMBINATION, state_of, two
from mbdkit_paper.wording import Words, reported
from mbdkit_report import Answer, Cell, Claim, Verdict, exceeds
from mbdkit_studies import Study, StudyPoint, value
from mbdkit_studies.results.judge import study_verdict

#: Bound on misalignment [1] and on velocity misalignment [1/s], both relative to the size of the mechanism.
HELD = 1e-12
#: Columns of the largest misalignment of positions [m] and of velocities [m/s].
POSITION, VELOCITY = "misalignment_max", "velocity_misalignment_every_step"

WORDS = Words(__file__)


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
    rows = [_row(point) for point in study.points]
    own = [point for point in study.points if _method(point) not in study.spec.added]
    claims = reported(
        (
            _holds(own, "positions", POSITION, "misalignment over all steps"),
            _holds(own, "velocities", VELOCITY, "velocity misalignment per second over all steps"),
        )
    )
    return WORDS.verdict("no-drift", study.spec.title, claims, (WORDS.table("no-drift", rows),))


def _method(point: StudyPoint) -> str:
    return str(point.axes[COMBINATION])


def _relative(point: StudyPoint, column: str) -> float:
    """Return a misalignment relative to the size of the mechanism; nan if the run is not complete."""
    size = value(point, "mechanism_size")
    return value(point, column) / size if size > 0 else math.nan


def _row(point: StudyPoint) -> tuple[Cell, ...]:
    if state := state_of([point]):
        return (point.family, _method(point), *[state] * 5)
    steps, projections = (int(value(point, column)) for column in ("steps", "projections"))
    position, velocity = (two(_relative(point, column)) for column in (POSITION, VELOCITY))
    return point.family, _method(point), steps, position, velocity, two(value(point, "wall_s")), projections


def _holds(points: Sequence[StudyPoint], name: str, column: str, what: str) -> Claim:
    """Return the claim that all values lie below the bound: no if any value does not, open if any is unknown."""
    values = [(_relative(point, column), f"{point.family}, {_method(point)}") for point in points]
    answers = [exceeds(HELD, each) for each, _ in values]
    worst = max(((each, run) for each, run in values if math.isfinite(each)), default=None)
    beyond = [run for (_, run), answer in zip(values, answers, strict=True) if answer is Answer.NO]
    unknown = [run for each, run in values if not math.isfinite(each)]
    answer = Answer.NO if beyond else Answer.OPEN if Answer.OPEN in answers or not answers else Answer.YES
    computed = "no run is complete" if worst is None else f"at most {worst[0]:.1e} ({worst[1]})"
    computed += f"; unknown for {'; '.join(unknown)}" if unknown else ""
    exceptions = f" Exceptions: {'; '.join(beyond)}." if beyond else ""
    held = sum(answer is Answer.YES for answer in answers)
    words = {"limit": HELD, "computed": computed, "what": what, "held": held, "count": len(answers)}
    return WORDS.claim("drift", answer, name, claim=name, exceptions=exceptions, **words)
