"""Methods that return more than the end of a step, each wrong in one way that the end does not show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import scipy.integrate
from pydantic import BaseModel

from mbdkit import EquationsOfMotion, ExternalMethod, Step, StepMethod, StepState, Tolerances

from . import corpus
from .corpus import RungeKutta

Vector = np.ndarray


def slope(equations: EquationsOfMotion, t: float, y: Vector) -> Vector:
    q, v, z = np.split(y, [equations.n, 2 * equations.n])
    a, _, rates = equations.derivatives(t, q, v, z)
    return np.concatenate([v, a, rates])


class Tolerance(BaseModel):
    """The tolerance of a method."""

    rtol: float = 1e-6


class Pair(StepMethod):
    """The pair of Bogacki and Shampine, with a cubic as dense output and its last slope as memory; nothing is wrong."""

    error_order = 2
    error_factor: ClassVar[float] = 1.0

    def __init__(self, options: Any = None) -> None:
        rtol = getattr(options, "rtol", None)
        self.tolerances = None if rtol is None else Tolerances(rtol, rtol)

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        y, parts = np.concatenate([state.q, state.v, state.z]), [equations.n, 2 * equations.n]
        k1 = self.first(equations, t, y, state.memory)
        k2 = slope(equations, t + h / 2, y + h / 2 * k1)
        k3 = slope(equations, t + 3 * h / 4, y + 3 * h / 4 * k2)
        dy = self.increment(h / 9 * (2 * k1 + 3 * k2 + 4 * k3), h * k1, parts[1])
        k4 = slope(equations, t + h, y + dy)
        curve = self.curve(y, dy, h * k1, h * k4)
        new = state.moved(*np.split(dy, parts), memory=self.memory(h, k4))
        error = self.error_factor * h * (-5 / 72 * k1 + k2 / 12 + k3 / 9 - k4 / 8)
        stages = np.array([y, y + h / 2 * k1, y + 3 * h / 4 * k2])
        return self.made(new, error, lambda theta: tuple(np.split(curve(theta), parts)), h, t, stages, parts)

    def first(self, equations: EquationsOfMotion, t: float, y: Vector, memory: Any) -> Vector:
        return slope(equations, t, y) if memory is None else memory

    def increment(self, dy: Vector, euler: Vector, motions: int) -> Vector:
        return dy

    def curve(self, y: Vector, dy: Vector, begin: Vector, end: Vector) -> Callable[[float], Vector]:
        return lambda x: y + x * (dy + (1 - x) * ((1 - x) * (begin - dy) - x * (end - dy)))

    def memory(self, h: float, k: Vector) -> Any:
        return k

    def made(self, new: StepState, error: Any, dense: Any, h: float, t: float, stages: Vector, parts: Any) -> Step:
        return Step(new, error, dense)


class Bashforth(StepMethod):
    """Adams-Bashforth of order 2 with a quadratic as dense output; its first step is one of Euler's method."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        y, parts = np.concatenate([state.q, state.v, state.z]), [equations.n, 2 * equations.n]
        k = slope(equations, t, y)
        before, last = (k, h) if state.memory is None else state.memory

        def moved(theta: float) -> list[Vector]:
            return np.split(theta * h * k + (theta * h) ** 2 / (2 * last) * (k - before), parts)

        def dense(theta: float) -> tuple[Vector, ...]:
            return tuple(x + dx for x, dx in zip(np.split(y, parts), moved(theta), strict=True))

        return Step(state.moved(*moved(1.0), memory=(k, h)), dense=dense)


