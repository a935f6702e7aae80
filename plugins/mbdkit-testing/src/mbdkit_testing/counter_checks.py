"""Checks that the counters of a run are correct, and measures the cost of a step, which has no limit."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from copy import copy
from typing import Any

import numpy as np
import scipy.integrate

from mbdkit.base.errors import MbdkitError
from mbdkit.base.text import listed
from mbdkit.engine.counters import Counters
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.formulation import FORMULATIONS
from mbdkit.integrators.host.step_host import StepHost
from mbdkit.methods.scipy_solver import SciPySolver
from mbdkit.methods.step_methods import ExternalMethod, StepMethod
from mbdkit_report import worst_history
from mbdkit_testing.check import check
from mbdkit_testing.check_result import Result, failed, passed, skipped, warned
from mbdkit_testing.drift_checks import EXACT, must_hold
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, drive, require_complete
from mbdkit_testing.invariant_checks import coarse_step
from mbdkit_testing.trial_models import COASTING, DRIVEN_PENDULUM, FORCED_PENDULUM

STEPS = 17
#: Tolerance of adaptive methods at which joints drift visibly, and a factor by which misalignment only falls in a step
#: that moves states onto the constraints.
LOOSE, FALL = 1e-3, 1e-3


#: Methods of `EquationsOfMotion` by the counter to which each of their calls adds 1.
COUNTED = {
    "rhs_evaluations": ("accelerations", "derivatives", "residual"),
    "projections": ("project", "project_positions", "project_velocities"),
    "jacobian_evaluations": ("_evaluate_tangents",),
    "factorizations of iteration matrices": ("_factorized",),
}


class InstrumentedEquations(EquationsOfMotion):
    """Equations of motion that count their evaluations independently of the counters of a run."""

    def __init__(self, workspace: Any):
        self.seen: Counter[str] = Counter()
        for counter, names in COUNTED.items():
            for name in names:
                setattr(self, name, self._counting(counter, getattr(super(), name)))
        super().__init__(workspace)

    def _counting(self, counter: str, method: Callable[..., object]) -> Callable[..., object]:
        def call(*arguments: object, **named: object) -> object:
            self.seen[counter] += 1
            return method(*arguments, **named)

        return call


@check("honesty.counters")
def counters(integrator: IntegratorUnderTest) -> Result:
    """The counters of a run agree with those of instrumented equations of motion."""
    method = integrator.method()
    workspace = integrator.workspace(FORCED_PENDULUM)
    if isinstance(method, SciPySolver):
        return _of_solver(integrator, method)
    stepper = integrator.stepper(workspace, 0.2, STEPS, method=method)
    adaptive = integrator.claims.adaptive
    seen: dict[str, int] = {} if adaptive else {"steps": STEPS, "accepted": STEPS, "rejected": 0}
    instrumented = None
    if isinstance(stepper, StepHost):
        instrumented = InstrumentedEquations(workspace)
        stepper.use(instrumented)
    drive(stepper)
    if instrumented is not None:
        asked = instrumented.seen
        seen |= {name: asked[name] for name in ("rhs_evaluations", "jacobian_evaluations", "projections")}
    elif not adaptive and method.traits.is_explicit and (tableau := method.traits.tableau) is not None:
        evaluations = STEPS * tableau.stages - (STEPS - 1) * tableau.is_first_same_as_last
        seen |= {"rhs_evaluations": evaluations, "jacobian_evaluations": 0, "newton_iterations": 0}
    said = stepper.counters
    if wrong := {name: count for name, count in seen.items() if getattr(said, name) != count}:
        return _wrong(said, wrong)
    if instrumented is not None and said.factorizations < instrumented.seen["factorizations of iteration matrices"]:
        return failed(f"its counters say {said.factorizations} factorizations, fewer than it requested")
    return passed(rhs_evaluations=said.rhs_evaluations, jacobian_evaluations=said.jacobian_evaluations)


def _of_solver(integrator: IntegratorUnderTest, made: Any) -> Result:
    base = getattr(scipy.integrate, made.solver) if isinstance(made.solver, str) else made.solver
    seen: Counter[str] = Counter()

    def instrumented(fun: Any, t0: float, y0: np.ndarray, end: float, **options: Any) -> Any:
        def counted(t: float, y: np.ndarray) -> object:
            seen["rhs_evaluations"] += 1
            return fun(t, y)

        if "jac" in options:
            jacobian = options["jac"]

            def counted_jacobian(t: float, y: np.ndarray) -> object:
                seen["jacobian_evaluations"] += 1
                return jacobian(t, y)

            options["jac"] = counted_jacobian
        return base(counted, t0, y0, end, **options)

    method = copy(made)
    method.solver = instrumented
    stepper = integrator.stepper(integrator.workspace(FORCED_PENDULUM), 1.0, STEPS, method=method)
    drive(stepper)
    said = stepper.counters
    if wrong := {name: count for name, count in seen.items() if getattr(said, name) < count}:
        return _wrong(said, wrong)
    return passed(rhs_evaluations=said.rhs_evaluations, steps=said.steps)


def _wrong(said: Counters, seen: Mapping[str, int]) -> Result:
    texts = [f"{name} {getattr(said, name)} instead of {count}" for name, count in seen.items()]
    return failed(f"its counters say {listed(texts, 'and')}")


@check("honesty.rows")
def rows(integrator: IntegratorUnderTest) -> Result:
    """The counters of all recorded intervals add up to those of the run."""
    with integrator.run(FORCED_PENDULUM, {"end": 0.3, "step": 0.01}, output={"every": 7}) as run:
        require_complete(run, error=MbdkitError)
        stats = run.stats
        for column, name in (("steps", "steps"), ("iterations", "newton_iterations"), ("rejected", "rejected")):
            if (total := int(np.sum(run.array(f"steps/{column}")))) != stats[name]:
                return failed(f"intervals sum up to {total} {column}, the run says {stats[name]}")
        if stats["accepted"] + stats["rejected"] < stats["steps"]:
            return failed(
                f"{stats['steps']} steps are not {stats['accepted']} accepted and {stats['rejected']} rejected"
            )
    return passed(steps=int(stats["steps"]))


@check("honesty.needs")
def needs(integrator: IntegratorUnderTest) -> Result:
    """The method uses tangents if and only if its claims name them in `needs`."""
    with integrator.run(FORCED_PENDULUM, {"end": 0.2, "step": 0.01}) as run:
        require_complete(run)
        used = run.stats["jacobian_evaluations"] > 0
    said = "tangents" in integrator.claims.needs
    if used and not said:
        return failed("it uses tangents, which `needs` does not name")
    if said and not used and not integrator.claims.adaptive:
        return warned("`needs` names tangents, but it did not use them here")
    return passed(tangents="yes" if used else "no")


@check("honesty.projections")
def projections(integrator: IntegratorUnderTest) -> Result:
    """The method does not move states onto the constraints, by `equations` or by itself, unless it claims so or the
    formulation solves for multipliers: otherwise, the spec chooses the stabilization.
    """
    if not isinstance(integrator.method(), StepMethod | ExternalMethod):
        return skipped("its steps are those of the framework or of SciPy, which do not project")
    if FORMULATIONS[integrator.formulation].solves_multipliers:
        return skipped(f"{integrator.formulation} may need projections")
    for step in (coarse_step(integrator), coarse_step(integrator) / 4):
        time = {"end": 2.0, "step": step}
        with integrator.run(DRIVEN_PENDULUM, time, options=integrator.tolerances(LOOSE)) as run:
            count, speeds = int(run.stats["projections"]), run.array("joints/velocity_misalignment")
            histories = {"position": worst_history(run), "velocity": np.max(speeds, axis=1)}
            if count:
                return failed("it projects, a stabilization that the spec did not request", projections=count)
            if run.status == "complete":
                break
    for level, history in histories.items():
        later = history[len(history) // 2 :]  # after visible drift
        falls = (later[1:] < EXACT) | (later[1:] < FALL * later[:-1])
        if np.any(falls) and not must_hold(integrator, level):
            cause = f"it moves states onto the constraints at {level} level, a stabilization that it does not claim"
            return failed(cause, steps=int(np.sum(falls)))
    return passed(projections=count)


@check("cost.step")
def cost_of_a_step(integrator: IntegratorUnderTest) -> Result:
    """Processor time and evaluations per step on two rods without forces; reported without a limit."""
    best = float("inf")
    for _ in range(3):
        stepper = integrator.stepper(integrator.workspace(COASTING), 3.0, 300)
        begin = time.thread_time()  # the clock of the process ticks in 10 ms while its time is limited
        drive(stepper)
        best = min(best, time.thread_time() - begin)
    made = stepper.counters
    return passed(
        us_per_step=round(1e6 * best / made.steps, 2),
        rhs_per_step=round(made.rhs_evaluations / made.steps, 2),
        iterations_per_step=round(made.newton_iterations / made.steps, 2),
    )


CHECKS = (counters, rows, needs, projections, cost_of_a_step)
