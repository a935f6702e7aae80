"""Checks of convergence as the step size or the tolerance decreases.

They test exactness on polynomials, observed orders on nonlinear non-autonomous problems, and errors of adaptive
methods.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.base.errors import StepError
from mbdkit.methods.step_methods import StepMethod
from mbdkit.spec.formulation_choice import choice_of
from mbdkit.spec.loading import load_spec
from mbdkit_report import ObservedOrder, observed_order
from mbdkit_testing.check import Check, Skip, check
from mbdkit_testing.check_result import Figure, Result, failed, passed, skipped, unclaimed, warned
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, drive, final_state, require_complete
from mbdkit_testing.single_steps import equations_for, has_memory, model_for, step_method, step_of
from mbdkit_testing.trial_models import (
    BEAM,
    DRIVEN_PENDULUM,
    FORCED_PENDULUM,
    FOUR_BAR,
    LAGGING_PENDULUM,
    ORBIT,
    RESTING,
    SLIPPING,
    Model,
    oscillators,
    pushed,
)

PROBLEMS: dict[str, Model] = {
    "forced-pendulum": FORCED_PENDULUM,
    "driven-pendulum": DRIVEN_PENDULUM,
    "four-bar": FOUR_BAR,
    "beam": BEAM,
    "linear-oscillators": oscillators(3.0, (0.0, 0.1, 0.7)),
    "joint-friction": SLIPPING,
    **{f"resting: {name}": model for name, model in RESTING.items()},
}
USUAL = tuple(PROBLEMS)[:4]  #: Names of the nonlinear problems, each of which has a check of its own.
#: Duration of each problem [s]; long enough that errors follow a power of the step before they reach rounding.
ENDS = dict.fromkeys(PROBLEMS, 1.0) | {"driven-pendulum": 3.0}
#: An observed order below the claimed one by more than `BELOW` fails; above it by more than `ABOVE` is a warning.
BELOW, ABOVE = 0.2, 0.5
MOST_STEPS, MOST_PYTHON_STEPS = 8192, 1024
FIRST_STEPS = 5
HIGH = 8  #: For orders above this, errors may reach rounding before they follow a power of the step.
#: Replaces `BELOW` for high orders, for which few step sizes are neither too coarse nor dominated by round-off.
#:
#: An observed order between the two limits is inconclusive.
BELOW_HIGH = 0.5
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
#: Smallest factor by which the error of an adaptive method must decrease over four decades of the tolerance.
OBEYS = 10.0
#: Tolerances at which steps are counted, and the least ratio of p + 1 at the two tight ones to that at the two loose
#: ones, for a method of variable order p.
COUNTED_TOLERANCES, RISES = (1e-2, 1e-4, 1e-7, 1e-9), 1.25
#: Least increase of the mean of the orders that steps report, from the loosest of these tolerances to the tightest.
REPORTED = 0.5
STATES_FLOOR = 1e-14  #: Errors of first-order states of this size count as rounding.
#: Size of the first attempt of a step [s], and the largest number of attempts.
LARGEST_TRIAL, MOST_TRIALS = 1.7, 200
NO_GROWTH = 1e-3  #: Smallest growth of the logarithm of the number of steps, which keeps the order finite.
POLYNOMIAL = 1e-13
NEAR_ROUNDING = 1e-11  #: Errors below this count as rounding, for which the order need not hold.
FINEST = 3  #: Number of refinements over which the order at the finest steps is measured.


@cache
def reference(problem: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the reference state and multipliers at the end, and the rounding error of the state.

    State and multipliers are computed by Gauss collocation with 6 stages in 60 steps per second. The rounding error is
    estimated by the difference between the states with 60 and 75 steps per second.
    """
    results = []
    for rate in (60, 75):
        with _precise_run(PROBLEMS[problem], ENDS[problem], rate) as result:
            results.append((final_state(result), result.array("constraints/multiplier")[-1].copy()))
    (state, multipliers), (other, _) = results
    return state, multipliers, max(float(np.max(np.abs(state - other))), 1e-15)


