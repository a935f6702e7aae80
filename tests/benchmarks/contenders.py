"""The double pendulum released from the horizontal, in mbdkit, MuJoCo, CasADi and Exudyn: L = 1 m, m = 1 kg, 5 s.

Every contender is a function of the number of steps that returns the seconds of the stepping alone and the end of
rod 2. Models are built beforehand, nothing is recorded on the way, and all loops over steps are in compiled code.
"""

from __future__ import annotations

import importlib.util
import math
import time
from collections.abc import Callable
from typing import Any

import mbdkit

from .exudyn_model import by_exudyn
from .frames import chain

END = 5.0
G = 9.81
Outcome = tuple[float, tuple[float, float]]
Contender = Callable[[int], Outcome]


def tip(x: float, y: float, angle: float) -> tuple[float, float]:
    """Return the outer end of a rod of 1 m from its centre [m] and angle [rad]."""
    return x + 0.5 * math.cos(angle), y + 0.5 * math.sin(angle)


def end_of(first: float, second: float) -> tuple[float, float]:
    """Return the end of rod 2 from both absolute angles [rad]."""
    return math.cos(first) + math.cos(second), math.sin(first) + math.sin(second)


def fixed_step(integrator: dict[str, Any]) -> Contender:
    """Return mbdkit with a fixed-step method; the seconds are its own, from the first step to the last."""

    def contender(steps: int) -> Outcome:
        return _mbdkit(integrator, {"end": END, "step": END / steps}, steps)

    return contender


def adaptive(name: str) -> Contender:
    """Return mbdkit with an adaptive method; "steps" are the negative decimal exponent of the tolerance, times ten."""

    def contender(steps: int) -> Outcome:
        tolerance = 10.0 ** (-steps / 10.0)
        return _mbdkit({"name": name, "rtol": tolerance, "atol": tolerance}, {"end": END}, 10_000_000)

    return contender


def _mbdkit(integrator: dict[str, Any], times: dict[str, Any], every: int) -> Outcome:
    run = mbdkit.run(
        {
            "mbdkit": 1,
            "model": {"name": "double-pendulum"},
            "integrator": integrator,
            "time": times,
            "output": {"every": every, "quantities": []},
        }
    )
    if run.status != "complete":  # too large a step for Newton's method: this many steps do not reach the target
        return float(run.stats["wall_s"]), (math.nan, math.nan)
    rod = run["rod2"]
    return float(run.stats["wall_s"]), tip(float(rod.position[-1, 0]), float(rod.position[-1, 1]), float(rod.angle[-1]))


MUJOCO = """<mujoco>
  <compiler angle="radian" inertiafromgeom="false"/>
  <option integrator="RK4" timestep="{step!r}" gravity="0 0 -9.81"><flag constraint="disable"/></option>
  <worldbody>
    <body name="rod1">
      <inertial pos="0.5 0 0" mass="1" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>
      <joint type="hinge" axis="0 -1 0"/>
      <body name="rod2" pos="1 0 0">
        <inertial pos="0.5 0 0" mass="1" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>
        <joint type="hinge" axis="0 -1 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""


def mujoco_rk4() -> Contender:
    """Return MuJoCo's RK4 in joint coordinates, constraint solver off; `mj_step(nstep=...)` has the loop in C."""
    import mujoco

    def contender(steps: int) -> Outcome:
        model = mujoco.MjModel.from_xml_string(MUJOCO.format(step=END / steps, inertia=1.0 / 12.0))
        data = mujoco.MjData(model)
        start = time.perf_counter()
        mujoco.mj_step(model, data, nstep=steps)
        taken = time.perf_counter() - start
        return taken, end_of(float(data.qpos[0]), float(data.qpos[0] + data.qpos[1]))

    return contender


def casadi_folded(stages: int) -> Contender:
    """Return a collocation step of mbdkit's own equations with CasADi's Newton method, repeated by `fold`."""
    import casadi

    from tests.witness.casadi_gauss import RodChain

    chain = RodChain(2)
    q, v = chain.start(0.0)
    step = chain.step(stages)
    unknowns = 5 * chain.count * stages
    start_state = casadi.vertcat(q, v, casadi.DM.zeros(unknowns))

    def contender(steps: int) -> Outcome:
        x = casadi.MX.sym("x", 12 + unknowns)
        once = casadi.Function("once", [x], [casadi.vertcat(*step(x[:6], x[6:12], x[12:], END / steps))])
        run = once.fold(steps)
        start = time.perf_counter()
        result = run(start_state)
        taken = time.perf_counter() - start
        return taken, tip(float(result[3]), float(result[4]), float(result[5]))

    return contender


