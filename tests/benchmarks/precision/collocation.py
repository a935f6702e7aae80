"""CasADi's collocation in the form that is its best: one step solved by its Newton method, repeated by `fold`.

Its own `integrator("collocation")`, measured by the section `race`, takes about twice as long, since it does not start
from the stages of the step before, and its round-off grows.
"""

from __future__ import annotations

import functools
import importlib.util
from typing import Any

import numpy as np

from .contender import Contender, Outcome, centres_of, lost, steps_from, timed
from .motions import Motion
from .rods import GRAVITY

STAGES = (3, 4, 5, 6)
FIRST = {2: 40, 100: 25}


def collocation(motion: Motion) -> tuple[list[Contender], list[str]]:
    """Return CasADi's contenders, or its name where it is not installed."""
    if not importlib.util.find_spec("casadi"):
        return [], ["CasADi"]
    forms = {"absolute coordinates": _absolute_folded}
    if motion.rods.count == 2:  # of a hundred angles the matrix is dense, and slower than the sparse one
        forms["angles"] = functools.partial(_angles_folded, 1e-12)
        forms["angles, to 1e-07"] = functools.partial(_angles_folded, 1e-7)
    found = []
    for form, make in forms.items():
        for stages in STAGES:
            run = functools.partial(_run, motion, make, stages)
            found.append(Contender("CasADi", f"gauss-{stages}, {form}", run, steps_from(FIRST[motion.rods.count])))
    return found, []


def _run(motion: Motion, make: Any, stages: int, steps: float) -> Outcome:
    count = motion.rods.count
    work, centres = make(motion, stages, round(steps))
    try:
        found, wall, cpu = timed(work)
    except RuntimeError:  # Newton's method did not converge
        return lost(count, 0.0, 0.0)
    return Outcome(wall, cpu, centres(np.array(found).ravel()))


@functools.cache
def _chain(motion: Motion) -> Any:
    from tests.witness.casadi_gauss import RodChain

    return RodChain(motion.rods.count, motion.rods.length, motion.rods.mass)


@functools.cache
def _absolute_step(motion: Motion, stages: int) -> Any:
    return _chain(motion).step(stages)


def _absolute_folded(motion: Motion, stages: int, steps: int) -> Any:
    """Fold one step of index-1 equations; each starts Newton's method from the stages of the step before."""
    import casadi

    count = motion.rods.count
    unknowns = 5 * count * stages
    x = casadi.MX.sym("x", 6 * count + unknowns)
    step = _absolute_step(motion, stages)
    parts = step(x[: 3 * count], x[3 * count : 6 * count], x[6 * count :], motion.end / steps)
    run = casadi.Function("once", [x], [casadi.vertcat(*parts)]).fold(steps)
    q, v = _chain(motion).start(motion.angle)
    start = casadi.vertcat(q, v, casadi.DM.zeros(unknowns))
    return lambda: run(start), lambda found: centres_of(found[: 3 * count], count)


def _accelerations(motion: Motion) -> Any:
    """Return CasADi's function (angles, rates) -> theta'' of two rods."""
    import casadi

    angles, rates = casadi.SX.sym("angles", 2), casadi.SX.sym("rates", 2)
    gravity = GRAVITY / motion.rods.length
    coupling, sine = 0.5 * casadi.cos(angles[0] - angles[1]), 0.5 * casadi.sin(angles[0] - angles[1])
    first = -1.5 * gravity * casadi.cos(angles[0]) - sine * rates[1] ** 2
    second = -0.5 * gravity * casadi.cos(angles[1]) + sine * rates[0] ** 2
    determinant = 4.0 / 9.0 - coupling**2
    turn = casadi.vertcat(first / 3 - coupling * second, 4.0 / 3.0 * second - coupling * first) / determinant
    return casadi.Function("accelerations", [angles, rates], [turn])


@functools.cache
def _angles_step(tolerance: float, motion: Motion, stages: int) -> Any:
    import casadi

    from tests.witness.casadi_gauss import collocation_coefficients

    a, b, _ = collocation_coefficients(stages)
    turn = _accelerations(motion)
    angles, rates, h = casadi.SX.sym("angles", 2), casadi.SX.sym("rates", 2), casadi.SX.sym("h")
    unknowns = casadi.SX.sym("unknowns", 2 * stages)
    k = [unknowns[2 * i : 2 * i + 2] for i in range(stages)]
    fast = [rates + h * sum(a[i, j] * k[j] for j in range(stages)) for i in range(stages)]
    there = [angles + h * sum(a[i, j] * fast[j] for j in range(stages)) for i in range(stages)]
    residual = casadi.vertcat(*(k[i] - turn(there[i], fast[i]) for i in range(stages)))
    given = casadi.vertcat(angles, rates, h)
    options = {"abstol": tolerance, "abstolStep": tolerance / 10, "max_iter": 50}
    solver = casadi.rootfinder("stages", "newton", {"x": unknowns, "p": given, "g": residual}, options)
    new = [
        angles + h * sum(b[i] * fast[i] for i in range(stages)),
        rates + h * sum(b[i] * k[i] for i in range(stages)),
    ]
    finish = casadi.Function("finish", [given, unknowns], [casadi.vertcat(*new)])
    x, size = casadi.MX.sym("x", 4 + 2 * stages), casadi.MX.sym("size")
    solved = solver(x0=x[4:], p=casadi.vertcat(x[:4], size))["x"]
    moved = finish(casadi.vertcat(x[:4], size), solved)
    return casadi.Function("step", [x, size], [casadi.vertcat(moved, solved)])


def _angles_folded(tolerance: float, motion: Motion, stages: int, steps: int) -> Any:
    import casadi

    x = casadi.MX.sym("x", 4 + 2 * stages)
    once = casadi.Function("once", [x], [_angles_step(tolerance, motion, stages)(x, motion.end / steps)])
    run = once.fold(steps)
    start = casadi.vertcat(motion.start, casadi.DM.zeros(2 * stages))
    return lambda: run(start), lambda found: motion.rods.centres(found[:2])
