"""Verdict on the packaged study `contact`: error, work, penetration and creep of the three treatments of contacts.

Errors are the largest differences of positions from closed forms at the recorded times.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit.archive.run import Run
from mbdkit_contact.modes import STICK
from mbdkit_paper.drift.combination import COMBINATION, state_of, two
from mbdkit_paper.wording import Words, reported
from mbdkit_report import Answer, Claim, Figure, Line, Verdict, exceeds, together
from mbdkit_studies import STEP, Study, StudyPoint, family, value
from mbdkit_studies.results.judge import study_verdict

G = 9.81
#: Errors of event-driven runs, and penetration [m] and creep [m/s] of rigid bodies, count as zero below this.
EXACT = 1e-9
PER_STEP = 3.0  #: Largest accepted error of time-stepping, divided by the step [m/s].
SOFT = "-compliant"
FINEST = "event-driven, DOP853"
WORDS = Words(__file__)


def ball(t: np.ndarray) -> np.ndarray:
    """Return the height of the ball's center, which falls by 1 m and keeps half of its speed in each impact."""
    fall = math.sqrt(2.0 / G)
    height, begin, speed = 1.0 - 0.5 * G * t**2, fall, 0.5 * G * fall
    for _ in range(60):
        after = t - begin
        height = np.where(after > 0.0, speed * after - 0.5 * G * after**2, height)
        begin, speed = begin + 2.0 * speed / G, 0.5 * speed
    return 0.1 + np.where(t > begin, 0.0, height)


