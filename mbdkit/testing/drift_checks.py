"""How far joints come apart: not at all, or by which power of the step, and how that grows with time."""

from __future__ import annotations

import math

import numpy as np

from mbdkit.analysis.drift import worst_history
from mbdkit.analysis.growth import growth_law
from mbdkit.analysis.order import observed_order
from mbdkit.archive.run import Run
from mbdkit.testing.check import Check, Skip, check
from mbdkit.testing.integrator_under_test import IntegratorSubject
from mbdkit.testing.invariant_checks import telling_step
from mbdkit.testing.order_checks import BELOW, HIGH
from mbdkit.testing.outcome import Figure, Finding, failed, passed
from mbdkit.testing.trial_models import DRIVEN_PENDULUM, SWINGING, Model

EXACT = 1e-11
"""Misalignment [m, m/s] that is nothing but rounding and the residual of a converged iteration."""
HELD = {"index-3": ("position",), "index-2": ("velocity",), "ggl": ("position", "velocity")}
"""At which levels a formulation holds the constraints."""
ROUNDING = 1e-15
BELOW_HIGH = 0.5
"""From order `HIGH` on few steps lie between what is too coarse and rounding: the rate is seen to this only."""
COARSE = 0.1
"""Misalignment [m, m/s] that is as large as the mechanism, and follows no power of the step."""
REFINEMENTS, FINEST = 24, 120
"""Most refinements, and the factor by which they refine at most."""
FEWEST = 5
"""Steps over which a power of the step has to be seen."""


def _level(level: str, model: Model) -> Check[IntegratorSubject]:
    def rate(subject: IntegratorSubject) -> Finding:
        if subject.claims.adaptive:
            return _of_tolerance(subject, level, model)
        order = subject.order
        ratio = min(2.0, 4.0 ** (1 / order))
        steps, found = [], []
        for k in range(REFINEMENTS):
            steps.append(1.5 * telling_step(subject) / ratio**k)
            with subject.run(model, {"end": 2.0, "step": steps[-1]}) as run:
                found.append(_worst(run, level))
            if found[-1] < 100 * ROUNDING or steps[0] / steps[-1] > FINEST:
                break
        sizes = np.array(found)
        if not np.any(np.isfinite(sizes)):
            raise Skip("no run completed, whatever the step")
        largest = float(np.nanmax(sizes))
        figures: dict[str, Figure] = {"largest": largest, "finest": float(sizes[-1])}
        if largest < EXACT:
            return passed(drift="exact", **figures)
        if level in HELD.get(subject.formulation, ()):
            return failed(f"on {subject.formulation} the joints should meet at {level} level", **figures)
        small = np.where(sizes < COARSE, sizes, np.nan)
        seen = observed_order(np.array(steps), small, floor=ROUNDING, fewest=FEWEST)
        if not seen.found:
            return passed(drift="no clear power", **figures)
        figures = {"rate": round(seen.order, 3), **figures}
        if seen.order < order - (BELOW if order < HIGH else BELOW_HIGH):
            return failed(
                f"drift falls with order {seen.order:.2f}, slower than the claimed order {order:g}", **figures
            )
        return passed(drift="polynomial", **figures)

    rate.__doc__ = f"Misalignment at {level} level is exact, or falls with the step at least as fast as claimed."
    return Check(f"drift.{level}", rate, slow=level == "velocity")


def _worst(run: Run, level: str) -> float:
    """Return the largest misalignment of a complete run [m or m/s], else NaN."""
    if run.status != "complete":
        return math.nan
    if level == "position":
        return run.misalignment_max
    return float(np.max(run.array("joints/velocity_misalignment")))


def _of_tolerance(subject: IntegratorSubject, level: str, model: Model) -> Finding:
    with subject.run(model, {"end": 2.0}) as run:
        size = _worst(run, level)
    if not math.isfinite(size):
        return failed("the run did not complete")
    return passed(drift="exact" if size < EXACT else "of the tolerance", largest=size)


@check("drift.growth", slow=True)
def growth(subject: IntegratorSubject) -> Finding:
    """By which law misalignment grows over 30 s of a double pendulum; measured, never judged."""
    step = telling_step(subject) / 2
    time = {"end": 30.0} if subject.claims.adaptive else {"end": 30.0, "step": step}
    with subject.run(SWINGING, time) as run:
        if run.status != "complete":
            raise Skip(f"the run did not complete: {run.status_reason}".rstrip("."))
        history = worst_history(run)
        if np.max(history) < EXACT:
            return passed(growth="exact", largest_m=float(np.max(history)))
        found = growth_law(run.time, history)
    return passed(growth=found.law, exponent=round(found.exponent, 2), largest_m=float(np.max(history)))


@check("drift.formulations")
def formulations(subject: IntegratorSubject) -> Finding:
    """On every further formulation that it claims, constraints hold at the levels that this one asks for."""
    others = [name for name in subject.claims.formulations if name != subject.formulation and name in HELD]
    if not others:
        raise Skip("it claims no further formulation that holds constraints")
    figures: dict[str, Figure] = {}
    for name in others:
        for level in HELD[name]:
            with subject.run(DRIVEN_PENDULUM, {"end": 2.0, "step": telling_step(subject) / 4}, formulation=name) as run:
                size = _worst(run, level)
                if not math.isfinite(size):
                    return failed(f"on {name} a run did not complete: {run.status_reason}")
            figures[f"{name} {level}"] = size
            if size > EXACT:
                return failed(f"on {name} the joints should meet at {level} level", **figures)
    return passed(**figures)


CHECKS = (_level("position", SWINGING), _level("velocity", DRIVEN_PENDULUM), growth, formulations)
