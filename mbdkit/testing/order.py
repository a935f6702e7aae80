"""The order of convergence: exact on polynomials, and observed on nonlinear problems that depend on time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache

import numpy as np

from mbdkit.analysis.order import ObservedOrder, observed_order
from mbdkit.integrators.step_method import StepMethod
from mbdkit.testing.check import Check, Skip, check
from mbdkit.testing.outcome import Finding, failed, passed, skipped, warned
from mbdkit.testing.problems import DRIVEN_PENDULUM, FORCED_PENDULUM, FOUR_BAR, Model, pushed
from mbdkit.testing.subject import IntegratorSubject, final_state

PROBLEMS: dict[str, Model] = {
    "forced-pendulum": FORCED_PENDULUM,
    "driven-pendulum": DRIVEN_PENDULUM,
    "four-bar": FOUR_BAR,
}
ENDS = {"forced-pendulum": 1.0, "driven-pendulum": 3.0, "four-bar": 1.0}
"""How long each moves [s]: long enough that errors follow a power of the step before they meet rounding."""
BELOW, ABOVE = 0.2, 0.5
"""An order lower than claimed by more than `BELOW` is an over-claim, one higher by more than `ABOVE` an under-claim."""
MOST_STEPS, MOST_PYTHON_STEPS = 8192, 1024
FIRST_STEPS = 5
HIGH = 8
"""Order above which errors may meet rounding before they follow a power of the step."""
POLYNOMIAL = 1e-13


@cache
def reference(problem: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the state and the multipliers at the end, and their floor of rounding.

    They come from Gauss collocation with 6 stages in 60 steps a second; the floor is the difference to 75 a second.
    """
    from mbdkit.simulation import run

    found, end = [], ENDS[problem]
    for rate in (60, 75):
        with run(
            {"mbdkit": 1, "model": PROBLEMS[problem], "time": {"end": end, "step": 1 / rate}},
            integrator={"name": "mbdkit:gauss", "stages": 6},
        ).check() as result:
            found.append((final_state(result), result.array("constraints/multiplier")[-1].copy()))
    (state, multipliers), (other, _) = found
    return state, multipliers, max(float(np.max(np.abs(state - other))), 1e-15)


class Convergence:
    """Errors of an integrator over a sequence of steps, on one problem.

    Attributes
    ----------
    order
        The order that the integrator claims.
    steps
        (K,) step sizes [s], coarsest first.
    errors, multiplier_errors
        (K,) largest error of any position or velocity, and of any multiplier, at the end; NaN where the run failed.
    floor
        Floor of rounding.
    """

    def __init__(self, subject: IntegratorSubject, problem: str):
        state, multipliers, self.floor = reference(problem)
        self.order = subject.order
        steps, errors, others, end = [], [], [], ENDS[problem]
        for number in numbers_of_steps(subject):
            with subject.run(PROBLEMS[problem], {"end": end, "step": end / number}, output={"every": 10**9}) as run:
                errors.append(float(np.max(np.abs(final_state(run) - state))))
                if subject.claims.multiplier_order is not None and run.status == "complete":
                    own = run.array("constraints/method_multiplier")[-1]
                    others.append(float(np.max(np.abs(own - multipliers)) / np.max(np.abs(multipliers))))
                else:
                    others.append(math.nan)
            steps.append(end / number)
            if errors[-1] < 10 * self.floor:
                break
        self.steps, self.errors, self.multiplier_errors = np.array(steps), np.array(errors), np.array(others)

    @property
    def observed(self) -> ObservedOrder:
        """The order of positions and velocities."""
        return observed_order(self.steps, self.errors, floor=self.floor, fewest=4 if self.order > HIGH else 3)


def numbers_of_steps(subject: IntegratorSubject) -> Iterator[int]:
    """Give numbers of steps, refined so that the error of a method of the claimed order falls fourfold each time."""
    order = subject.order
    ratio = min(2.0, max(4.0 ** (1 / order), 1.05))
    most = MOST_PYTHON_STEPS if isinstance(subject.method(), StepMethod) else MOST_STEPS
    exact = float(FIRST_STEPS)
    while exact <= most:
        yield round(exact)
        exact = max(exact * ratio, round(exact) + 1)


def convergence(subject: IntegratorSubject, problem: str) -> Convergence:
    """Return the errors on a problem, computed once."""
    return subject.kept(f"convergence on {problem}", lambda: Convergence(subject, problem))


def judged(claimed: float, observed: ObservedOrder, errors: np.ndarray, what: str = "order") -> Finding:
    """Hold an observed order to the claimed one."""
    finite = errors[np.isfinite(errors)]
    if len(finite) == 0:
        return failed("no run completed, whatever the step")
    figures = {"claimed": claimed, "smallest_error": float(finite.min())}
    if not observed.found:
        if claimed > HIGH and finite.min() < 1e-12:
            return skipped("its errors meet rounding before they follow a power of the step", **figures)
        return failed(f"it claims {what} {claimed:g}, but its errors follow no order at all", **figures)
    figures = {
        "measured": round(observed.order, 3),
        "coarsest": observed.steps[0],
        "finest": observed.steps[-1],
        **figures,
    }
    if observed.order < claimed - BELOW:
        return failed(f"it claims {what} {claimed:g}, and shows {observed.order:.2f}", **figures)
    if observed.order > claimed + ABOVE:
        return warned(f"it claims {what} {claimed:g}, and shows {observed.order:.2f}", **figures)
    return passed(**figures)


def _on(problem: str) -> Check[IntegratorSubject]:
    def observed(subject: IntegratorSubject) -> Finding:
        found = convergence(subject, problem)
        return judged(subject.order, found.observed, found.errors)

    observed.__doc__ = (
        f"Its error on the {problem.replace('-', ' ')}, nonlinear and dependent on time, falls with the claimed order."
    )
    return Check(f"order.{problem}", observed, slow=problem == "driven-pendulum")


@check("order.multipliers")
def multipliers(subject: IntegratorSubject) -> Finding:
    """The multipliers that it carries itself converge with the order that it claims for them."""
    claimed = subject.claims.multiplier_order
    if claimed is None:
        raise Skip("it claims no order of multipliers")
    found = convergence(subject, "forced-pendulum")
    return judged(
        claimed, observed_order(found.steps, found.multiplier_errors), found.multiplier_errors, "order of multipliers"
    )


@check("order.polynomials")
def polynomials(subject: IntegratorSubject) -> Finding:
    """A method of order p takes a mass whose velocity is a polynomial of degree p to the right place in one step."""
    order = int(subject.order)
    worst, first = 0.0, None
    for power in range(order):
        with subject.run(pushed(power), {"end": 1.0, "step": 1.0}) as run:
            if run.status != "complete":
                raise Skip(f"a free mass could not be moved: {run.status_reason}".rstrip("."))
            body = run["mass"]
            defect = abs(float(body.velocity[-1, 0]) - 1 / (power + 1))
            if power < order - 1:
                defect = max(defect, abs(float(body.position[-1, 0]) - 1 / ((power + 1) * (power + 2))))
        worst = max(worst, defect)
        if defect > POLYNOMIAL and first is None:
            first = power
    if first is None:
        return passed(degree=order, defect=worst)
    cause = f"under the force t^{first} one step of 1 s is not exact, as order {order} would have it"
    if isinstance(subject.method(), StepMethod):
        return warned(f"{cause} of a method that is linear in the forces", defect=worst)
    return failed(cause, defect=worst)


CHECKS = (polynomials, *(_on(problem) for problem in PROBLEMS), multipliers)