def _precise_run(model: Model, end: float, rate: int) -> Run:
    from mbdkit.runs.simulation import simulate  # it does not print warnings, which would concern the test problem

    gauss, time = {"name": "mbdkit:gauss", "stages": 6}, {"end": end, "step": 1 / rate}
    return simulate(load_spec({"mbdkit": 1, "model": model, "integrator": gauss, "time": time})).check()


class Convergence:
    """Errors of an integrator on a problem, over a sequence of step sizes.

    Parameters
    ----------
    formulation
        The formulation; by default the one that the checks use.
    sections
        Further sections of the specs.

    Attributes
    ----------
    steps
        (K,) step sizes [s] of the K runs, coarsest first.
    position_errors, velocity_errors, multiplier_errors
        (K,) largest error at the end of each run, for multipliers relative to the largest one; NaN if the run failed.
    floor
        Rounding error of the reference.
    """

    def __init__(self, integrator: IntegratorUnderTest, problem: str, formulation: str | None = None, **sections: Any):
        state, multipliers, self.floor = reference(problem)
        formulation = formulation or integrator.formulation
        claimed = integrator.claims.orders_on(formulation)
        assert claimed is not None
        self.order = max(claimed.positions, claimed.velocities)
        steps, errors, end = [], [], ENDS[problem]
        for number in numbers_of_steps(integrator, min(order for order in claimed if order is not None)):
            time = {"end": end, "step": end / number}
            sections |= {"output": {"every": 10**9}, "formulation": formulation}
            with integrator.run(PROBLEMS[problem], time, **sections) as run:
                of_positions, of_velocities = (float(np.max(np.abs(x))) for x in np.split(final_state(run) - state, 2))
                of_multipliers = math.nan
                if claimed.multipliers is not None and run.status == "complete":
                    own = run.array("constraints/method_multiplier")[-1]
                    of_multipliers = float(np.max(np.abs(own - multipliers)) / np.max(np.abs(multipliers)))
                errors.append((of_positions, of_velocities, of_multipliers))
            steps.append(end / number)
            if max(errors[-1][:2]) < 10 * self.floor:
                break
            if number >= MOST_PYTHON_STEPS and self.order < 2 and _shown(self.order, steps, errors, self.floor):
                break
        self.steps = np.array(steps)
        self.position_errors, self.velocity_errors, self.multiplier_errors = np.array(errors).T

    @property
    def errors(self) -> np.ndarray:
        """Largest error of any position or velocity (K,)."""
        return np.asarray(np.maximum(self.position_errors, self.velocity_errors))

    @property
    def observed(self) -> ObservedOrder:
        """The observed order of positions and velocities."""
        return self.observed_in(self.errors)

    def observed_in(self, errors: np.ndarray) -> ObservedOrder:
        """Return the observed order of errors (K,) of positions or velocities."""
        return observed_order(self.steps, errors, floor=self.floor, fewest=4 if self.order > HIGH else 3)

    @property
    def completed(self) -> tuple[np.ndarray, np.ndarray]:
        """The step sizes of completed runs with errors, and these errors, of positions and velocities."""
        keep = np.isfinite(self.errors) & (self.errors > 0)
        return self.steps[keep], self.errors[keep]

    @property
    def slope_at_finest(self) -> float:
        """The order at the finest of more than `FINEST` steps."""
        steps, errors = self.completed
        return float(np.log(errors[-1] / errors[-1 - FINEST]) / np.log(steps[-1] / steps[-1 - FINEST]))

    @property
    def observed_of_multipliers(self) -> ObservedOrder:
        """The observed order of the multipliers, down to the smallest error, because rounding grows as steps become
        smaller.
        """
        errors = self.multiplier_errors
        some = slice(0, 1 + int(np.nanargmin(errors))) if np.isfinite(errors).any() else slice(None)
        return observed_order(self.steps[some], errors[some])


def numbers_of_steps(integrator: IntegratorUnderTest, order: float) -> Iterator[int]:
    """Yield increasing numbers of steps; from one to the next, the error of a method of this order falls fourfold.

    Step sizes are at most halved each time, so that the error of a method of an order below 2 falls less. The errors of
    such a method follow a power of the step only in small steps, of which even methods in Python take many.
    """
    ratio = min(2.0, max(4.0 ** (1 / order), 1.05))
    most = MOST_PYTHON_STEPS if order >= 2 and isinstance(integrator.method(), StepMethod) else MOST_STEPS
    exact = float(FIRST_STEPS)
    while exact <= most:
        yield round(exact)
        exact = max(exact * ratio, round(exact) + 1)