class BashforthLine(Bashforth):
    """Its dense output is a line."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        made = super().step(equations, t, state, h)
        y, new = state, made.state
        ends = ((y.q, new.q), (y.v, new.v), (y.z, new.z))
        return replace(made, dense=lambda theta: tuple(x + theta * (end - x) for x, end in ends))


class Offset(Pair):
    """Its dense output is off by a constant."""

    def curve(self, *parts: Vector) -> Callable[[float], Vector]:
        right = super().curve(*parts)
        return lambda x: right(x) + 1e-4


class Line(Pair):
    """Its dense output is a line."""

    def curve(self, y: Vector, dy: Vector, begin: Vector, end: Vector) -> Callable[[float], Vector]:
        return lambda x: y + x * dy


class LineOfStates(Pair):
    """Its dense output is right for the motion, but a line for first-order states."""

    def curve(self, y: Vector, dy: Vector, begin: Vector, end: Vector) -> Callable[[float], Vector]:
        right, n = super().curve(y, dy, begin, end), 12
        return lambda x: np.concatenate([right(x)[:n], (y + x * dy)[n:]])


class Aliased(Pair):
    """Its dense output uses arrays that the next step overwrites."""

    def __init__(self, options: Any = None) -> None:
        super().__init__(options)
        self.own: dict[str, Any] = {}

    def curve(self, *parts: Vector) -> Callable[[float], Vector]:
        self.own["curve"] = super().curve(*parts)
        return lambda x: self.own["curve"](x)


class SmallError(Pair):
    """Its error estimate is a hundredth of the right one."""

    error_factor = 0.01


class NoError(Pair):
    """Its error estimate is zero."""

    error_factor = 0.0


class WrongErrorOrder(Pair):
    """It says that its error estimate is of order 4, but it is of order 3."""

    error_order = 3


class ErrorWithoutStates(Pair):
    """Its error estimate leaves out first-order states."""

    def made(self, new: StepState, error: Any, dense: Any, *others: Any) -> Step:
        return Step(new, np.concatenate([error[:12], 0.0 * error[12:]]), dense)


class Ros3p(StepMethod):
    """ROS3P of Lang and Verwer (2001) with the error estimate (k1 - k2)/3, which is zero for y' = A y."""

    error_order, gamma = 2, 0.5 + 3**0.5 / 6

    def __init__(self, options: Any = None) -> None:
        self.tolerances = Tolerances(options.rtol, options.rtol)

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        y, n, g = np.concatenate([state.q, state.v, state.z]), equations.n, self.gamma
        a_t, _, rates_t = equations.time_derivative(t, state.q, state.v, state.z)
        jacobian = h * equations.jacobian(t, state.q, state.v, state.z)
        by_time = h * h * np.concatenate([np.zeros(n), a_t, rates_t])
        matrix = np.eye(len(y)) - g * jacobian
        k1 = np.linalg.solve(matrix, h * slope(equations, t, y) + g * by_time)
        inner = h * slope(equations, t + h, y + k1)
        k2 = np.linalg.solve(matrix, inner - jacobian @ k1 + (g - 1) * by_time)
        third = jacobian @ ((0.5 - 2 * g) * k2 - g * k1) + (0.5 - 2 * g) * by_time
        k3 = np.linalg.solve(matrix, inner + third)
        return Step(state.moved(*np.split((2 * k1 + k3) / 3, [n, 2 * n])), error=(k1 - k2) / 3)


class NeverSmaller(Pair):
    """It rejects large steps, and asks for the same step again."""

    def made(self, new: StepState, error: Any, dense: Any, h: float, *others: Any) -> Step:
        return Step(new, None, dense, accepted=h < 0.01, next_step=h)


class NeverAccepted(Pair):
    """It always asks for a step that is a little smaller."""

    def made(self, new: StepState, error: Any, dense: Any, h: float, *others: Any) -> Step:
        return Step(new, None, dense, accepted=False, next_step=0.99 * h)


class KeepsMemory(Pair):
    """It uses its last slope after a discontinuity too."""

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: str) -> Any:
        return state.memory


class KeepsMemoryAfterEvents(Pair):
    """It uses its last slope after an event that has set states."""

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: str) -> Any:
        return state.memory if why == "event" else None


class FirstOrderStates(Pair):
    """It integrates first-order states by Euler's method."""

    def increment(self, dy: Vector, euler: Vector, motions: int) -> Vector:
        return np.concatenate([dy[:motions], euler[motions:]])


