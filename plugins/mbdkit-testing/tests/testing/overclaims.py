"""Methods that claim more than they do: of formulations, conservation, stability, states and memory."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

import mbdkit
from mbdkit import EquationsOfMotion, StepError, StepMethod, StepState
from mbdkit.methods import dopri5
from mbdkit.methods.scipy_solver import SciPySolver

from . import corpus
from .corpus import Midpoint, RungeKutta


class EnergyConserving(StepMethod):
    """Average vector fields on index 3 (Quispel and McLaren 2008), which conserve energy; nothing is wrong with it.

    Constraints hold at the ends of steps; forces and Jacobian are means along the step, by Gauss quadrature.
    """

    carries_multipliers = True
    rule = np.polynomial.legendre.leggauss(4)

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        q0, v0, mass, at = state.q, state.v, equations.mass, t + h / 2
        q, lam, rows = q0 + h * v0, np.zeros(equations.m), np.zeros((equations.m, equations.n))
        for _ in range(60):
            before, places = q, [(w / 2, q0 + (1 + x) / 2 * (q - q0)) for x, w in zip(*self.rule, strict=True)]
            force = sum(w * equations.forces(at, place, v0) for w, place in places)
            if equations.m:
                rows = sum(w * equations.constraint_jacobian(at, place).toarray() for w, place in places)
            v = v0 + h * (force - rows.T @ lam) / mass
            q = q0 + h / 2 * (v0 + v)
            if equations.m:
                matrix = h * h / 2 * equations.constraint_jacobian(t + h, q).toarray() @ (rows.T / mass[:, None])
                lam = lam + np.linalg.solve(matrix, equations.constraints(t + h, q))
            if np.max(np.abs(q - before)) < 2e-15:
                return StepState(q, v, multipliers=lam)
        raise StepError("newton-failed", "the iteration does not converge")


class OneByOne(StepMethod):
    """Symplectic Euler on one body after the other, so that forces between two bodies are not opposite.

    Right without joints only.
    """

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        q, v = state.q.copy(), state.v.copy()
        for first in range(0, equations.n, 3):
            body = slice(first, first + 3)
            a, _ = equations.accelerations(t, q, v)
            v[body] += h * a[body]
            q[body] += h * v[body]
        return StepState(q, v)


class BDF3(Midpoint):
    """The formula of order 3, which is stable for stiff decay, but not near the imaginary axis."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        past = state.memory or ()
        if len(past) < 2 or past[-1][0] != h:
            new = super().step(equations, t, state, h)
            kept = past[-1:] if past and past[-1][0] == h else ()
            return StepState(new.q, new.v, memory=(*kept, (h, state.q, state.v)))
        (_, q0, v0), (_, q1, v1) = past
        qk, vk = ((18 * new - 9 * old + 2 * oldest) / 11 for new, old, oldest in ((state.q, q1, q0), (state.v, v1, v0)))
        c = 6 / 11 * h
        v = vk + c * self.solved(equations, t, state, t + h, qk, vk, c)
        return StepState(qk + c * v, v, memory=(past[-1], (h, state.q, state.v)))


class Damped(Midpoint):
    """The one-leg theta method with theta = 0.55, which damps stiff modes by a fifth in each step."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        c = 0.55 * h
        a = self.solved(equations, t, state, t + c, state.q, state.v, c)
        return state.moved(h * (state.v + c * a), h * a)


class FixedCoefficients(RungeKutta):
    """Adams and Bashforth of order 4, whose coefficients stay those of equal steps when a step is shorter."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        a, _ = equations.accelerations(t, state.q, state.v)
        past = (*(state.memory or ()), np.concatenate([state.v, a]))[-4:]
        if len(past) < 4:
            new = super().step(equations, t, state, h)
        else:
            change = h / 24 * (55 * past[3] - 59 * past[2] + 37 * past[1] - 9 * past[0])
            new = state.moved(*np.split(change, 2))
        return StepState(new.q, new.v, memory=past)