def _shown(order: float, steps: list[float], errors: Sequence[Sequence[float]], floor: float) -> bool:
    """Return whether the errors of positions and velocities follow the power of the step that belongs to an order."""
    largest = np.max(np.array(errors)[:, :2], axis=1)
    return observed_order(np.array(steps), largest, floor=floor).order >= order - BELOW


def convergence(integrator: IntegratorUnderTest, problem: str) -> Convergence:
    """Return the errors on a problem, cached."""
    return integrator.cached(f"convergence on {problem}", lambda: Convergence(integrator, problem))


def compare_orders(claimed: float, observed: ObservedOrder, errors: np.ndarray, what: str = "order") -> Result:
    """Compare an observed order with the claimed one; return the result of the check."""
    finite = errors[np.isfinite(errors)]
    if len(finite) == 0:
        return failed("no run completed at any step size")
    figures = {"claimed": claimed, "smallest_error": float(finite.min())}
    if not observed.found:
        if claimed > HIGH and finite.min() < 1e-12:
            return skipped("its errors reach rounding before they follow a power of the step", **figures)
        return failed(f"it claims {what} {claimed:g}, but its errors follow no power of the step", **figures)
    figures = {
        "measured": round(observed.order, 3),
        "coarsest": observed.steps[0],
        "finest": observed.steps[-1],
        **figures,
    }
    if claimed > HIGH and claimed - BELOW_HIGH < observed.order < claimed - BELOW:
        return skipped("its errors reach rounding before they follow that power of the step closely", **figures)
    if observed.order < claimed - BELOW:
        return failed(f"it claims {what} {claimed:g}, but the observed one is {observed.order:.2f}", **figures)
    if observed.order > claimed + ABOVE:
        return warned(f"it claims {what} {claimed:g}, but the observed one is {observed.order:.2f}", **figures)
    return passed(**figures).within({"measured": f"from {claimed - BELOW:g} to {claimed + ABOVE:g}"})


def _on(problem: str) -> Check[IntegratorUnderTest]:
    def observed(integrator: IntegratorUnderTest) -> Result:
        claimed = integrator.order
        result = convergence(integrator, problem)
        found = compare_orders(claimed, result.observed, result.errors)
        if found.outcome == "fail" and "measured" not in found.figures and len(result.completed[0]) > FINEST:
            return failed(found.cause, measured=round(result.slope_at_finest, 2), **found.figures)
        return found

    observed.__doc__ = (
        f"The error on the {problem.replace('-', ' ')}, nonlinear and non-autonomous, converges with the claimed order."
    )
    return Check(f"order.{problem}", observed, slow=problem == "driven-pendulum")


@check("order.multipliers")
def multipliers(integrator: IntegratorUnderTest) -> Result:
    """The method's own multipliers converge with the order claimed for them."""
    if (claimed := integrator.claims.multiplier_order) is None:
        raise Skip("it claims no order of multipliers")
    result = convergence(integrator, "forced-pendulum")
    return compare_orders(claimed, result.observed_of_multipliers, result.multiplier_errors, "order of multipliers")


@check("order.formulations", slow=True)
def formulations(integrator: IntegratorUnderTest) -> Result:
    """With each other formulation that the method claims, positions, velocities and multipliers converge as claimed."""
    claimed_names = (name for name in integrator.claims.formulations if name != integrator.formulation)
    # those with options apply to loops, which the model of this check does not have
    if not (others := [name for name in claimed_names if choice_of(name) == name]):
        raise Skip(f"it claims only {integrator.formulation}")
    if integrator.claims.adaptive:
        raise Skip("it is adaptive and claims no order")
    figures: dict[str, Figure] = {}
    remark = ""
    for name in others:
        claimed = integrator.claims.orders_on(name)
        assert claimed is not None
        result = Convergence(integrator, "forced-pendulum", name)
        seen = []
        kinds = [
            ("positions", claimed.positions, result.position_errors),
            ("velocities", claimed.velocities, result.velocity_errors),
        ]
        if claimed.positions == claimed.velocities:
            # The smaller ones may reach rounding before they follow a power of the step h: with dop853, the largest
            # error of positions is about 4.4 h^8 (1 - 13 h).
            kinds = [("positions and velocities", claimed.positions, result.errors)]
        for what, order, errors in (*kinds, ("multipliers", claimed.multipliers, result.multiplier_errors)):
            if order is None:
                continue
            observed = result.observed_of_multipliers if what == "multipliers" else result.observed_in(errors)
            finding = compare_orders(order, observed, errors, f"order of {what}")
            if finding.outcome == "fail":
                return failed(f"on {name} {finding.cause}", **finding.figures)
            if finding.outcome == "warn":
                remark = remark or f"on {name} {finding.cause}"
            seen.append(f"{observed.order:.2f}")
        figures[name] = "/".join(seen)
    return warned(remark, **figures) if remark else passed(**figures)


