"""Misalignment of the joints: exactly zero, or its order in the step size, and its growth with time."""

from __future__ import annotations

import math

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.base.errors import MbdkitError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.formulation import FORMULATIONS
from mbdkit_report import growth_law, observed_order, worst_history
from mbdkit_testing.check import Check, Skip, check
from mbdkit_testing.check_result import Figure, Result, at_most, failed, passed
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, require_complete
from mbdkit_testing.invariant_checks import coarse_step
from mbdkit_testing.order_checks import BELOW, BELOW_HIGH, HIGH
from mbdkit_testing.trial_models import DRIVEN_PENDULUM, SWINGING, Model

#: Misalignment [m, m/s] below which the constraints count as satisfied; rounding and iterations may leave this much.
EXACT = 1e-11
#: Levels, ``position`` and ``velocity``, at which each formulation satisfies the constraints to round-off.
#:
#: This is true for the models of these checks, which have no closed loops.
HELD = {name: formulation.holds for name, formulation in FORMULATIONS.items() if formulation.solves_multipliers} | {
    name: ("position", "velocity") for name, formulation in FORMULATIONS.items() if formulation.coordinates == "joint"
}
ROUNDING = 1e-15
#: Misalignments [m, m/s] above this limit, a tenth of the mechanism's size, do not follow a power of the step size.
COARSE = 0.1
#: Largest number of refinements of the step, and largest ratio of the coarsest to the finest step.
REFINEMENTS, FINEST = 24, 120
#: Baumgarte's coefficient [1/s], displacement of a body from its joint [m], and the largest share of it after 1 s. The
#: share is 5e-4, apart from the drift of the method.
ALPHA, OPEN, LEFT = 10.0, 0.05, 0.2
FEWEST = 5  #: Number of step sizes over which the order must be observed.


def _level(level: str, model: Model) -> Check[IntegratorUnderTest]:
    def rate(integrator: IntegratorUnderTest) -> Result:
        if integrator.claims.adaptive:
            return _of_tolerance(integrator, level, model)
        order = integrator.order
        ratio = min(2.0, 4.0 ** (1 / order))
        steps, results = [], []
        for k in range(REFINEMENTS):
            steps.append(1.5 * coarse_step(integrator) / ratio**k)
            with integrator.run(model, {"end": 2.0, "step": steps[-1]}) as run:
                results.append(_worst(run, level))
            if results[-1] < 100 * ROUNDING or steps[0] / steps[-1] > FINEST:
                break
        sizes = np.array(results)
        if not np.any(np.isfinite(sizes)):
            raise Skip("no run completed at any step size")
        largest = float(np.nanmax(sizes))
        figures: dict[str, Figure] = {"largest": largest, "finest": float(sizes[-1])}
        if largest < EXACT:
            return passed(drift="exact", **figures).within({"largest": EXACT})
        if why := must_hold(integrator, level):
            return failed(f"{why}, but the constraints do not hold at {level} level", **figures)
        small = np.where(sizes < COARSE, sizes, np.nan)
        seen = observed_order(np.array(steps), small, floor=ROUNDING, fewest=FEWEST)
        if not seen.found:
            return passed(drift="no clear power", **figures)
        figures = {"rate": round(seen.order, 3), **figures}
        if seen.order < order - (BELOW if order < HIGH else BELOW_HIGH):
            return failed(f"drift has order {seen.order:.2f}, less than the claimed order {order:g}", **figures)
        limits = {"rate": f"at least {order:g} - {BELOW if order < HIGH else BELOW_HIGH:g}"}
        return passed(drift="polynomial", **figures).within(limits)

    rate.__doc__ = f"Misalignment at {level} level is zero, or converges at least with the claimed order."
    return Check(f"drift.{level}", rate, slow=level == "velocity")


def must_hold(integrator: IntegratorUnderTest, level: str) -> str:
    """Return the reason why the constraints should hold to round-off at a level; empty if they need not."""
    claims = integrator.claims
    if level in HELD.get(integrator.formulation, ()):
        return f"{integrator.formulation} enforces them"
    if level in claims.constraints_hold:
        return f"it claims constraints_hold = {list(claims.constraints_hold)}"
    if level == "position" and claims.drift.strip().rstrip(".").lower() in ("none", "no drift"):
        return f"it claims drift = '{claims.drift}'"
    return ""


def _worst(run: Run, level: str) -> float:
    """Return the largest misalignment of a complete run [m or m/s]; NaN if the run is not complete."""
    if run.status != "complete":
        return math.nan
    if level == "position":
        return run.misalignment_max
    return float(np.max(run.array("joints/velocity_misalignment")))


