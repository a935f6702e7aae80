"""Requirements on every model: a repeatable mechanism, a consistent start, and consistent derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.motions import motions_at
from mbdkit.expressions.program import MAX_DEPTH
from mbdkit.mechanism.joints import Driver
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.runs.preparation import build
from mbdkit.runs.simulation import simulate
from mbdkit.spec.run_spec import RunSpec
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, at_most, failed, passed, skipped, warned
from mbdkit_testing.integrator_under_test import require_complete
from mbdkit_testing.item_checks import ItemUnderTest, relative_difference
from mbdkit_testing.options_under_test import options_result, results_of_variants, validated

END = 1.0
START = 1e-10  #: Largest residual of an initial state [m, rad, m/s, rad/s].
DERIVATIVE = 1e-6  #: Largest relative difference between a derivative and finite differences.


class ModelUnderTest(ItemUnderTest[Any]):
    """A model with parameters."""

    def spec(self, step: float, stages: int = 3) -> RunSpec:
        """Return the spec of a run with Gauss collocation."""
        gauss, time = {"name": "mbdkit:gauss", "stages": stages}, {"end": END, "step": step}
        return self.run_spec({"name": self.item.id, **self.options}, gauss, time)

    def mechanism(self) -> Mechanism:
        """Return a new mechanism."""
        return self.spec(0.01).mechanism()

    def equations(self) -> EquationsOfMotion:
        """Return the equations at the consistent start."""
        return EquationsOfMotion(build(self.spec(0.01))[0])


@check("model.options")
def options(model: ModelUnderTest) -> Result:
    """The model's parameters round-trip through JSON and have descriptions."""
    return options_result(model.plugin.options, model.options, "parameters")


@check("model.repeatable")
def repeatable(model: ModelUnderTest) -> Result:
    """Equal parameters give equal mechanisms and are not modified, and the mechanism round-trips through a spec."""
    given = validated(model.plugin.options, model.options)
    before = given.model_dump_json()
    first, second = model.plugin.build(given).to_spec(), model.plugin.build(given).to_spec()
    if given.model_dump_json() != before:
        return failed("it modified its parameters")
    if first != second:
        return failed("the same parameters give two different mechanisms")
    if Mechanism.from_spec(first).to_spec() != first:
        return failed("its mechanism changes in a round trip through a spec")
    return passed(bodies=len(first["bodies"]), joints=len(first.get("joints", {})))


@check("model.mass")
def mass(model: ModelUnderTest) -> Result:
    """Every mass is positive, and every inertia is positive or absent (a point mass)."""
    for name, body in model.mechanism().to_spec()["bodies"].items():
        inertia = body.get("inertia")
        if not body["mass"] > 0 or (inertia is not None and not inertia > 0):
            return failed(f"body '{name}' has mass {body['mass']} and inertia {inertia}")
    return passed()


@check("model.start")
def start(model: ModelUnderTest) -> Result:
    """The model's start satisfies all constraints in position and velocity, without a large correction."""
    workspace, assembled = build(model.spec(0.01))
    equations = EquationsOfMotion(workspace)
    t, q, v = equations.t0, equations.q0, equations.v0
    residual = float(np.max(np.abs(equations.constraints(t, q)), initial=0.0))
    rate = float(np.max(np.abs(equations.constraint_rates(t, q, v)), initial=0.0))
    moved = max(assembled.moved_position.values(), default=0.0) if assembled.changed else 0.0
    figures = {"residual": residual, "velocity_residual": rate, "moved_m": float(moved)}
    if max(residual, rate) > START:
        return failed("its start does not satisfy the constraints", **figures)
    if moved > 1e-3:
        return warned("its start had to be moved to satisfy the constraints", **figures)
    return passed(**figures).within({"residual": START, "velocity_residual": START, "moved_m": 1e-3})