@check("order.finest")
def finest(integrator: IntegratorUnderTest) -> Result:
    """The order holds at the finest steps until errors approach rounding."""
    order, result = integrator.order, convergence(integrator, "forced-pendulum")
    _, errors = result.completed
    if len(errors) <= FINEST:
        raise Skip("too few runs completed")
    smallest, slope = float(errors.min()), result.slope_at_finest
    if slope < order - 0.5 and errors[-1] > NEAR_ROUNDING:
        return failed(
            f"at the finest steps its order is only {slope:.2f}, at an error of {errors[-1]:.1g}",
            slope_at_finest=slope,
            smallest_error=smallest,
        )
    return passed(slope_at_finest=round(slope, 2), smallest_error=smallest)


def error_at_tolerance(
    integrator: IntegratorUnderTest, problem: str, rtol: float, state: np.ndarray, **sections: Any
) -> float:
    """Return the largest error of a run with the tolerance `rtol` at its end, where the reference is `state`."""
    with _run_at_tolerance(integrator, problem, rtol, **sections) as run:
        return float(np.max(np.abs(final_state(run) - state)))


def _run_at_tolerance(integrator: IntegratorUnderTest, problem: str, rtol: float, **sections: Any) -> Run:
    options, time = integrator.tolerances(rtol), {"end": ENDS[problem]}
    return integrator.run(PROBLEMS[problem], time, options=options, output={"every": 10**9}, **sections)


@check("order.polynomials")
def polynomials(integrator: IntegratorUnderTest) -> Result:
    """One step of a method of order p gives the exact velocity and position of a mass if they are polynomials of a
    degree of at most p in time.
    """
    order = int(integrator.order)
    worst, first = 0.0, None
    for power in range(order):
        with integrator.run(pushed(power), {"end": 1.0, "step": 1.0}) as run:
            require_complete(run, "the run of a free mass")
            body = run["mass"]
            defect = abs(float(body.velocity[-1, 0]) - 1 / (power + 1))
            if power < order - 1:
                defect = max(defect, abs(float(body.position[-1, 0]) - 1 / ((power + 1) * (power + 2))))
        worst = max(worst, defect)
        if defect > POLYNOMIAL and first is None:
            first = power
    if first is None:
        return passed(degree=order, defect=worst).within({"defect": POLYNOMIAL})
    cause = f"under the force t^{first} one step of 1 s is not exact, as order {order} requires"
    if isinstance(integrator.method(), StepMethod):
        if has_memory(integrator):
            raise Skip(f"{cause}, but this is its first step, which may be of lower order because it has no history")
        return warned(f"{cause} of methods that are linear in the forces", defect=worst)
    return failed(cause, defect=worst)


def _errors_of_tolerances(integrator: IntegratorUnderTest, problem: str, **sections: object) -> Result:
    """Compare the errors of runs with `TOLERANCES`."""
    if "rtol" not in integrator.plugin.options.model_fields:
        raise Skip("it has no option `rtol`")
    state, _, floor = reference(problem)
    errors = [error_at_tolerance(integrator, problem, rtol, state, **sections) for rtol in TOLERANCES]
    return _obeys(errors, (100 * floor,) * 4, "its error does not decrease with the tolerance")


