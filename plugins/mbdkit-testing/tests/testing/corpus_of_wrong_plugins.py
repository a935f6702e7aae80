"""Integrators with one mistake each, and the checks that find it."""

from __future__ import annotations

import math
from typing import Any

from tests.testing import corpus, subtle

from mbdkit.registry.catalogue import Registry
from mbdkit_testing.check_result import Result
from mbdkit_testing.kit import checks_of, plugin_under_test

RK4 = {"order": 4, "needs": ("accelerations",)}


MIDPOINT = {"order": 2, "needs": ("tangents",), "symmetric": True, "symplectic": True, "quadratic_invariants": True}


EULER = {"order": 1, "needs": ("accelerations",), "symplectic": True}


RIGHT = {
    "symplectic Euler": ("integrator", corpus.offer_method(corpus.SymplecticEuler, **EULER)),
    "runge-kutta": ("integrator", corpus.offer_method(corpus.RungeKutta, **RK4)),
    "midpoint": ("integrator", corpus.offer_method(corpus.Midpoint, **MIDPOINT)),
    "pendulum": ("model", corpus.offer_model()), "driven": ("model", corpus.offer_model(motion="0.5*sin(2*t)")),
    "hardening": ("force-law", corpus.offer_law(corpus.hardening)),
    "contact": ("force-law", corpus.offer_law(subtle.hertz)),
    "dry friction": ("force-law", corpus.offer_law(subtle.dry_friction, potential=False)),
    "a steep stop": ("force-law", corpus.offer_law(subtle.steep)),
    "a root": (
        "force-law", subtle.ranged(subtle.right_where_it_says_it_holds, length=(0.0, math.inf), time=(0.0, 4.0)),
    ),
}  # fmt: skip


WRONG: dict[str, tuple[Any, Registry, str]] = {
    "a wrong coefficient": ("integrator", corpus.offer_method(corpus.WrongCoefficient, **RK4), "order.four-bar"),
    "a wrong stage time": ("integrator", corpus.offer_method(corpus.WrongStageTime, **RK4), "order.forced-pendulum"),
    "a loose Newton": ("integrator", corpus.loose_gauss(1e-4), "newton.tolerance"),
    "a Newton that is left out at fine steps": (
        "integrator", corpus.offer_method(corpus.LazyNewton, **MIDPOINT), "order.finest",
    ),
    "a Newton that ends while bodies move": (
        "integrator", corpus.offer_method(corpus.LooseNewton, **MIDPOINT), "geometry.reversibility-pendulum",
    ),
    "a tableau's claim of symmetry": ("integrator", corpus.trapezoid(symmetric=True), "tableau.symmetry"),
    "a claim of invariants by a method that keeps one of them": (
        "integrator", corpus.offer_method(corpus.SymplecticEuler, **EULER, quadratic_invariants=True),
        "geometry.quadratic-invariants",
    ),
    "an over-claim of order": (
        "integrator", corpus.offer_method(corpus.RungeKutta, **RK4 | {"order": 5}), "order.forced-pendulum",
    ),
    "a lying counter": ("integrator", corpus.offer_method(corpus.LyingCounter, **RK4), "honesty.counters"),
    "tangents that it does not own up to": (
        "integrator", corpus.offer_method(corpus.Midpoint, **MIDPOINT | {"needs": ()}), "honesty.needs",
    ),
    "hidden stabilization": ("integrator", corpus.offer_method(corpus.Stabilized, **RK4), "honesty.projections"),
    "a changed input": ("integrator", corpus.offer_method(corpus.ChangesItsInput, **RK4), "contract.inputs"),
    "a buffer": ("integrator", corpus.offer_method(corpus.ReturnsItsBuffer, **RK4), "contract.inputs"),
    "a swallowed NaN": ("integrator", corpus.offer_method(corpus.SwallowsNaN, **RK4), "failure.not-a-number"),
    "a memory outside the state": (
        "integrator", corpus.offer_method(corpus.Forgetful, order=2, needs=("accelerations",)), "restart.state",
    ),
    "a memory that a look inside a step changes": (
        "integrator", corpus.offer_method(corpus.Alternating, order=1, needs=("accelerations",)), "restart.stretches",
    ),
    "a solver that obeys no tolerance": ("integrator", corpus.offer_solver(), "tolerance.forced-pendulum"),
    "a driver with a corner": ("model", corpus.offer_model(motion="0.5*abs(t - 0.4)"), "model.drivers"),
    "a model that is another each time": ("model", corpus.offer_model(random=True), "model.repeatable"),
}  # fmt: skip


def outcome(kind: Any, installed: Registry, name: str) -> Result:
    """Return what one check says of a plugin."""
    assert not installed.failures
    check = next(check for check in checks_of(kind) if check.name == name)
    return check.run(plugin_under_test(kind, "acme:mine", {}, installed))