@check("model.jacobian")
def jacobian(model: ModelUnderTest) -> Result:
    """Jacobian, rates and accelerations of the constraints agree with finite differences."""
    equations = model.equations()
    if equations.m == 0:
        raise Skip("it has no joints")
    worst, e = 0.0, 1e-5
    rng = np.random.default_rng(1)
    for _ in range(4):
        q, v, a = equations.q0 + 0.05 * rng.standard_normal(equations.n), *rng.standard_normal((2, equations.n))
        t = equations.t0 + 0.1 + 0.8 * END * rng.random()
        exact = equations.constraint_jacobian(t, q).toarray()
        columns = [
            (equations.constraints(t, q + e * x) - equations.constraints(t, q - e * x)) / (2 * e)
            for x in np.eye(equations.n)
        ]
        worst = max(worst, relative_difference(exact, np.array(columns).T))
        later, earlier = ((t + d, q + d * v + d * d / 2 * a, v + d * a) for d in (e, -e))
        slope = (equations.constraints(*later[:2]) - equations.constraints(*earlier[:2])) / (2 * e)
        worst = max(worst, relative_difference(equations.constraint_rates(t, q, v), slope))
        twice = (equations.constraint_rates(*later) - equations.constraint_rates(*earlier)) / (2 * e)
        worst = max(worst, relative_difference(exact @ a - equations.gamma(t, q, v), twice))
    return at_most(DERIVATIVE, "a derivative of its constraints differs from finite differences", difference=worst)


@check("model.drivers")
def drivers(model: ModelUnderTest) -> Result:
    """The rate of each driver's motion is the derivative of the motion, and the acceleration that of the rate."""
    compiled = build(model.spec(0.01))[0].mechanism
    driven = {name for name, joint in model.mechanism().joints.items() if isinstance(joint, Driver)}
    if not driven:
        raise Skip("it has no drivers")
    top = compiled.topology
    times = np.linspace(0.0, END, 2001)
    values = np.empty((len(times), len(top.motion_start) - 1, 3))
    motions_at(times, top.motion_start, top.motion_ops, top.motion_values, np.zeros((MAX_DEPTH, 3)), values)
    worst = 0.0
    for motion in compiled.drives.tolist():
        for level, what in ((0, "rate"), (1, "acceleration")):
            x, slope = values[:, motion, level], values[:, motion, level + 1]
            h = times[2] - times[0]
            gained = h / 6 * (slope[:-2:2] + 4 * slope[1:-1:2] + slope[2::2])
            missed = np.abs(np.diff(x[::2]) - gained)
            defect = float(missed.max() / max(1.0, float(np.max(np.abs(slope)))))
            worst = max(worst, defect)
            if defect > DERIVATIVE:
                at = float(times[::2][int(np.argmax(missed))])
                return failed(
                    f"the {what} of a driver's motion is not the derivative near t = {at:.3g} s", defect=defect
                )
    return passed(drivers=len(driven), defect=worst).within({"defect": DERIVATIVE})


@check("energy.balance")
def balance(model: ModelUnderTest) -> Result:
    """The energy balance of loads and drivers converges to zero with the step."""
    results, steps = [], (0.02, 0.01, 0.005, 0.0025)
    for step in steps:
        with simulate(model.spec(step, stages=2)) as run:
            if run.status != "complete":
                results.append(np.nan)
                continue
            size = max(1.0, float(np.max(np.abs(run.energy.kinetic))))
            results.append(float(np.max(np.abs(run.energy.balance))) / size)
    if not (last := [value for value in results if np.isfinite(value)]):
        return failed("no run completed")
    figures = {"coarsest": last[0], "finest": last[-1]}
    if last[-1] < 1e-9 or last[-1] < last[0] / 4 ** (len(last) - 1):
        return passed(**figures)
    if last[-1] < last[0] / 2:
        return warned("its energy balance converges slowly with the step; a force may not be smooth", **figures)
    return failed("its energy balance does not converge with the step", **figures)


@check("energy.run")
def completes(model: ModelUnderTest) -> Result:
    """A run of one second completes; its misalignment is reported."""
    with simulate(model.spec(0.002)) as run:
        require_complete(run, f"a run of {END:g} s", MbdkitError)
        return passed(misalignment_m=run.misalignment_max) if run.joints else skipped("it has no joints")


@check("model.other-options")
def other_options(model: ModelUnderTest) -> Result:
    """Other values of each parameter within its bounds build a mechanism with positive masses, or are refused."""

    def mass_of(name: str, chosen: dict[str, Any]) -> Result:
        return mass.function(ModelUnderTest(model.item, chosen, model.installed))

    return results_of_variants(model.item, model.options, mass_of, "parameter")


CHECKS = (options, other_options, repeatable, mass, start, jacobian, drivers, balance, completes)