def _obeys(errors: Sequence[float], floors: Sequence[float], cause: str) -> Result:
    """Return whether errors of runs with `TOLERANCES` decrease to their floors; `cause` says that they do not."""
    figures = {f"error_at_{rtol:g}": error for rtol, error in zip(TOLERANCES, errors, strict=True)}
    if not np.all(np.isfinite(errors)):
        return failed("a run did not complete", **figures)
    for coarse, fine, floor in zip(errors, errors[2:], floors[2:], strict=False):
        if fine > max(coarse / OBEYS, floor):
            return failed(cause, **figures)
    return passed(**figures)


@check("order.projection", slow=True)
def projected(integrator: IntegratorUnderTest) -> Result:
    """With a projection after each step, errors on the forced pendulum converge with the claimed order, or decrease
    with the tolerance.
    """
    if "projection" not in integrator.claims.stabilizations:
        raise Skip("it does not claim projection")
    sections = {"stabilization": "projection"}
    if integrator.claims.adaptive:
        return _errors_of_tolerances(integrator, "forced-pendulum", **sections)
    result = Convergence(integrator, "forced-pendulum", **sections)
    return compare_orders(integrator.order, result.observed, result.errors)


@check("tolerance.multipliers")
def multipliers_at_tolerance(integrator: IntegratorUnderTest) -> Result:
    """The multipliers that an adaptive method in Python computes itself converge as the tolerance decreases, or have an
    error below its square root: that of iterations exceeds the one of positions by a square of the step.
    """
    if not integrator.claims.adaptive or not getattr(integrator.method(), "carries_multipliers", False):
        raise Skip("it is not an adaptive method in Python with multipliers of its own")
    exact, floors = reference("forced-pendulum")[1], [math.sqrt(rtol) for rtol in TOLERANCES]
    errors = [_of_multipliers(integrator, rtol, exact) for rtol in TOLERANCES]
    return _obeys(errors, floors, "the error of its multipliers does not decrease with the tolerance")


def _of_multipliers(integrator: IntegratorUnderTest, rtol: float, exact: np.ndarray) -> float:
    """Return the largest error of the method's own multipliers at the end of a run, as a share of the largest one."""
    with _run_at_tolerance(integrator, "forced-pendulum", rtol) as run:
        if run.status != "complete":
            return math.nan
        return float(np.max(np.abs(run.array("constraints/method_multiplier")[-1] - exact)) / np.max(np.abs(exact)))


def _with_tolerance(problem: str) -> Check[IntegratorUnderTest]:
    def obeys(integrator: IntegratorUnderTest) -> Result:
        if not integrator.claims.adaptive:
            raise Skip("it has fixed steps")
        return _errors_of_tolerances(integrator, problem)

    obeys.__doc__ = f"The error on the {problem.replace('-', ' ')} decreases with the tolerance."
    return Check(f"tolerance.{problem}", obeys, slow=problem == "driven-pendulum")


@check("tolerance.variable-order")
def variable_order(integrator: IntegratorUnderTest) -> Result:
    """The order of a method of variable order rises as the tolerance decreases: the number of steps grows less and
    less, each step of an explicit method evaluates more, or the steps report higher orders of their error estimates.
    """
    claims = integrator.claims
    if not claims.adaptive or "rtol" not in integrator.plugin.options.model_fields:
        raise Skip("it is not an adaptive method with the option `rtol`")
    counts, costs = list[int](), list[float]()
    for rtol in COUNTED_TOLERANCES:
        options = integrator.tolerances(rtol)
        with integrator.run(ORBIT, {"end": 40.0}, options=options, output={"every": 10**9}) as run:
            if claims.variable_order and run.status != "complete":
                return failed(f"it claims variable order, but a run with rtol = {rtol:g} stopped: {run.status_reason}")
            require_complete(run)
            counts.append(int(run.stats["accepted"]))
            is_explicit = not run.stats["jacobian_evaluations"]
            costs.append(run.stats["rhs_evaluations"] / (counts[-1] + run.stats["rejected"]))
    # the number of steps of a method of order p is proportional to rtol^(-1/(p + 1))
    exponents = -np.diff(np.log(COUNTED_TOLERANCES)) / np.maximum(np.diff(np.log(counts)), NO_GROWTH)
    loose, tight = float(exponents[0]), float(exponents[-1])
    figures = {"order_at_loose": round(loose - 1, 2), "order_at_tight": round(tight - 1, 2)}
    if not claims.variable_order:
        return unclaimed(**figures)
    rises = tight > RISES * loose or (is_explicit and costs[-1] > RISES * costs[0])
    if not rises:  # so it may be where the order rises between two of the tolerances, and reaches its limit
        few, many = (_reported_order(integrator, rtol) for rtol in (COUNTED_TOLERANCES[0], COUNTED_TOLERANCES[-1]))
        rises = many > few + REPORTED
    if not rises:
        return failed("it claims variable order, but its number of steps follows one power of the tolerance", **figures)
    return passed(**figures)


