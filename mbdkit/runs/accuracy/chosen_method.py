"""Chooses method and step for a requested accuracy, from pilot runs and a model of error and work.

The error of a fixed-step method of order p is modelled as C h^p, that of an adaptive method as C tol^p with p near 1. C
follows from the difference of two pilots, which are trial runs with larger steps or tolerances. The exponent p is
observed if the model is extrapolated far. Work is the number of evaluations.

Without a given integrator, DOP853 in adaptive steps is the first candidate. On smooth mechanisms no other built-in
method needs less than about two thirds of its work, over all accuracies from 1e-3 to 1e-9, while pilots of many methods
would cost more than they could save. If the steps of DOP853 hardly become shorter with a smaller tolerance, they are
limited by stability (stiff springs, dampers); Radau IIA of order 9 is then the second candidate.

All decisions use counts instead of times, so that equal specs lead to equal choices on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass, replace
from mbdkit.base.plain_data import canonical
from mbdkit.engine.workspace import Workspace
from mbdkit.methods.method_options import ControlledOptions
from mbdkit.runs.accuracy.coarser_estimate import error_share
from mbdkit.runs.accuracy.pilot_run import (
    IMPLICIT_WORK,
    SAMPLES,
    RecordedPilot,
    SampledPilot,
    can_be_recorded,
    difference,
)
from mbdkit.runs.accuracy.position_measure import PositionMeasure
from mbdkit.runs.run_seams import Progress
from mbdkit.spec import RunSpec
from mbdkit.spec.run_spec import FIRST_EXPLICIT, FIRST_IMPLICIT

#: Target of the expected error, as a share of the requested accuracy.
#:
#: At order 8, the target costs 15 % more work than the requested accuracy itself. Errors of smooth motions follow the
#: tolerance within this factor.
MARGIN = 0.3

#: Differences above this share of the mechanism's size are too large to predict errors of smaller steps.
#:
#: Differences a little below it are larger than the model expects, so that the choice is conservative.
SATURATED = 0.2

#: Expected exponent p of the error of an adaptive method in its tolerance.
#:
#: It is below 1, because predictions often span several decades, and a missed accuracy costs another run.
FOLLOWS = 0.93

#: Range of the tolerance: rounding errors dominate below it, and errors are not proportional to it above.
TIGHTEST, LOOSEST = 1e-13, 1e-3

#: Reason why no smaller tolerance is possible.
ROUNDING = f"rounding errors dominate at tolerances below {TIGHTEST:g}"

#: Fixed-step method that is tried if rounding errors limit adaptive methods.
GAUSS: Mapping[str, Any] = {"name": "gauss", "stages": 6}

TENTH = 10.0  #: Factor between the tolerances of the first two pilots.

#: Stability limits the steps of DOP853 if their number grows by less than this factor when the tolerance is divided by
#: ten. If accuracy limits the steps, their number grows by 10^(1/8) = 1.33.
STIFF = 1.15

#: Largest number of steps of the first pilots of a candidate; explicit pilots of stiff mechanisms exceed it.
FIRST_STEPS = 20_000

#: Smallest work of a step of Radau IIA with 5 stages, with at least four iterations: 20 evaluations.
IMPLICIT_STEP = 20.0 * IMPLICIT_WORK

MANY_STEPS = 2_000  #: A limit by stability is accepted for up to this many steps, because they take only 0.1 s.

#: Factor between the tolerances of the first two recorded pilots.
#:
#: Errors of single runs scatter about the tolerance by a factor of up to 10, so that runs with closer tolerances may
#: differ by less than their errors. A factor of 10 would cost 15 % more.
APART = 100.0

#: Target of the estimated error of a recorded pilot, as a share of the requested accuracy; if it is missed, another
#: pilot is needed.
AIM = 0.25

MOST_ATTEMPTS = 3  #: Largest number of runs of the chosen method if checks do not confirm the accuracy.

#: Largest ratio of errors over which the model is extrapolated from the last pilot.
#:
#: The keys are True for adaptive methods and False for fixed steps. The ratio is smaller for fixed steps, because their
#: observed order may be below that of the method.
FAR = {True: 1e5, False: 30.0}


@dataclass(frozen=True)
class Candidate:
    """A method whose step or tolerance is to be chosen.

    `integrator`: name and options. `adaptive`: whether the setting to be chosen is a tolerance; otherwise it is the
    step [s]. `order`: expected exponent p of the error, which is proportional to setting^p.
    """

    integrator: Mapping[str, Any]
    adaptive: bool
    order: float

    @classmethod
    def of(cls, spec: RunSpec) -> Candidate:
        """Return the integrator of a spec as the candidate."""
        claims = spec.claims
        return cls(
            canonical(spec.integrator), claims.adaptive, FOLLOWS if claims.adaptive else float(claims.order or 2)
        )

    def applied_to(self, spec: RunSpec, setting: float, size: float) -> RunSpec:
        """Return the spec with this method and a setting.

        For small mechanisms, the absolute tolerance is a share of their `size` [m].
        """
        # the default of atol follows rtol and the size of the mechanism
        has_default = isinstance(spec.integrator, ControlledOptions)
        if not self.adaptive:
            return spec.with_choice(dict(self.integrator), setting)
        tolerances = {"rtol": setting, "atol": None if has_default else _rounded(setting * min(1.0, size))}
        return spec.with_choice({**self.integrator, **tolerances}, spec.time.step if spec.choose == "step" else None)

    def name(self, setting: float) -> str:
        """Return name and setting, such as ``dop853 in adaptive steps with tolerance 1e-08``."""
        stages = self.integrator.get("stages")
        options = "" if stages is None else f" stages {stages}"
        how = f"in adaptive steps with tolerance {setting:g}" if self.adaptive else f"with step {setting:g} s"
        return f"{self.integrator['name']}{options} {how}"


@dataclass(frozen=True)
class Choice:
    """The choice of method and tolerance or step.

    - `candidate`, `setting`: the method, and its tolerance or step [s].
    - `size`: size of the mechanism [m].
    - `why`: reason, as sentences.
    - `work`: work of all pilots, in evaluations.
    - `limited`: reason why no smaller setting is possible; empty if one is possible.
    - `pilots`: the last pilots of the same method, from which the errors of the run are estimated. If there are none,
      companions are used.
    - `final`: the recorded pilot that is accurate enough to serve as the run; None if there is none.
    """

    candidate: Candidate
    setting: float
    size: float
    why: str
    work: float
    limited: str = ""
    pilots: tuple[RecordedPilot, ...] = ()
    final: RecordedPilot | None = None

    @property
    def chosen(self) -> str:
        """Method and setting, as the start of a sentence."""
        return self.candidate.name(self.setting)

    def applied_to(self, spec: RunSpec) -> RunSpec:
        """Return the spec with the chosen method and setting."""
        return self.candidate.applied_to(spec, self.setting, self.size)

    def tightened(self, spec: RunSpec, asked: float, reached: float) -> Choice:
        """Return the choice for the next attempt, with a smaller setting.

        `asked`, `reached`: requested accuracy, and the accuracy estimated by the check, which is nan if it is not known
        to the end.
        """
        order, least = self.candidate.order, 3.0 if self.candidate.adaptive else 1.5
        # A recorded pilot also serves to check the next attempt; later attempts are checked by companions.
        pilots = () if self.final is None else (*self.pilots[-1:], self.final)
        factor = TENTH if pilots else 100.0 if self.candidate.adaptive else 4.0
        if math.isfinite(reached):
            factor = max(least, elementary.pow(reached / (MARGIN * asked), 1 / order))
        setting, limited = _limited(spec, self.candidate, self.setting / factor)
        reason = f"an error of {reached:.2g}" if math.isfinite(reached) else "no error that is known to the end"
        why = f"{self.why} The check of {self.chosen} found {reason}, so that it was tightened."
        return replace(self, setting=min(setting, self.setting), limited=limited, why=why, pilots=pilots, final=None)


def choose_method(spec: RunSpec, workspace: Workspace, progress: Progress | None = None) -> Choice:
    """Choose method and step for the accuracy of a spec.

    `spec`: the spec, with `RunSpec.is_to_be_chosen`. `workspace`: its mechanism and start. `progress`: called with
    (time reached, end time) [s] of each pilot.
    """
    if spec.settings():
        message = "`accuracy` is not available for runs in which events set states; give an integrator and a step"
        raise spec.placed(SpecError(message, key="accuracy"))
    first = Candidate.of(spec)
    search = _Search(spec, workspace, PositionMeasure.of(spec, workspace), progress)
    recordable = first.adaptive and not spec.events and not workspace.mechanism.states
    recordable = recordable and can_be_recorded(first.applied_to(spec, LOOSEST, search.measure.size))
    if recordable and (choice := search.ladder(first)) is not None:
        return choice
    if spec.choose == "step" or first.integrator["name"] != FIRST_EXPLICIT["name"]:
        return search.of(first)
    return search.better(first, replace(first, integrator=dict(FIRST_IMPLICIT)))


def other_method(spec: RunSpec, workspace: Workspace, choice: Choice) -> Choice | None:
    """Return the choice of Gauss's method with fixed steps if rounding errors have limited the tolerance of another
    method.

    None if the spec gives the method, or if rounding errors are not the limit. Fixed steps of high order are far fewer
    than adaptive steps at the tightest tolerance, and accumulate fewer rounding errors.
    """
    if spec.choose != "method" or choice.limited != ROUNDING or choice.candidate.integrator["name"] == GAUSS["name"]:
        return None
    search = _Search(spec, workspace, PositionMeasure.of(spec, workspace), None)
    text = f"Rounding errors limit {choice.candidate.integrator['name']}. "
    return search.of(Candidate(GAUSS, False, 2.0 * GAUSS["stages"]), told=text)


class _Search:
    def __init__(self, spec: RunSpec, workspace: Workspace, measure: PositionMeasure, progress: Progress | None):
        self.spec, self.workspace, self.measure, self.progress = spec, workspace, measure, progress
        assert spec.accuracy is not None
        self.asked = spec.accuracy
        self.work = 0.0

    def pilot(self, candidate: Candidate, setting: float, most_steps: int | None = None) -> SampledPilot:
        """Run a pilot."""
        spec = candidate.applied_to(self.spec, setting, self.measure.size)
        pilot = SampledPilot(spec, setting, self.workspace, most_steps or self.spec.limits.max_steps)
        self.work += pilot.work
        return pilot

    def ladder(self, candidate: Candidate) -> Choice | None:
        """Choose a tolerance by recorded pilots with decreasing tolerances, until one is accurate enough.

        The last pilot serves as the run, and its error is estimated from the previous ones. Returns None if stability
        limits the steps, or if they are too many to be recorded.
        """
        runs: list[RecordedPilot] = []
        setting = min(max(_rounded(self.asked), APART * TIGHTEST), LOOSEST)
        while True:
            spec = candidate.applied_to(self.spec, setting, self.measure.size)
            run = RecordedPilot(spec, setting, self.workspace, FIRST_STEPS, self.progress)
            if run.stepper is None:
                return None
            self.work += run.work
            if run.failure == "max-steps" or (run.failure and setting <= TIGHTEST):
                return None
            runs = [run] if run.failure else [*runs, run]
            if len(runs) < 2:
                setting = _setting(candidate, setting / APART)
                continue
            compared = runs[-3:]
            differences = [self.difference(other, run) for other in compared[:-1]]
            if not differences[0] <= SATURATED and len(compared) > 2:
                compared, differences = compared[1:], differences[1:]
            if self.is_stiff(compared):
                return None
            error = error_share(differences, [other.setting for other in compared])
            limited = ROUNDING if setting <= TIGHTEST else ""
            if error <= self.asked or limited:
                size, why = self.measure.size, self.why_last(compared, differences, error)
                return Choice(candidate, setting, size, why, self.work, limited, tuple(compared[:-1]), run)
            setting = _setting(candidate, self.next_tolerance(compared, differences, error))

    def difference(self, other: RecordedPilot, run: RecordedPilot) -> float:
        """Return the largest difference between two recorded pilots as a share of the size, at the step ends of `run`;
        inf if a pilot did not reach all of them.
        """
        share = self.measure.share(other.positions(run.time) - run.positions(run.time))
        return float(np.nan_to_num(np.max(share), nan=math.inf))

    def is_stiff(self, runs: list[RecordedPilot]) -> bool:
        """Return whether stability limits the steps of the last pilot run: there are many, and hardly more than with
        the larger tolerance of the run before.
        """
        return runs[-1].steps > MANY_STEPS and runs[-1].steps <= STIFF * runs[-2].steps

    def next_tolerance(self, runs: list[RecordedPilot], differences: list[float], error: float) -> float:
        """Return the tolerance of the next recorded pilot."""
        if not differences[-1] <= SATURATED:
            return runs[-1].setting / APART
        if len(differences) == 1:  # the difference is the error of the coarser run
            wanted = runs[-2].setting * elementary.pow(AIM * self.asked / differences[-1], 1 / FOLLOWS)
        else:
            wanted = runs[-1].setting * elementary.pow(AIM * self.asked / error, 1 / FOLLOWS)
        return float(min(wanted, runs[-1].setting / 4))  # runs with closer tolerances would hardly differ

    def why_last(self, runs: list[RecordedPilot], differences: list[float], error: float) -> str:
        """Return the sentence on the last of the recorded pilots."""
        size = f"of the mechanism's size of {self.measure.size:.3g} m"
        return (
            f"Pilot runs with tolerances {runs[-2].setting:.3g} and {runs[-1].setting:.3g} differ by "
            f"{differences[-1]:.2g} {size}; the estimated error of the last one is {error:.2g}."
        )

    def better(self, explicit: Candidate, implicit: Candidate) -> Choice:
        """Return the better of two choices.

        This is the explicit method, unless stability limits its steps and the implicit method needs less work.
        """
        pilots = self.two(explicit, FIRST_STEPS)
        if pilots[-1].failure != "max-steps" and pilots[-1].steps > STIFF * pilots[0].steps:
            return self.of(explicit, pilots)
        # The implicit pilot stops at half the work of the explicit one; a smaller gain is not worth another pilot.
        budget = max(8, int(pilots[-1].work / (2 * IMPLICIT_STEP)))
        other = self.pilot(implicit, pilots[-1].setting, budget)
        name, rival = explicit.integrator["name"], implicit.integrator["name"]
        if other.failure or other.work >= pilots[-1].work:
            text = f"Stability limits the steps of {name}, but {rival} would cost more. "
            return self.of(explicit, None if pilots[-1].failure == "max-steps" else pilots, text)
        costs = f"a pilot run costs {other.work:.3g} evaluations instead of {pilots[-1].work:.3g}"
        more = " or more" if pilots[-1].failure == "max-steps" else ""
        return self.of(implicit, None, f"Stability limits the steps of {name}; with {rival}, {costs}{more}. ")

    def two(self, candidate: Candidate, most_steps: int | None = None) -> list[SampledPilot]:
        """Return the first two pilots of a candidate."""
        coarse, factor = self.first(candidate)
        runs = [self.pilot(candidate, coarse, most_steps)]
        return [*runs, self.pilot(candidate, _setting(candidate, coarse / factor), most_steps)]

    def first(self, candidate: Candidate) -> tuple[float, float]:
        """Return the tolerance or step [s] of the first pilot run, and the divisor that gives that of the second."""
        spec = self.spec
        if candidate.adaptive:
            rtol = candidate.integrator.get("rtol") if spec.choose == "step" else None
            # Pilots have larger tolerances than the run, so that they cost less: the tolerance decreases by one decade
            # if the requested accuracy decreases by three.
            loose = LOOSEST * elementary.pow(self.asked / LOOSEST, 1 / 3)
            return min(max(_rounded(float(rtol or loose)), TENTH * TIGHTEST), LOOSEST), TENTH
        span = spec.time.final - spec.time.start
        steps = span / spec.time.step if spec.time.step is not None else 2 * SAMPLES
        return span / _dividing(steps), 2.0

    def of(self, candidate: Candidate, runs: list[SampledPilot] | None = None, told: str = "") -> Choice:
        """Return the choice of a candidate with a setting predicted from pilots.

        `runs` are the first two pilots; by default, they are run here. `told` is put before the reason for the choice.
        """
        runs = runs or self.two(candidate)
        _, factor = self.first(candidate)
        differences = [difference(runs[0], runs[1], self.measure)]
        while not differences[-1] <= SATURATED:  # too coarse for a prediction
            setting = _setting(candidate, runs[-1].setting / (factor if candidate.adaptive else 2 * factor))
            if setting >= runs[-1].setting or _limited(self.spec, candidate, setting)[1]:
                break
            runs.append(self.pilot(candidate, setting))
            differences.append(difference(runs[-2], runs[-1], self.measure))
        order = candidate.order
        setting = self.predicted(candidate, runs[-2].setting, differences[-1], order)
        far = elementary.pow(FAR[candidate.adaptive], 1 / order)
        if differences[-1] <= SATURATED and setting < runs[-1].setting / far:
            between = _setting(candidate, math.sqrt(runs[-1].setting * setting))
            if not candidate.adaptive:
                span = self.spec.time.final - self.spec.time.start
                between = span / _dividing(span / between)
            runs.append(self.pilot(candidate, between))
            differences.append(difference(runs[-2], runs[-1], self.measure))
            order = self.observed(candidate, runs, differences)
            setting = self.predicted(candidate, runs[-2].setting, differences[-1], order)
        setting, limited = _limited(self.spec, candidate, setting)
        return Choice(
            candidate, setting, self.measure.size, told + self.why(candidate, runs, differences), self.work, limited
        )

    def predicted(self, candidate: Candidate, setting: float, error: float, order: float) -> float:
        """Return the setting for `MARGIN` times the requested accuracy, if the error at `setting` is `error`.

        It exceeds `setting` at most by a factor of 10 (tolerances) or 2 (steps).
        """
        if not error > 0:
            return setting
        factor = elementary.pow(MARGIN * self.asked / max(min(error, 1.0), 1e-15), 1 / order)
        return setting * min(factor, TENTH if candidate.adaptive else 2.0)

    def observed(self, candidate: Candidate, runs: list[SampledPilot], differences: list[float]) -> float:
        """Return the order observed in the last three pilots, limited to 0.6 to 1.2 times the expected order."""
        (e0, e1), (x0, x1) = differences[-2:], (runs[-3].setting, runs[-2].setting)
        if not (e0 > 0 and e1 > 0 and e0 < math.inf):
            return candidate.order
        return min(max(elementary.log(e0 / e1) / elementary.log(x0 / x1), 0.6 * candidate.order), 1.2 * candidate.order)

    def why(self, candidate: Candidate, runs: list[SampledPilot], differences: list[float]) -> str:
        """Return the sentence on the last two pilots and on what they mean for the choice."""
        unit = "tolerances" if candidate.adaptive else "steps"
        end = "" if candidate.adaptive else " s"
        settings = f"{unit} {runs[-2].setting:.3g} and {runs[-1].setting:.3g}{end}"
        part = f"differ by {differences[-1]:.2g} of the mechanism's size of {self.measure.size:.3g} m"
        aim = f"aims at {MARGIN:g} of the error asked"
        if not differences[-1] <= SATURATED:
            return f"Pilot runs with {settings} {part}, too much for a prediction."
        return f"Pilot runs with {settings} {part}; the choice {aim}."


def _limited(spec: RunSpec, candidate: Candidate, setting: float) -> tuple[float, str]:
    """Return a setting rounded within its limits, and the reason why it cannot be smaller; empty if it can."""
    if candidate.adaptive:
        if setting <= TIGHTEST:
            return TIGHTEST, ROUNDING
        return min(_rounded(setting), LOOSEST), ""
    span = spec.time.final - spec.time.start
    most = spec.limits.max_steps
    if span / setting > most:
        return _shorter(span / most, up=True), f"limits.max_steps allows {most} steps"
    return min(_shorter(setting), span), ""


def _setting(candidate: Candidate, setting: float) -> float:
    """Return the tolerance of a pilot run, rounded and at least `TIGHTEST`, or its fixed step, unchanged."""
    return max(_rounded(setting), TIGHTEST) if candidate.adaptive else setting


def _rounded(value: float) -> float:
    return float(f"{value:.1e}")


def _shorter(step: float, *, up: bool = False) -> float:
    unit = 10.0 ** (math.floor(elementary.log10(step)) - 2)
    return float(f"{(math.ceil if up else math.floor)(step / unit * (1 + 1e-12)) * unit:.2e}")


def _dividing(steps: float) -> int:
    """Return a number of steps that is at least `steps`, and a multiple or a divisor of the number of samples."""
    if steps >= SAMPLES:
        return SAMPLES * math.ceil(steps / SAMPLES - 1e-9)
    return 1 << max(3, math.ceil(elementary.log2(steps)))