class Nodes(Pair):
    """It returns its stages for integrals; nothing is wrong with it."""

    weights = 2 / 9, 3 / 9, 4 / 9

    def made(self, new: StepState, error: Any, dense: Any, h: float, t: float, stages: Vector, parts: Any) -> Step:
        q, v, _ = np.split(stages, parts, axis=1)
        times = t + h * np.array([0.0, 0.5, 0.75])
        return Step(new, error, dense, stages=(times, h * np.array(self.weights), (q, v)))


class WrongWeights(Nodes):
    """The weights of its stages do not add up to the step."""

    weights = 2 / 9, 3 / 9, 1 / 9


class SwappedWeights(Nodes):
    """Two weights of its stages are swapped."""

    weights = 4 / 9, 3 / 9, 2 / 9


class Booked(RungeKutta):
    """It integrates work and dissipated energy by Simpson's rule over a step; nothing is wrong with it."""

    times_booked = 1.0

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        places = [(t, state), *((t + x, super(Booked, self).step(equations, t, state, x)) for x in (h / 2, h))]
        powers = []
        for time, place in places:
            _, multipliers = equations.accelerations(time, place.q, place.v)
            powers.append(equations.powers(time, place.q, place.v, multipliers))
        work, lost = h / 6 * np.array([1.0, 4.0, 1.0]) @ powers
        new = places[-1][1]
        return StepState(new.q, new.v, work=self.times_booked * work, dissipated=lost, low=new.low)


class BookedTwice(Booked):
    """It books the work twice."""

    times_booked = 2.0


class Library(ExternalMethod):
    """SciPy's RK45; nothing is wrong with it."""

    late = 0.0
    stored_parts = 2

    def __init__(self, options: Any) -> None:
        self.tolerances = Tolerances(options.rtol, options.rtol)

    def open(self, equations: EquationsOfMotion, t: float, state: StepState, stop: float) -> None:
        assert self.tolerances is not None
        self.parts, rtol = [equations.n, 2 * equations.n], self.tolerances.rtol
        y, first = np.concatenate([state.q, state.v, state.z]), equations.first_step
        self.solver = scipy.integrate.RK45(
            lambda t, y: slope(equations, t, y), t, y, stop, rtol=rtol, atol=rtol, first_step=first
        )

    def advance(self) -> Step:
        self.solver.step()
        self.inner, begin, h = self.solver.dense_output(), self.solver.t_old, self.solver.step_size
        inner = self.inner
        dense = lambda theta: tuple(np.split(inner(begin + theta * h), self.parts))  # noqa: E731
        return Step(self.state(self.solver.y), dense=dense, next_step=self.solver.h_abs, time=float(self.solver.t))

    def state(self, y: Vector) -> StepState:
        q, v, z = np.split(y, self.parts)
        return StepState(q, v, z=z)

    def cut(self, t: float) -> StepState:
        return self.state(self.inner(t + self.late * self.solver.step_size))

    def save(self) -> bytes:
        return np.concatenate([self.solver.f, [self.solver.h_abs]]).tobytes()

    def restore(self, stored: bytes) -> None:
        numbers = np.frombuffer(stored).copy()
        self.solver.f, self.solver.h_abs = numbers[:-1], numbers[-1]


class LateCut(Library):
    """It cuts a step at a later time than it is asked for."""

    late = 0.1


class ForgetsStep(Library):
    """It restores its slope, but not the size of its next step."""

    def restore(self, stored: bytes) -> None:
        self.solver.f = np.frombuffer(stored)[:-1].copy()


def fixed(method: type[StepMethod], **claims: Any) -> Any:
    given: dict[str, Any] = {
        "order": 3, "dense_output": True, "dense_order": 3, "states": True, "needs": ("accelerations",),
    }  # fmt: skip
    return corpus.offer(lambda options: method(), **given | claims)


def adaptive(method: Any, **claims: Any) -> Any:
    given: dict[str, Any] = {"adaptive": True, "dense_output": True, "states": True, "needs": ("accelerations",)}
    return corpus.offer(method, Tolerance, **given | claims)