def _block(friction: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return the distance [m] of a block along an incline of 30 degrees, as a function of time; it starts uphill with 2
    m/s.
    """
    pull, hold = 0.5 * G, friction * math.cos(math.radians(30.0)) * G
    stop = 2.0 / (pull + hold)

    def way(t: np.ndarray) -> np.ndarray:
        up = 2.0 * t - 0.5 * (pull + hold) * t**2
        return np.where(t < stop, up, stop - 0.5 * max(pull - hold, 0.0) * (t - stop) ** 2)

    return way


def belt(t: np.ndarray) -> np.ndarray:
    """Return the position of the block on the belt over its first 5 + 3.9026 + 5 s: it sticks, slips and sticks."""
    slips = 5.0 + 3.902605407814523
    slip = 0.5 + 0.5 * np.cos(t - 5.0) + 0.2 * np.sin(t - 5.0)
    return np.where(t < 5.0, 0.2 * t, np.where(t < slips, slip, 0.2 * (t - slips)))


def _along(run: Run) -> np.ndarray:
    return run["block"].position @ [math.cos(math.radians(30.0)), 0.5]


#: Coordinate of a run to be compared, and its closed form, for each case.
CLOSED: dict[str, tuple[Callable[[Run], np.ndarray], Callable[[np.ndarray], np.ndarray]]] = {
    "ball": (lambda run: run["ball"].position[:, 1], ball),
    "incline": (_along, _block(0.3)),
    "hold": (_along, _block(0.7)),
    "belt": (lambda run: run["block"].position[:, 0], belt),
}
FRICTION = ("incline", "hold", "belt")  #: Cases in which contacts have friction and no restitution.
#: Share of its energy that the rocking block retains in an impact: (1 - 1.5 sin^2 alpha)^2. Here, sin^2 alpha = 1/17
#: with the angle alpha between the diagonal and the vertical side of the block (G. W. Housner, 1963).
HOUSNER = (1.0 - 1.5 / 17.0) ** 2


@dataclass(frozen=True)
class Touched:
    """One run of the study.

    Attributes
    ----------
    step
        Step [s]; 0 for compliant runs, whose steps are adaptive.
    error
        Largest error of the position [m]; in the case `rocking`, error of the share of energy that the impact keeps.
    penetration, creep
        Deepest overlap [m], and largest slip while a contact sticks [m/s].
    steps, seconds
        Number of steps, and processor time [s].
    state
        Reason why the run is not complete; empty otherwise.
    """

    case: str
    method: str
    step: float
    error: float
    penetration: float
    creep: float
    steps: float
    seconds: float
    state: str

    @property
    def name(self) -> str:
        """Case, method and step in one line."""
        return f"{self.case}, {self.method}" + (f", {self.step:g} s" if self.step else "")


@study_verdict
def verdict(study: Study) -> Verdict:
    """Return the verdict on the packaged study `contact`."""
    touches = [_of(study, point) for point in study.points if point.family != "painleve"]
    own = [touch for touch in touches if touch.method not in study.spec.added]
    claims = reported((_exact(own), _first_order(own), _closed(own), _softer(own), _painleve(study)))
    rows = [
        (
            touch.case, touch.method, touch.step or "adaptive", touch.state or two(touch.error),
            touch.state or two(touch.penetration), touch.state or two(touch.creep), touch.state or int(touch.steps),
            touch.state or two(touch.seconds),
        )
        for touch in touches
    ]  # fmt: skip
    return WORDS.verdict("contact", study.spec.title, claims, (WORDS.table("contact", rows),), _figure(touches))


def _of(study: Study, point: StudyPoint) -> Touched:
    case = point.family.removesuffix(SOFT)
    step = 0.0 if point.family.endswith(SOFT) else float(point.axes[STEP])
    error = penetration = creep = math.nan
    run = study.run(point) if point.status == "complete" else None
    if run is not None:
        with run:
            error, (penetration, creep) = _error(run, case), _overlap(run)
    steps, seconds = value(point, "steps"), value(point, "wall_s")
    return Touched(
        case, str(point.axes[COMBINATION]), step, error, penetration, creep, steps, seconds, state_of([point])
    )


def _error(run: Run, case: str) -> float:
    if case in CLOSED:
        coordinate, closed = CLOSED[case]
        return float(np.max(np.abs(coordinate(run) - closed(run.time))))
    above = np.asarray(run.energy.total) - 0.4 * G  # energy above that of the block at rest; there is one impact
    return abs(float(above[-1] / above[0]) - HOUSNER)


def _overlap(run: Run) -> tuple[float, float]:
    every = [run.contacts[name] for name in run.contacts]
    depth = max(max(0.0, -float(np.min(touch.gap))) for touch in every)
    return depth, max(float(np.max(np.abs(touch.slip[touch.mode == STICK]), initial=0.0)) for touch in every)


def _worst(touches: Sequence[Touched], of: Callable[[Touched], float]) -> tuple[float, str]:
    values = [of(touch) for touch in touches]
    if not values or not all(math.isfinite(each) for each in values):
        return math.nan, "a run that is not complete"
    index = int(np.argmax(values))
    return values[index], touches[index].name


def _exact(touches: Sequence[Touched]) -> Claim:
    own = [touch for touch in touches if touch.method == FINEST]
    worst, name = _worst(own, lambda touch: touch.error)
    step = max((touch.step for touch in own), default=math.nan)
    return WORDS.claim("exact", exceeds(EXACT, worst), limit=EXACT, worst=worst, run=name, finest=FINEST, step=step)


def _first_order(touches: Sequence[Touched]) -> Claim:
    own = [touch for touch in touches if touch.method == "time-stepping" and touch.case in CLOSED]
    worst, name = _worst(own, lambda touch: touch.error / touch.step)
    return WORDS.claim("first-order", exceeds(PER_STEP, worst), limit=PER_STEP, worst=worst, run=name)


def _closed(touches: Sequence[Touched]) -> Claim:
    rigid = [touch for touch in touches if touch.step]
    overlap, name = _worst(rigid, lambda touch: touch.penetration)
    creep, creeping = _worst([touch for touch in rigid if touch.method == FINEST], lambda touch: touch.creep)
    values = {"limit": EXACT, "overlap": overlap, "creep": creep, "count": len(rigid)}
    return WORDS.claim("closed", exceeds(EXACT, max(overlap, creep)), run=name, creeping=creeping, **values)


def _softer(touches: Sequence[Touched]) -> Claim:
    """Return the claim that the stiffest compliant runs with friction have less overlap and error than the softest."""
    answers, told_cases = [], []
    for case in FRICTION:
        own = [touch for touch in touches if touch.case == case and not touch.step]
        if not own:
            return Claim("softer", "", "", "", Answer.OPEN, "")
        soft, stiff = own[0], own[-1]
        answers += [exceeds(soft.penetration, stiff.penetration), exceeds(soft.error, stiff.error)]
        told_cases.append(
            f"{case}: error {soft.error:.1e} to {stiff.error:.1e} m, overlap {soft.penetration:.1e} to "
            f"{stiff.penetration:.1e} m, creep {soft.creep:.1e} to {stiff.creep:.1e} m/s, in {stiff.steps:.0f} steps"
        )
    return WORDS.claim("softer", together(answers), cases="; ".join(told_cases))


def _painleve(study: Study) -> Claim:
    points = sorted(family(study, "painleve"), key=lambda point: float(next(iter(point.axes.values()))))
    runs = {float(next(iter(point.axes.values()))): point.status for point in points}
    wrong = [mu for mu, status in runs.items() if status != ("complete" if mu < 4.0 / 3.0 else "failed")]
    missing = not runs or any(status not in ("complete", "failed") for status in runs.values())
    passed = max((mu for mu, status in runs.items() if status == "complete"), default=math.nan)
    return WORDS.claim("painleve", Answer.OPEN if missing else Answer.NO if wrong else Answer.YES, passed=passed)


def _figure(touches: Sequence[Touched]) -> Figure:
    lines = []
    for case in CLOSED:
        own = [touch for touch in touches if touch.case == case and touch.method == "time-stepping" and not touch.state]
        if own:
            lines.append(Line(case, np.array([touch.step for touch in own]), np.array([touch.error for touch in own])))
    return WORDS.figure("steps", lines)