def casadi_integrator(stages: int) -> Contender:
    """Return CasADi's `integrator("collocation")` on mbdkit's own equations: absolute coordinates, index-1."""
    import casadi

    from tests.witness.casadi_gauss import RodChain

    chain = RodChain(2)
    q, v = chain.start(0.0)
    names = {"q": 6, "v": 6, "a": 6, "multipliers": 4}
    place, speed, push, multipliers = (casadi.SX.sym(name, size) for name, size in names.items())
    dynamics, constraint = chain.equations()(place, speed, push, multipliers)
    problem = {
        "x": casadi.vertcat(place, speed),
        "z": casadi.vertcat(push, multipliers),
        "ode": casadi.vertcat(speed, push),
        "alg": casadi.vertcat(dynamics, constraint),
    }
    start_state = casadi.vertcat(q, v)

    def contender(steps: int) -> Outcome:
        run = casadi.integrator("run", "collocation", problem, 0.0, END, _collocation(stages, steps, 1e-10))
        start = time.perf_counter()
        result = run(x0=start_state, z0=0.0)["xf"]
        taken = time.perf_counter() - start
        return taken, tip(float(result[3]), float(result[4]), float(result[5]))

    return contender


def _collocation(stages: int, steps: int, tolerance: float) -> dict[str, Any]:
    return {
        "collocation_scheme": "legendre",
        "interpolation_order": stages,
        "number_of_finite_elements": steps,
        "rootfinder": "newton",
        "rootfinder_options": {"abstol": tolerance},
    }


def casadi_angles(stages: int) -> Contender:
    """Return CasADi's `integrator("collocation")` on the two angles: four states, no multipliers."""
    import casadi

    angles, rates = casadi.SX.sym("angles", 2), casadi.SX.sym("rates", 2)
    coupling, sine = 0.5 * casadi.cos(angles[0] - angles[1]), 0.5 * casadi.sin(angles[0] - angles[1])
    first = -1.5 * G * casadi.cos(angles[0]) - sine * rates[1] ** 2
    second = -0.5 * G * casadi.cos(angles[1]) + sine * rates[0] ** 2
    determinant = 4.0 / 9.0 - coupling**2
    accelerations = casadi.vertcat(first / 3.0 - coupling * second, second * 4.0 / 3.0 - coupling * first) / determinant
    problem = {"x": casadi.vertcat(angles, rates), "ode": casadi.vertcat(rates, accelerations)}

    def contender(steps: int) -> Outcome:
        run = casadi.integrator("run", "collocation", problem, 0.0, END, _collocation(stages, steps, 1e-12))
        start = time.perf_counter()
        result = run(x0=[0.0, 0.0, 0.0, 0.0])["xf"]
        taken = time.perf_counter() - start
        return taken, end_of(float(result[0]), float(result[1]))

    return contender


def exudyn_alpha() -> Contender:
    """Return Exudyn's implicit second-order solver in its best setting found for this task.

    Generalized-alpha with spectral radius 1 and index-2 constraints, that is Newmark's trapezoidal rule with full
    Newton and dense matrices; with index-3 constraints rounding grows with the number of steps and spoils 1e-6 m.
    """
    mechanism = chain(2)

    def contender(steps: int) -> Outcome:
        taken, bodies = by_exudyn(mechanism, steps, END, sparse=False)
        x, y, angle = bodies[-1]
        return taken, tip(float(x), float(y), float(angle))

    return contender


def all_contenders() -> dict[str, tuple[Contender, int]]:
    """Return the contenders whose code is installed, each with the number of steps to begin the search with."""
    found: dict[str, tuple[Contender, int]] = {
        "mbdkit rk4": (fixed_step({"name": "rk4"}), 400),
        "mbdkit rk-gill": (fixed_step({"name": "rk-gill"}), 400),
    }
    for stages, steps in ((1, 8000), (2, 400), (3, 150), (4, 80), (5, 60), (6, 40)):
        found[f"mbdkit gauss-{stages}"] = (fixed_step({"name": "gauss", "stages": stages}), steps)
    for name in ("scipy-dop853", "scipy-radau", "scipy-lsoda"):
        found[f"mbdkit {name}"] = (adaptive(name), 50)
    if importlib.util.find_spec("mujoco"):
        found["MuJoCo rk4"] = (mujoco_rk4(), 400)
    if importlib.util.find_spec("casadi"):
        for stages, steps in ((2, 400), (3, 150)):
            found[f"CasADi gauss-{stages}, same equations, integrator"] = (casadi_integrator(stages), steps)
            found[f"CasADi gauss-{stages}, same equations, folded step"] = (casadi_folded(stages), steps)
            found[f"CasADi gauss-{stages}, two angles, integrator"] = (casadi_angles(stages), steps)
    if importlib.util.find_spec("exudyn"):
        found["Exudyn generalized-alpha"] = (exudyn_alpha(), 20000)
    return found
