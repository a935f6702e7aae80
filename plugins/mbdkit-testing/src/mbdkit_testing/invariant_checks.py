"""Geometric properties: reversibility, quadratic invariants, symplecticity, long-term energy, and claims of conserved
energy and momentum, tested in steps so large that errors are far above rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbdkit.archive.run import Run
from mbdkit_report import Trend, trend
from mbdkit_testing.check import Check, check
from mbdkit_testing.check_result import Result, at_most, failed, passed, skipped, unclaimed, warned
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, final_state, require_complete
from mbdkit_testing.trial_models import FLOATING, FLOATING_RODS, FREE_FOUR_BAR, HARMONIC, ORBIT, SWINGING, Model

REVERSED = 1e-9  #: Distance from the start, after integrating forward and backward, that counts as rounding.
CONSERVED = 1e-10  #: Relative change of a quadratic invariant that counts as rounding.
SYMPLECTIC = 1e-7  #: Defect of the symplectic form that counts as an error of the finite differences.
#: Step sizes [s] by order at which errors are well above rounding.
STEPS_OF_ORDER = {1: 0.01, 2: 0.02, 3: 0.04, 4: 0.05, 5: 0.08, 6: 0.1, 7: 0.14, 8: 0.2}


def coarse_step(integrator: IntegratorUnderTest) -> float:
    """Return a step size [s] at which the errors of the method are well above rounding."""
    order = integrator.claims.order
    return 0.05 if order is None else STEPS_OF_ORDER.get(math.ceil(order), 0.25)


def _reversible(name: str, model: Model, duration: float) -> Check[IntegratorUnderTest]:
    def there_and_back(integrator: IntegratorUnderTest) -> Result:
        steps = round(duration / coarse_step(integrator))
        workspace = integrator.workspace(model)
        q, v = integrator.moved(workspace, duration, steps)
        returned = integrator.moved(replace(workspace, q0=q, v0=-v), duration, steps)
        defect = float(max(np.max(np.abs(returned[0] - workspace.q0)), np.max(np.abs(returned[1] + workspace.v0))))
        finer = integrator.moved(workspace, duration, 2 * steps)
        own = float(max(np.max(np.abs(q - finer[0])), np.max(np.abs(v - finer[1]))))
        if integrator.claims.adaptive:
            return unclaimed(defect=defect)
        figures = {"defect": defect, "own_error": own, "step_s": duration / steps}
        if integrator.claims.symmetric:
            if defect > REVERSED:
                return failed("it claims to be symmetric, but does not return to its start", **figures)
            if own < 100 * REVERSED:
                return skipped("its errors are too small to distinguish symmetry from accuracy", **figures)
            return passed(**figures).within({"defect": REVERSED})
        if defect < REVERSED and own > 100 * REVERSED:
            return warned("it returns to its start like a symmetric method, but does not claim symmetry", **figures)
        return unclaimed(**figures)

    there_and_back.__doc__ = (
        f"On the {name.replace('-', ' ')} with reversed velocities, a symmetric method returns to its start."
    )
    return Check(f"geometry.reversibility-{name}", there_and_back)


@check("geometry.quadratic-invariants")
def quadratic_invariants(integrator: IntegratorUnderTest) -> Result:
    """A method that claims to conserve quadratic invariants conserves angular momentum and the energy of a linear
    spring, also in large steps.
    """
    step = 2 * coarse_step(integrator)
    time = {"end": 40.0} if integrator.claims.adaptive else {"steps": 400, "step": step}
    with integrator.run(ORBIT, time) as run:
        require_complete(run)
        x, u = run["mass"].position, run["mass"].velocity
        momentum = x[:, 0] * u[:, 1] - x[:, 1] * u[:, 0]
    with integrator.run(HARMONIC, time) as run:
        require_complete(run)
        energy = run.energy.total
    changes = {
        "momentum_change": float(np.max(np.abs(momentum / momentum[0] - 1))),
        "energy_change": float(np.max(np.abs(energy / energy[0] - 1))),
    }
    lost = [name.partition("_")[0] for name, change in changes.items() if not change <= CONSERVED]
    if integrator.claims.quadratic_invariants:
        cause = f"it claims to conserve quadratic invariants, but {lost[0]} changes" if lost else ""
        return at_most(CONSERVED, cause, **changes)
    if lost:
        return unclaimed(**changes)
    return warned("it conserves quadratic invariants, but does not claim it", **changes)


@check("geometry.symplectic-form")
def symplectic_form(integrator: IntegratorUnderTest) -> Result:
    """If the method claims to be symplectic, the Jacobian J of a few steps of a mass in a central field satisfies
    J^T S J = S, where S is the matrix of the symplectic form.
    """
    if integrator.claims.adaptive:
        return skipped("it is adaptive: the step size depends on the state")
    step, steps, small = 4 * coarse_step(integrator), 3, 1e-5
    workspace = integrator.workspace(ORBIT)

    def image(change: np.ndarray) -> np.ndarray:
        q0, v0 = workspace.q0.copy(), workspace.v0.copy()
        q0[:2] += change[:2]
        v0[:2] += change[2:]
        q, v = integrator.moved(replace(workspace, q0=q0, v0=v0), steps * step, steps)
        return np.concatenate([q[:2], v[:2]])

    columns = [
        (8 * (image(small * e) - image(-small * e)) - (image(2 * small * e) - image(-2 * small * e))) / (12 * small)
        for e in np.eye(4)
    ]
    jacobian = np.array(columns).T
    form = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    defect = float(np.max(np.abs(jacobian.T @ form @ jacobian - form)))
    if not integrator.claims.symplectic:
        return unclaimed(defect=defect)
    return at_most(SYMPLECTIC, "it claims to be symplectic, but does not conserve the symplectic form", defect=defect)


@check("geometry.energy")
def energy(integrator: IntegratorUnderTest) -> Result:
    """If the method claims to be symplectic or symmetric, the energy of a mass in a central field has no long-term
    trend.
    """
    result, duration = energy_trend(integrator, ORBIT)
    change = result.slope * duration
    figures = {"trend_J_per_s": result.slope, "error_J_per_s": result.error, "largest_J": result.largest}
    if not (integrator.claims.symplectic or integrator.claims.symmetric):
        return unclaimed(**figures)
    if result.drifts and result.largest > 1e-11 and abs(change) > 0.3 * result.largest:
        return failed("it claims to be symplectic or symmetric, but its energy has a trend", **figures)
    return passed(**figures)


@check("geometry.energy-jointed", slow=True)
def energy_jointed(integrator: IntegratorUnderTest) -> Result:
    """Trend of the energy of a conservative double pendulum, including effects of drift; reported without a limit."""
    result, _ = energy_trend(integrator, SWINGING)
    return passed(trend_J_per_s=result.slope, error_J_per_s=result.error, largest_J=result.largest)


def energy_trend(integrator: IntegratorUnderTest, model: Model) -> tuple[Trend, float]:
    """Return the trend of the energy balance in a run, and the duration of the run [s].

    The run takes 1000 steps of half the size `coarse_step`; an adaptive method takes its own steps over the same
    duration.
    """
    step = coarse_step(integrator) / 2
    duration = 1000 * step
    time = {"end": duration} if integrator.claims.adaptive else {"steps": 1000, "step": step}
    with integrator.run(model, time) as run:
        require_complete(run)
        return trend(run.time, run.energy.balance), duration


STEPS = 100  #: Number of the large steps in which conservation is tested.
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
    _reversible("pendulum", SWINGING, 4.0),
    _reversible("four-bar", FREE_FOUR_BAR, 2.0),
    quadratic_invariants,
    symplectic_form,
    energy,
    energy_jointed,
    _conserved("energy", (FLOATING, SWINGING), _energy),
    _conserved("linear-momentum", (FLOATING, FLOATING_RODS), _linear),
    _conserved("angular-momentum", (FLOATING, FLOATING_RODS), _angular),
)