class OldVelocities(StepMethod):
    """Velocity Verlet, which evaluates the forces at the end of the step with the velocities of its middle."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        a, _ = equations.accelerations(t, state.q, state.v)
        q, v = state.q + h * (state.v + h / 2 * a), state.v + h / 2 * a
        end, _ = equations.accelerations(t + h, q, v)
        return StepState(q, v + h / 2 * end)


class Unstorable(RungeKutta):
    """It keeps a function in its memory, which cannot be stored."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        return StepState(new.q, new.v, memory=lambda: new.q)


class Rounded:
    """A memory that is stored in single precision."""

    def __init__(self, slope: np.ndarray | None = None) -> None:
        self.slope = slope

    def stored(self) -> Any:
        return None if self.slope is None else self.slope.astype(np.float32).astype(float)

    def restored(self, data: Any) -> Rounded:
        return Rounded(data)


class RoundedMemory(StepMethod):
    """Adams and Bashforth of two steps, with a memory that loses digits where it is stored."""

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: str) -> Any:
        return Rounded()

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        a, _ = equations.accelerations(t, state.q, state.v)
        now = np.concatenate([state.v, a])
        before = now if state.memory.slope is None else state.memory.slope
        new = state.moved(*np.split(h * (1.5 * now - 0.5 * before), 2))
        return StepState(new.q, new.v, memory=Rounded(now))


def heun(**claims: Any) -> Any:
    """Return Heun's method, an explicit tableau, with further claims."""
    tableau = mbdkit.ButcherTableau("heun", [[], [1]], ["1/2", "1/2"], [0, 1], 2)
    return corpus.offer(lambda options: mbdkit.ExplicitRungeKutta(tableau), order=2, stages=2, **claims)


def gauss(**claims: Any) -> Any:
    """Return the Gauss method with 3 stages, with further claims."""
    tableau = corpus.gauss.tableau(3)
    return corpus.offer(lambda options: mbdkit.ImplicitRungeKutta(tableau), **corpus.GAUSS_3, **claims)


def pair(factors: np.ndarray) -> Any:
    """Return the pair of Dormand and Prince of order 5, with factors of the weights of its error."""
    ours = dopri5.pair()
    wrong = mbdkit.EmbeddedPair(factors * ours.error, 5, ours.a, ours.c, ours.dense)
    return corpus.offer(
        lambda options: mbdkit.ExplicitRungeKutta(dopri5.tableau(), wrong), dense_output=True, order=5, stages=7
    )


def solver(name: str, **claims: Any) -> Any:
    """Return a solver of SciPy, with claims."""
    return corpus.offer(
        lambda o: SciPySolver(name, o.rtol, o.atol), corpus.Tolerances, adaptive=True, restartable=False, **claims
    )


