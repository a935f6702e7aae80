"""Certification of the result of a design: errors of its goals, compared with the gain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mbdkit.engine.linear_systems import product
from mbdkit.spec.run_spec import RunSpec
from mbdkit_biomech.inverse_dynamics.results.measure_samples import SampledMeasures
from mbdkit_biomech.inverse_dynamics.signals.chi_square import LEVEL
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
from mbdkit_design.evaluation import Evaluator, Job, Outcome, Settings
from mbdkit_design.known_points import Stored
from mbdkit_report import with_unit

WORST = ("failed", "bad", "doubtful", "unknown", "good")  #: Verdicts from the worst to the best.
QUESTIONED = WORST[:3]  #: Verdicts on runs that question the result of a design.


@dataclass(frozen=True)
class Trust:
    """Certification of a design.

    Attributes
    ----------
    errors
        Estimated error of each goal and limit at the best point, by name; nan if unknown. These are the errors of the
        measures in the runs at this point (`Run.measure_errors`) or, in inverse dynamics, bounds of the errors due to
        noise, cutoff and deviations of muscle properties.
    gain
        Decrease of each goal from the start to the best point, by name.
    is_gain
        Whether the gain of each goal exceeds the error of the gain, by name; None if this error is unknown.
    verdict
        Worst verdict on the runs at the best point, whose errors are estimated (``check: true``).
    reason
        Reason for this verdict if it is failed, bad or doubtful; empty otherwise.
    failures
        Sentences that say why errors of runs are unknown: the first reason at the start, and the first at the best
        point.
    gain_errors
        Error of each gain by name: the sum of the errors of both points or, in inverse dynamics, the bound of the error
        of the difference, because both points use the same data with the same noise; nan where it is unknown.
    is_of_data
        Whether errors are those of inverse dynamics, due to noise, cutoff and deviations of muscle properties.
    start_verdict, start_reason
        As `verdict` and `reason`, for the runs at the start.
    """

    errors: dict[str, Stored]
    gain: dict[str, Stored]
    is_gain: dict[str, bool | None]
    verdict: str
    reason: str = ""
    failures: tuple[str, ...] = ()
    gain_errors: dict[str, Stored] = field(default_factory=dict)
    is_of_data: bool = False
    start_verdict: str = "good"
    start_reason: str = ""

    @property
    def level(self) -> str:
        """The worse of the verdicts on the runs at the best point and at the start."""
        return min(self.verdict, self.start_verdict, key=WORST.index)

    @property
    def judgement(self) -> str:
        """Sentence with the verdict on the runs, and with its reason for the best point, and for the start if the
        verdict there is worse, unless both are good or unknown.
        """
        points = [("best point", self.verdict, self.reason)]
        if self.level != self.verdict:
            points.append(("start", self.start_verdict, self.start_reason))
        texts = [f"{level} at the {point}: {why.rstrip('.')}" for point, level, why in points if level in QUESTIONED]
        if texts:
            return f"Verdict on the runs: {'; '.join(texts)}."
        others = "those due to the data" if self.is_of_data else "not all known"
        errors = "estimated" if self.level == "good" else others
        return f"Verdict on the runs: {self.level}, nothing suspicious seen; errors are {errors}."

    def sentences(self, units: Mapping[str, str]) -> list[str]:
        """Return remarks for the user: goals without a gain or with unknown error, and reasons for unknown errors.

        Parameters
        ----------
        units
            Units of the goals by name.
        """
        told = []
        for name, real in self.is_gain.items():
            gain = f"The gain of {name}, {with_unit(self.gain[name], units[name], 3)},"
            if real is None:
                told.append(f"{gain} may be due to errors of the runs, which were not estimated.")
            elif not real and self.gain[name] < 0:
                grown = with_unit(-self.gain[name], units[name], 3)
                told.append(f"There is no gain of {name}, which grows by {grown}.")
            elif not real:
                told.append(f"{gain} is within the estimated errors: it does not count as a gain.")
            elif self.is_of_data:
                error = with_unit(self.gain_errors[name], units[name], 2)
                told.append(
                    f"{gain} has an error of at most {error} with a probability of {LEVEL:.0%}, "
                    "due to the noise of the data, the cutoff, and the deviations of muscles if they are given."
                )
        unknown = [name for name, error in self.errors.items() if np.isnan(error) and name not in self.is_gain]
        if unknown:
            told.append(f"There is no estimate of the error of {', '.join(unknown)}.")
        return [*told, *self.failures]


def certified(evaluator: Evaluator, start: np.ndarray, best: np.ndarray) -> Trust:
    """Certify the best point (n,) by runs with error estimates, at this point and at the start."""
    goals, count = evaluator.spec.totals, len(evaluator.spec.totals)
    checked_at_start, checked = (_checked(evaluator, x) for x in (start, best))
    sampled_at_start, sampled = (_sampled(evaluator, x) for x in (start, best))
    if sampled_at_start is None or sampled is None:
        errors_at_start, failures_at_start = _errors(evaluator, start, checked_at_start, "start")
        errors, failures = _errors(evaluator, best, checked, "best point")
        both = errors_at_start + errors
    else:
        errors, both = sampled.bounds(), sampled_at_start.minus(sampled).bounds()
        failures_at_start = failures = ()
    at_start, at_best = (evaluator.totals(x) for x in (start, best))
    gain = {name: float(at_start[k] - at_best[k]) for k, name in enumerate(goals)}
    runs = (checked_at_start, checked)
    worst_at_start, worst = (min(some, key=lambda one: WORST.index(one.verdict)) for some in runs)
    return Trust(
        errors=dict(zip([*goals, *evaluator.spec.subject_to], errors.tolist(), strict=True)),
        gain=gain,
        is_gain={name: None if np.isnan(both[k]) else bool(gain[name] > both[k]) for k, name in enumerate(goals)},
        verdict=worst.verdict,
        reason=worst.reason,
        failures=(*failures_at_start[:1], *failures[:1]),
        gain_errors=dict(zip(goals, both[:count].tolist(), strict=True)),
        is_of_data=sampled is not None,
        start_verdict=worst_at_start.verdict,
        start_reason=worst_at_start.reason,
    )


def _sampled(evaluator: Evaluator, x: np.ndarray) -> SampledMeasures | None:
    """Return goals and limits at a point (n,), with their samples.

    Goals are summed over the scenarios; the value of a limited measure is the largest one over the scenarios. The
    result is None if any scenario is not inverse dynamics or has unknown errors, or if their samples do not correspond.
    """
    results = [scenario.sampled(evaluator.settings(x)) for scenario in evaluator.scenarios]
    known = [result for result in results if result is not None]
    if len(known) < len(results) or len({tuple(map(len, one[2:])) for one in known}) > 1:
        return None
    weights, count = evaluator.root_weights**2, len(evaluator.spec.goals)

    def summed(arrays: list[np.ndarray]) -> np.ndarray:
        table = np.stack(arrays, axis=-1)  # (..., K, S)
        of_goals = table[..., :count, :]
        if evaluator.spec.sums_squares:
            of_goals = np.sum(of_goals**2, axis=-2, keepdims=True)
        return np.concatenate([product(of_goals, weights), np.max(table[..., count:, :], axis=-1)], axis=-1)

    return SampledMeasures(*map(summed, map(list, zip(*known, strict=True))))


def _checked(evaluator: Evaluator, x: np.ndarray) -> list[Outcome]:
    """Return the outcomes at a point (n,) of runs with error estimates."""
    settings = evaluator.settings(x)
    jobs = [Job(name, [*settings, *check_of(spec)]) for name, spec in evaluator.spec.specs.items()]
    return evaluator.run(jobs)


def check_of(spec: RunSpec | InverseSpec) -> Settings:
    """Return the changes of a spec that enable error estimates of its measures.

    There are none if the estimates are already enabled, and for inverse dynamics.
    """
    return [(("check",), True)] if spec.spec_kind.is_integrated and not spec.checks_measures else []


def _errors(
    evaluator: Evaluator, x: np.ndarray, checked: list[Outcome], point: str
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the estimated errors at a point (n,), and sentences that say why some of them are unknown.

    Errors of goals are summed over the scenarios; those of limits are the largest over the scenarios.

    Parameters
    ----------
    checked
        Outcomes at the point of runs with error estimates.
    point
        Name of the point in messages.
    """
    unknown = []
    for scenario, one in zip(evaluator.spec.specs, checked, strict=True):
        where = f" in the scenario '{scenario}'" if scenario else ""
        names = [name for name, error in zip(evaluator.names, one.errors, strict=False) if np.isnan(error)]
        if one.verdict == "failed":
            unknown.append(f"The run at the {point} that estimates errors{where} fails: {one.reason.rstrip('.')}.")
        elif names:
            unknown.append(
                f"The errors of {', '.join(names)} at the {point}{where} are unknown: the values in runs with smaller "
                "steps or tolerances do not converge, or such a run fails."
            )
    table = np.array([outcome.errors or (np.nan,) * len(outcome.values) for outcome in checked])
    weights, count = evaluator.root_weights**2, len(evaluator.spec.goals)
    of_goals = table[:, :count]
    if evaluator.spec.sums_squares:  # the error of r^2 is (r + e)^2 - r^2
        values = np.abs(evaluator.values(x[None])[0][:, :count])
        of_goals = np.sum(of_goals * (2 * values + of_goals), axis=1, keepdims=True)
    errors = [product(of_goals.T, weights), np.max(table[:, count:], axis=0, initial=-np.inf)]
    return np.concatenate(errors), tuple(unknown)
