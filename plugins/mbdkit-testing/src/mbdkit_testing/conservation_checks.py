"""Claims of conserved energy and momentum, tested in steps so large that errors are far above rounding."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mbdkit.archive.run import Run
from mbdkit_testing.check import Check
from mbdkit_testing.check_result import Result, failed, passed, skipped, unclaimed
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, final_state, require_complete
from mbdkit_testing.invariant_checks import CONSERVED, coarse_step
from mbdkit_testing.trial_models import FLOATING, FLOATING_RODS, SWINGING, Model

STEPS = 100
LOOSE = 1e-3  #: Tolerance of adaptive methods, with which nothing is conserved by accuracy.


def _conserved(
    name: str, models: tuple[Model, ...], quantity: Callable[[Run, Model], np.ndarray]
) -> Check[IntegratorUnderTest]:
    def conserved(integrator: IntegratorUnderTest) -> Result:
        largest, error = 0.0, np.inf
        for model in models:
            ends = []
            for finer in (1, 2):
                with _run(integrator, model, finer) as run:
                    if run.status != "complete" and name in integrator.claims.conserves:
                        reason = run.status_reason.rstrip(".")
                        return failed(f"it claims to conserve {name}, but a run in large steps failed: {reason}")
                    require_complete(run)
                    ends.append(final_state(run))
                    if finer == 1:
                        values = quantity(run, model)
                        largest = max(largest, float(np.max(np.abs(values - values[0]))))
            error = min(error, float(np.max(np.abs(ends[0] - ends[1]))))
        figures = {"change": largest, "own_error": error}
        if name not in integrator.claims.conserves:
            return unclaimed(**figures)
        if largest > CONSERVED:
            return failed(f"it claims to conserve {name}, but in large steps it changes", **figures)
        if not integrator.claims.adaptive and error < 100 * CONSERVED:
            return skipped("its errors are too small to distinguish conservation from accuracy", **figures)
        return passed(**figures).within({"change": CONSERVED})

    joined = "of a double pendulum" if SWINGING in models else "of rods with a joint"
    conserved.__doc__ = (
        f"A method that claims to conserve {name} conserves that of bodies joined by a spring and {joined}, also in "
        "large steps."
    )
    return Check(f"geometry.conserved-{name}", conserved)


def _run(integrator: IntegratorUnderTest, model: Model, finer: int) -> Run:
    step = coarse_step(integrator)
    if integrator.claims.adaptive:
        return integrator.run(model, {"end": STEPS * step}, options=integrator.tolerances(LOOSE / finer))
    return integrator.run(model, {"steps": finer * STEPS, "step": step / finer})


def _energy(run: Run, model: Model) -> np.ndarray:
    """Return the total energy (T,), as a share of the largest kinetic energy."""
    return np.asarray(run.energy.total / np.max(run.energy.kinetic))


def _linear(run: Run, model: Model) -> np.ndarray:
    """Return the linear momentum (T, 2), as a share of the sum of its absolute values over the bodies."""
    parts = [body["mass"] * run[name].velocity for name, body in model["bodies"].items()]
    return np.asarray(sum(parts) / np.max(sum(np.abs(part) for part in parts)))


def _angular(run: Run, model: Model) -> np.ndarray:
    """Return the angular momentum about the origin (T,), as a share of that of the bodies together."""
    parts = []
    for name, body in model["bodies"].items():
        x, v = run[name].position, run[name].velocity
        parts.append(body["mass"] * (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]))
        parts.append(body["inertia"] * run[name].angular_velocity)
    return np.asarray(sum(parts) / np.max(sum(np.abs(part) for part in parts)))


CHECKS = (
    _conserved("energy", (FLOATING, SWINGING), _energy),
    _conserved("linear-momentum", (FLOATING, FLOATING_RODS), _linear),
    _conserved("angular-momentum", (FLOATING, FLOATING_RODS), _angular),
)