def library(method: type[Library]) -> Any:
    return adaptive(method, stabilizations=("none", "baumgarte", "projection"), dense_order=4)


RK4: dict[str, Any] = {"order": 4, "needs": ("accelerations",)}

RIGHT = {
    "a pair with fixed steps": fixed(Nodes), "a pair with adaptive steps": adaptive(Pair, dense_order=3),
    "a library": library(Library), "work": corpus.offer_method(Booked, **RK4),
}  # fmt: skip

MEMORY = "a step uses the memory of the steps before"
NEEDED = "its state does not contain everything that the next step needs"
WRONG = {
    "dense output off by a constant": (
        adaptive(Offset, dense_order=3), "order.dense-output", "its dense output differs from the state at the start",
    ),
    "dense output of lower order in a multistep method": (
        fixed(BashforthLine, order=2, dense_order=2), "order.dense-output", "in the step after 12 others",
    ),
    "a multistep method that starts with order 1": (
        fixed(Bashforth, order=2, dense_order=2), "state.free-fall",
        "the motion of a free body in free fall is wrong after the first step",
    ),
    "dense output of lower order": (
        adaptive(Line, dense_order=3), "order.dense-output",
        "it claims dense output of order 3, but its dense output has the order",
    ),
    "dense output that is a line for states": (
        fixed(LineOfStates), "order.dense-output",
        "it claims dense output of order 3, but first-order states in its dense output have the order",
    ),
    "dense output that the next step overwrites": (
        fixed(Aliased), "order.dense-output", "the dense output of a step changes when further steps are taken",
    ),
    "an error estimate that is too small by a factor of 100": (
        adaptive(SmallError), "tolerance.error-estimate", "times its estimate",
    ),
    "an error estimate that is zero": (adaptive(NoError), "tolerance.error-estimate", "its error estimate is zero"),
    "an error estimate of another order than it says": (
        adaptive(WrongErrorOrder), "tolerance.error-estimate", "its error estimate should be of order 4, but has order",
    ),
    "an error estimate without states": (
        adaptive(ErrorWithoutStates), "tolerance.error-estimate", "for first-order states, its error estimate is zero",
    ),
    "an error estimate that is zero for linear equations": (
        adaptive(Ros3p, dense_output=False, needs=("accelerations", "tangents")), "tolerance.linear-oscillators",
        "its error does not decrease with the tolerance",
    ),
    "rejected steps that do not shrink": (
        adaptive(NeverSmaller), "tolerance.own-control", "it rejects a step of 1.7 s and asks for one of 1.7 s",
    ),
    "steps that are never accepted": (
        adaptive(NeverAccepted), "tolerance.own-control", "it accepts none of 200 attempts",
    ),
    "memory that is kept": (fixed(KeepsMemory), "restart.discontinuities", f"after a load has jumped, {MEMORY}"),
    "memory that is kept after events": (
        adaptive(KeepsMemoryAfterEvents), "restart.discontinuities", f"after an event, {MEMORY}",
    ),
    "first-order states of order 1": (
        fixed(FirstOrderStates, dense_order=None), "order.states", "it claims order 3, but the observed one is",
    ),
    "nodes whose weights do not add up": (
        fixed(WrongWeights), "order.quadrature-nodes", "the weights of its nodes add up to 0.666667 times the step",
    ),
    "nodes with swapped weights": (
        fixed(SwappedWeights), "order.quadrature-nodes", "the integral over its nodes has the order",
    ),
    "work that is booked twice": (
        corpus.offer_method(BookedTwice, **RK4), "order.work", "the energy balance of a step has the order",
    ),
    "a library that cuts late": (
        library(LateCut), "order.dense-output", "inside the steps of its library its `cut` is wrong",
    ),
    "a library that forgets its next step": (library(ForgetsStep), "restart.state", NEEDED),
}  # fmt: skip
"""By what is wrong: the method, the check that refuses it, and the beginning or a part of the cause."""