def _of_tolerance(integrator: IntegratorUnderTest, level: str, model: Model) -> Result:
    with integrator.run(model, {"end": 2.0}) as run:
        size = _worst(run, level)
    if not math.isfinite(size):
        return failed("the run did not complete")
    if size > EXACT and (why := must_hold(integrator, level)):
        return failed(f"{why}, but the constraints do not hold at {level} level", largest=size)
    return passed(drift="exact" if size < EXACT else "of the tolerance", largest=size)


@check("drift.growth", slow=True)
def growth(integrator: IntegratorUnderTest) -> Result:
    """Growth law of the misalignment of a double pendulum over 30 s; reported without a limit."""
    time = {"end": 30.0} if integrator.claims.adaptive else {"end": 30.0, "step": coarse_step(integrator) / 2}
    with integrator.run(SWINGING, time) as run:
        require_complete(run)
        history = worst_history(run)
        if np.max(history) < EXACT:
            return passed(growth="exact", largest_m=float(np.max(history)))
        result = growth_law(run.time, history)
    return passed(growth=result.law, exponent=round(result.exponent, 2), largest_m=float(np.max(history)))


@check("drift.formulations")
def formulations(integrator: IntegratorUnderTest) -> Result:
    """With each formulation that the method claims, the constraints, those of drivers included, hold at the levels that
    it enforces, and with the first one at those that the method claims.
    """
    levels = {name: list(HELD.get(name, ())) for name in integrator.claims.formulations}
    own = levels[integrator.formulation]
    own += [level for level in ("position", "velocity") if level not in own and must_hold(integrator, level)]
    if not any(levels.values()):
        raise Skip("it claims no formulation that enforces the constraints")
    figures: dict[str, Figure] = {}
    for name in filter(levels.get, levels):
        time = {"end": 2.0, "step": coarse_step(integrator) / 4}
        with integrator.run(DRIVEN_PENDULUM, time, formulation=name) as run:
            require_complete(run, f"on {name} a run", MbdkitError)
            largest = _residuals(EquationsOfMotion(integrator.workspace(DRIVEN_PENDULUM, formulation=name)), run)
        for level in levels[name]:
            figures[f"{name} {level}"] = largest[level]
            if not largest[level] <= EXACT:
                why = "" if level in HELD.get(name, ()) else f"; {must_hold(integrator, level)}"
                return failed(f"on {name} the constraints should hold at {level} level{why}", **figures)
    return passed(**figures).within(dict.fromkeys(figures, EXACT))


def _residuals(equations: EquationsOfMotion, run: Run) -> dict[str, float]:
    """Return the largest residuals of the constraints in the rows of a run, at both levels [m, rad; per second]."""
    q, v = (run.array(f"trajectory/{name}").reshape(len(run.time), -1) for name in ("position", "velocity"))
    results = [
        (equations.constraints(*row[:2]), equations.constraint_rates(*row)) for row in zip(run.time, q, v, strict=True)
    ]
    position, velocity = np.max(np.abs(results), axis=(0, 2)).tolist()
    return {"position": position, "velocity": velocity}


@check("drift.baumgarte")
def baumgarte(integrator: IntegratorUnderTest) -> Result:
    """With Baumgarte's stabilization, an open joint closes as ``(1 + alpha t) exp(-alpha t)``."""
    claims = integrator.claims
    if "baumgarte" not in claims.stabilizations or "index-1" not in claims.formulations:
        raise Skip("it does not claim Baumgarte's stabilization of the index-1 equations")
    chosen = {"name": "baumgarte", "alpha": ALPHA}
    workspace = integrator.workspace(SWINGING, formulation="index-1", stabilization=chosen)
    workspace.q0[3] += OPEN
    equations = EquationsOfMotion(workspace)
    q, _ = integrator.moved(workspace, workspace.t0 + 1.0, math.ceil(4.0 / coarse_step(integrator)))
    left = float(np.max(np.abs(equations.constraints(workspace.t0 + 1.0, q[: equations.n])))) / OPEN
    return at_most(LEFT, "it claims Baumgarte's stabilization, but an open joint does not close", left=left)


@check("drift.projection")
def projection(integrator: IntegratorUnderTest) -> Result:
    """With a projection after each step, the constraints hold at position and velocity level."""
    if "projection" not in integrator.claims.stabilizations:
        raise Skip("it does not claim projection")
    time = {"end": 2.0} | ({} if integrator.claims.adaptive else {"step": coarse_step(integrator) / 4})
    with integrator.run(DRIVEN_PENDULUM, time, stabilization="projection") as run:
        require_complete(run, "with projection a run", MbdkitError)
        figures = {level: _worst(run, level) for level in ("position", "velocity")}
    return at_most(EXACT, "it claims projection, but the constraints do not hold", **figures)


CHECKS = (
    _level("position", SWINGING), _level("velocity", DRIVEN_PENDULUM), growth, formulations, baumgarte, projection
)  # fmt: skip