def _reported_order(integrator: IntegratorUnderTest, rtol: float) -> float:
    """Return the mean of the orders that the steps of a method in Python report; 0 if they report none."""
    method = integrator.method(**integrator.tolerances(rtol))
    if not isinstance(method, StepMethod):
        return 0.0
    orders, step = list[float](), method.step

    def watched(*arguments: Any) -> Any:
        result = step(*arguments)
        orders.append(getattr(result, "next_order", None) or 0.0)
        return result

    object.__setattr__(method, "step", watched)
    drive(integrator.stepper(integrator.workspace(ORBIT), 40.0, 1, method=method))
    return float(np.mean(orders))


@check("order.states")
def states(integrator: IntegratorUnderTest) -> Result:
    """First-order states that depend on the motion, and drive it, converge with the claimed order or a higher one."""
    claimed = integrator.order
    if not integrator.claims.states:
        raise Skip("it does not claim to integrate first-order states")
    steps, errors, exact = list[float](), list[float](), _states_at_end()
    for number in numbers_of_steps(integrator, claimed):
        time = {"end": 1.0, "step": 1.0 / number}
        with integrator.run(LAGGING_PENDULUM, time, output={"every": 10**9}) as run:
            value = run.array("states/value")[-1] if run.status == "complete" else math.nan
        steps.append(1.0 / number)
        errors.append(float(np.max(np.abs(value - exact))))
        observed = observed_order(np.array(steps), np.array(errors), floor=STATES_FLOOR)
        result = len(observed.steps)
        if errors[-1] < 10 * STATES_FLOOR or result > 5 or (result > 3 and observed.order > claimed - BELOW):
            break
    if observed.order > claimed + ABOVE:
        return passed(claimed=claimed, measured=round(observed.order, 3))
    return compare_orders(claimed, observed, np.array(errors))


@cache
def _states_at_end() -> np.ndarray:
    """Return the first-order states of the test problem after 1 s, by Gauss collocation of order 12."""
    with _precise_run(LAGGING_PENDULUM, 1.0, 60) as run:
        value: np.ndarray = run.array("states/value")[-1].copy()
    return value


@check("tolerance.own-control")
def own_control(integrator: IntegratorUnderTest) -> Result:
    """A method that rejects its own steps asks for smaller ones, and accepts one after finitely many attempts."""
    method, (equations, state) = step_method(integrator), equations_for(integrator, model_for(integrator))
    state = replace(state, memory=method.begin(equations, equations.t0, state, "start"))
    size, rejected = LARGEST_TRIAL, 0
    for _ in range(MOST_TRIALS):
        try:
            result = step_of(method, equations, equations.t0, state, size)
        except StepError:
            size /= 2
            continue
        if result.accepted:
            break
        wanted = size / 2 if result.next_step is None else result.next_step
        if not 0.0 < wanted < size:
            return failed(f"it rejects a step of {size:g} s and asks for one of {wanted:g} s, no smaller one")
        size, rejected = wanted, rejected + 1
    else:
        return failed(f"it accepts none of {MOST_TRIALS} attempts, the last of {size:.3g} s")
    if result.error is not None or (result.next_step is None and not rejected):
        raise Skip("it leaves the control of its steps to the framework")
    return passed(rejected=rejected, accepted_size=size)


CHECKS = (
    polynomials,
    *(_on(problem) for problem in USUAL),
    finest,
    multipliers,
    formulations,
    projected,
    *(_with_tolerance(problem) for problem in (*USUAL, "linear-oscillators")),
    multipliers_at_tolerance,
    variable_order,
    states,
    own_control,
)
