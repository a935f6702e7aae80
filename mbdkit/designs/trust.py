"""Certification of the result of a design: errors of its goals, compared with the gain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.base.plain_data import Path
from mbdkit.designs.evaluation import Evaluator, Job, Outcome, Settings
from mbdkit.engine.formulation import FORMULATIONS
from mbdkit.spec import InverseSpec, RunSpec

FINER = 2.0
"""Factor by which the steps of the finer run are shorter."""
TIGHTER = 100.0
"""Factor by which its tolerances are tighter, if its steps adapt."""
GAUSS, RADAU = {"name": "gauss", "stages": 3}, {"name": "radau-iia", "stages": 3}
"""The other method that a result is compared with: Gauss, or Radau IIA for runs of Gauss. In formulations other than
index-1, it is Radau IIA with other stages."""
WORST = ("failed", "bad", "doubtful", "unknown", "good")
"""Verdicts from the worst to the best."""


@dataclass(frozen=True)
class Trust:
    """Certification of a design.

    Attributes
    ----------
    errors
        Estimated error of each goal and limit at the best point, by name: the largest difference from a run with
        shorter steps or tighter tolerances, and from one of another method; nan for inverse dynamics, which has no
        steps, and where no such run ended.
    gain
        Decrease of each goal from the start to the best point, by name.
    is_gain
        Whether the gain of each goal exceeds the estimated errors of both points, by name; None if there is no
        estimate.
    verdict
        Worst verdict of the runs at the best point, which estimate their errors (``check: true``).
    reason
        Reason why this is doubtful or bad; empty otherwise.
    failures
        Failures of runs that were to estimate errors, the first one at the start and at the best point, as sentences.
    """

    errors: dict[str, float]
    gain: dict[str, float]
    is_gain: dict[str, bool | None]
    verdict: str
    reason: str = ""
    failures: tuple[str, ...] = ()

    def sentences(self) -> list[str]:
        """Return remarks for the user: goals without a gain or with unknown error, and a verdict below good."""
        told = []
        for name, real in self.is_gain.items():
            gain = f"The gain of {name}, {self.gain[name]:.3g},"
            if real is None:
                told.append(f"{gain} may be an error of the runs: there is no estimate of their errors.")
            elif not real and self.gain[name] < 0:
                told.append(f"There is no gain of {name}, which grows by {-self.gain[name]:.3g}.")
            elif not real:
                told.append(f"{gain} is within the estimated errors: it does not count as a gain.")
        unknown = [name for name, error in self.errors.items() if np.isnan(error) and name not in self.is_gain]
        if unknown:
            told.append(f"There is no estimate of the error of {', '.join(unknown)}.")
        told += self.failures
        if self.verdict in ("failed", "bad", "doubtful"):
            why = self.reason.rstrip(".")
            told.append(f"The worst verdict on a run at the best point is {self.verdict}: {why}.")
        return told


def certified(evaluator: Evaluator, start: np.ndarray, best: np.ndarray) -> Trust:
    """Certify the best point (n,) by runs with shorter steps and with another method."""
    goals = evaluator.spec.totals
    errors_at_start, failures_at_start = _errors(evaluator, start, "start")
    errors, failures = _errors(evaluator, best, "best point")
    at_start, at_best = (evaluator.totals(x) for x in (start, best))
    gain = {name: float(at_start[k] - at_best[k]) for k, name in enumerate(goals)}
    both = errors_at_start + errors
    worst = min(_checked(evaluator, best), key=lambda one: WORST.index(one.verdict))
    return Trust(
        errors=dict(zip([*goals, *evaluator.spec.subject_to], errors.tolist(), strict=True)),
        gain=gain,
        is_gain={name: None if np.isnan(both[k]) else bool(gain[name] > both[k]) for k, name in enumerate(goals)},
        verdict=worst.verdict,
        reason=worst.reason,
        failures=(*failures_at_start[:1], *failures[:1]),
    )


def _checked(evaluator: Evaluator, x: np.ndarray) -> list[Outcome]:
    """Return the outcomes at a point (n,) of runs that estimate their errors."""
    settings = evaluator.settings(x)
    jobs = [Job(name, [*settings, *check_of(spec)]) for name, spec in evaluator.spec.specs.items()]
    return evaluator.run(jobs)


def check_of(spec: RunSpec | InverseSpec) -> Settings:
    """Return the changes of a spec that enable error estimates; inverse dynamics always estimates errors."""
    return [(("check",), True)] if isinstance(spec, RunSpec) and not spec.estimates_errors else []


def _errors(evaluator: Evaluator, x: np.ndarray, point: str) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the estimated errors at a point (n,), called `point` in messages, and messages about runs that fail.

    The errors (K,) of goals are summed over the scenarios; those of limits are the largest over the scenarios.
    """
    settings, differences = evaluator.settings(x), []
    changes = [_changes(runs.at(settings)) for runs in evaluator.scenarios]
    jobs = [
        Job(name, [*settings, *change])
        for name, each in zip(evaluator.spec.specs, changes, strict=True)
        for change in each.values()
    ]
    outcomes = iter(evaluator.run(jobs))
    failures = []
    for scenario, found, each in zip(evaluator.spec.specs, evaluator.outcomes(x[None])[0], changes, strict=True):
        others = dict(zip(each, outcomes, strict=False))
        where = f" in the scenario '{scenario}'" if scenario else ""
        failures += [
            f"The run at the {point} with {change}{where} fails, so that errors there are unknown: "
            f"{one.reason.rstrip('.')}."
            for change, one in others.items()
            if one.verdict == "failed"
        ]
        away = [np.abs(np.subtract(other.values, found.values)) for other in others.values()]
        differences.append(np.max(away, axis=0) if away else np.full(len(found.values), np.nan))
    weights, count = evaluator.root_weights**2, len(evaluator.spec.goals)
    table = np.array(differences)
    of_goals = table[:, :count]
    if evaluator.spec.sums_squares:  # (r + e)^2 - r^2
        values = np.abs(evaluator.values(x[None])[0][:, :count])
        of_goals = np.sum(of_goals * (2 * values + of_goals), axis=1, keepdims=True)
    return np.concatenate([weights @ of_goals, np.max(table[:, count:], axis=0, initial=-np.inf)]), tuple(failures)


def _changes(spec: Any) -> dict[str, Settings]:
    """Return the changes of a run spec for a finer run and for one with another method, by description.

    Empty for inverse dynamics.
    """
    if not isinstance(spec, RunSpec):
        return {}
    step = spec.time.step
    other = RADAU if spec.integrator_item.name == "gauss" else GAUSS
    if FORMULATIONS[spec.formulation].solves_multipliers:  # Gauss methods support no such formulation
        other = {**RADAU, "stages": 3 if getattr(spec.integrator, "stages", 0) == 5 else 5}
    try:
        adaptive = spec.claims.adaptive
    except MbdkitError:
        adaptive = False
    if not adaptive and step is not None:
        halved: tuple[Path, Any] = (("time", "step"), step / FINER)
        return {"half the step": [halved], f"half the step and {other['name']}": [(("integrator",), other), halved]}
    tolerances = [
        (("integrator", name), getattr(spec.integrator, name) / TIGHTER)
        for name in ("rtol", "atol")
        if getattr(spec.integrator, name, None) is not None
    ]
    return {"tighter tolerances": tolerances} if tolerances else {}
