"""What a method keeps: reversibility, quadratic invariants, the symplectic form, energy in the long run."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mbdkit.analysis.energy import Trend, trend
from mbdkit.engine.workspace import Workspace
from mbdkit.testing.check import Check, Skip, check
from mbdkit.testing.integrator_under_test import IntegratorSubject
from mbdkit.testing.outcome import Figure, Finding, failed, passed, skipped, warned
from mbdkit.testing.trial_models import FREE_FOUR_BAR, HARMONIC, ORBIT, SWINGING, Model

REVERSED = 1e-9
"""Distance from the start after a way there and back that is nothing but rounding."""
CONSERVED = 1e-10
"""Relative change of a quadratic invariant that is nothing but rounding."""
SYMPLECTIC = 1e-7
"""Defect of the symplectic form that is nothing but the differences by which it is measured."""
STEPS_OF_ORDER = {1: 0.01, 2: 0.02, 3: 0.04, 4: 0.05, 5: 0.08, 6: 0.1, 7: 0.14, 8: 0.2}
"""Steps [s] so large that a method of an order makes errors well above rounding."""


def telling_step(subject: IntegratorSubject) -> float:
    """Return a step [s] at which the method's own errors are well above rounding."""
    order = subject.claims.order
    return 0.05 if order is None else STEPS_OF_ORDER.get(math.ceil(order), 0.25)


def _reversible(name: str, model: Model, duration: float) -> Check[IntegratorSubject]:
    def there_and_back(subject: IntegratorSubject) -> Finding:
        steps = round(duration / telling_step(subject))
        workspace = subject.workspace(model)
        q, v = subject.moved(workspace, duration, steps)
        back = replace(workspace, q0=q, v0=-v)
        defect = _distance(subject.moved(back, duration, steps), workspace)
        finer = subject.moved(workspace, duration, 2 * steps)
        own = float(max(np.max(np.abs(q - finer[0])), np.max(np.abs(v - finer[1]))))
        if subject.claims.adaptive:
            return passed(defect=defect)
        figures = {"defect": defect, "own_error": own, "step_s": duration / steps}
        if subject.claims.symmetric:
            if defect > REVERSED:
                return failed("it claims to be symmetric, but does not lead back to its start", **figures)
            if own < 100 * REVERSED:
                return skipped("its errors are too small to tell symmetry from accuracy", **figures)
            return passed(**figures)
        if defect < REVERSED and own > 100 * REVERSED:
            return warned("it leads back to its start like a symmetric method, which it does not claim", **figures)
        return passed(**figures)

    there_and_back.__doc__ = (
        f"On the {name.replace('-', ' ')} with velocities turned round it leads back to its start if it is symmetric."
    )
    return Check(f"geometry.reversibility-{name}", there_and_back)


def _distance(state: tuple[np.ndarray, np.ndarray], workspace: Workspace) -> float:
    q, v = state
    return float(max(np.max(np.abs(q - workspace.q0)), np.max(np.abs(v + workspace.v0))))


@check("geometry.quadratic-invariants")
def quadratic_invariants(subject: IntegratorSubject) -> Finding:
    """Angular momentum about a central spring, and energy on a linear one, stay what they were, in large steps."""
    step = 2 * telling_step(subject)
    time = {"end": 40.0} if subject.claims.adaptive else {"steps": 400, "step": step}
    with subject.run(ORBIT, time) as run:
        _require_complete(run.status, run.status_reason)
        x, u = run["mass"].position, run["mass"].velocity
        momentum = x[:, 0] * u[:, 1] - x[:, 1] * u[:, 0]
    with subject.run(HARMONIC, time) as run:
        _require_complete(run.status, run.status_reason)
        energy = run.energy.total
    figures: dict[str, Figure] = {
        "momentum_change": float(np.max(np.abs(momentum / momentum[0] - 1))),
        "energy_change": float(np.max(np.abs(energy / energy[0] - 1))),
    }
    lost = [
        name.partition("_")[0] for name, change in figures.items() if isinstance(change, float) and change > CONSERVED
    ]
    if subject.claims.quadratic_invariants and lost:
        return failed(f"it claims to conserve quadratic invariants, but {lost[0]} changes", **figures)
    if not lost and not subject.claims.quadratic_invariants:
        return warned("it conserves quadratic invariants, which it does not claim", **figures)
    return passed(**figures)


@check("geometry.symplectic-form")
def symplectic_form(subject: IntegratorSubject) -> Finding:
    """The derivative J of some steps on a mass in a central field satisfies J^T S J = S if it is symplectic."""
    if subject.claims.adaptive:
        return skipped("its steps depend on the state, so that no map of one step exists")
    step, steps, small = 4 * telling_step(subject), 3, 1e-5
    workspace = subject.workspace(ORBIT)

    def image(change: np.ndarray) -> np.ndarray:
        q0, v0 = workspace.q0.copy(), workspace.v0.copy()
        q0[:2] += change[:2]
        v0[:2] += change[2:]
        q, v = subject.moved(replace(workspace, q0=q0, v0=v0), steps * step, steps)
        return np.concatenate([q[:2], v[:2]])

    columns = [
        (8 * (image(small * e) - image(-small * e)) - (image(2 * small * e) - image(-2 * small * e))) / (12 * small)
        for e in np.eye(4)
    ]
    jacobian = np.array(columns).T
    form = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    defect = float(np.max(np.abs(jacobian.T @ form @ jacobian - form)))
    if subject.claims.symplectic and defect > SYMPLECTIC:
        return failed("it claims to be symplectic, but does not conserve the symplectic form", defect=defect)
    return passed(defect=defect)


@check("geometry.energy")
def energy(subject: IntegratorSubject) -> Finding:
    """The energy of a mass in a central field has no trend in the long run if the method is symplectic or symmetric."""
    found, duration = energy_trend(subject, ORBIT)
    change = found.slope * duration
    figures = {"trend_J_per_s": found.slope, "error_J_per_s": found.error, "largest_J": found.largest}
    keeps = subject.claims.symplectic or subject.claims.symmetric
    if keeps and found.drifts and found.largest > 1e-11 and abs(change) > 0.3 * found.largest:
        return failed("it claims to be symplectic or symmetric, but its energy has a trend", **figures)
    return passed(**figures)


@check("geometry.energy-jointed", slow=True)
def energy_jointed(subject: IntegratorSubject) -> Finding:
    """The trend of the energy of a conservative double pendulum, whose joints drift too; measured, never judged."""
    found, _ = energy_trend(subject, SWINGING)
    return passed(trend_J_per_s=found.slope, error_J_per_s=found.error, largest_J=found.largest)


def energy_trend(subject: IntegratorSubject, model: Model) -> tuple[Trend, float]:
    """Return the trend of the energy balance over 1000 steps, half as large as the telling ones, and their time [s]."""
    step = telling_step(subject) / 2
    duration = 1000 * step
    time = {"end": duration} if subject.claims.adaptive else {"steps": 1000, "step": step}
    with subject.run(model, time) as run:
        _require_complete(run.status, run.status_reason)
        return trend(run.time, run.energy.balance), duration


def _require_complete(status: str, reason: str) -> None:
    if status != "complete":
        raise Skip(f"the run did not complete: {reason}".rstrip("."))


CHECKS = (
    _reversible("pendulum", SWINGING, 4.0),
    _reversible("four-bar", FREE_FOUR_BAR, 2.0),
    quadratic_invariants,
    symplectic_form,
    energy,
    energy_jointed,
)