class DampingOptions(BaseModel):
    """An option that the method forgets."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    damping: float = Field(default=0.5, ge=0.0, le=1.0)
    """Numerical damping."""


RK4: dict[str, Any] = {"order": 4, "needs": ("accelerations",)}
MIDPOINT: dict[str, Any] = {
    "order": 2, "needs": ("tangents",), "symmetric": True, "symplectic": True, "quadratic_invariants": True,
}  # fmt: skip
STABLE: dict[str, Any] = {"a_stable": True, "l_stable": True}
AB2: dict[str, Any] = {"order": 2, "needs": ("accelerations",)}
_method = corpus.offer_method

RIGHT = {
    "geometry.conserved-energy": _method(EnergyConserving, order=2, formulations=("index-3",), conserves=("energy",)),
    "stability.l-stable": _method(BDF3, order=3, **STABLE),
    "tolerance.variable-order": solver("BDF", variable_order=True),
    "restart.state": _method(Unstorable, **RK4, restartable=False),
}
"""By the check that applies to their claims; nothing is wrong with what it tests. Built-in methods have the others."""

WRONG = {
    "index-3, but only index-1 is integrated": (
        _method(RungeKutta, **RK4, formulations=("index-1", "index-3")), "drift.formulations",
        "on index-3 the constraints should hold at position level",
    ),
    "joint coordinates, but the joints drift": (
        _method(RungeKutta, **RK4, formulations=("joint-coordinates",)), "drift.position",
        "joint-coordinates enforces them, but the constraints do not hold",
    ),
    "conserved energy by a symplectic method": (
        _method(Midpoint, **MIDPOINT, conserves=("energy",)), "geometry.conserved-energy",
        "it claims to conserve energy, but in large steps it changes",
    ),
    "conserved linear momentum": (
        _method(OneByOne, order=1, conserves=("linear-momentum",)), "geometry.conserved-linear-momentum",
        "it claims to conserve linear-momentum, but in large steps it changes",
    ),
    "conserved angular momentum of bodies with joints that drift": (
        _method(Midpoint, **MIDPOINT, conserves=("angular-momentum",)), "geometry.conserved-angular-momentum",
        "it claims to conserve angular-momentum, but in large steps it changes",
    ),
    "A-stability of a formula of order 3": (
        _method(BDF3, order=3, a_stable=True), "stability.a-stable", "and a damping ratio of 0 oscillations grow",
    ),
    "A-stability of an explicit tableau": (
        heun(a_stable=True), "tableau.stability", "it claims to be A-stable, but its stability function exceeds 1",
    ),
    "A-stability of an explicit method with adaptive steps": (
        solver("RK45", a_stable=True), "stability.a-stable",
        "it claims to be A-stable, but takes more steps where oscillators are stiffer",
    ),
    "L-stability of a damping method": (
        _method(Damped, order=1, needs=("tangents",), **STABLE), "stability.l-stable",
        "it claims to be L-stable, but 4 steps leave",
    ),
    "L-stability of a tableau": (
        gauss(**STABLE), "tableau.stability", "it claims to be L-stable, but its stability function does not vanish",
    ),
    "coefficients that ignore a shorter step": (
        _method(FixedCoefficients, **RK4), "state.free-fall",
        "the motion of a free body in free fall is wrong at the end of a last step of",
    ),
    "order 2 with velocities of the middle of a step": (
        _method(OldVelocities, order=2, needs=("accelerations",)), "order.forced-pendulum",
        "it claims order 2, but the observed one is 1.",
    ),
    "states that it does not integrate": (
        _method(RungeKutta, **RK4, states=True), "contract.states", "its first-order states do not converge",
    ),
    "variable order of a method of order 5": (
        solver("RK45", variable_order=True), "tolerance.variable-order",
        "it claims variable order, but its number of steps follows one power of the tolerance",
    ),
    "an option that the method ignores": (
        corpus.offer(lambda options: RungeKutta(), DampingOptions, **RK4), "contract.option-effects",
        "its option damping has no effect",
    ),
    "an order of dense output of the cubic of the framework": (
        _method(RungeKutta, **RK4, dense_output=True, dense_order=4), "order.dense-output",
        "it claims dense output of order 4, but its dense output has the order 2.",
    ),
    "dense output that the plugin has not": (
        _method(RungeKutta, **RK4, dense_order=3), "order.dense-output",
        "it claims an order of dense output, but the plugin says that it has none",
    ),
    "an error estimate that does not vanish in a steady motion": (
        pair(np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.1])), "tolerance.error-estimate",
        "its error estimate should be of order 5, but has order 0.",
    ),
    "a memory that can be stored": (
        _method(Unstorable, **RK4), "restart.state", "it claims to be restartable, but its state cannot be stored",
    ),
    "projection, which makes it forget its memory": (
        _method(RoundedMemory, **AB2), "order.projection", "it claims order 2, but the observed one is 1.0",
    ),
    "a memory that loses digits": (
        _method(RoundedMemory, **AB2), "restart.state",
        "its state does not contain everything that the next step needs",
    ),
}  # fmt: skip
"""By what is claimed: the method, the check that refuses it, and the beginning or a part of the cause."""
