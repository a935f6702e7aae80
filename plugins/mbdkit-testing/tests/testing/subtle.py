"""Plugins that are wrong in one small way, away from the places where a test of a few samples looks."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.integrate

from mbdkit import EquationsOfMotion, FunctionLaw, StepState
from mbdkit.methods.scipy_solver import SciPySolver

from . import corpus
from .corpus import RungeKutta

# --- force laws; each is compared with k s + c s', of which it differs in one place --------------------------------

Four = tuple[float, float, float, float]


def creates_energy_at_some_rates(s: float, v: float, t: float, p: Any) -> Four:
    """It adds energy for rates between 0.15 and 0.9."""
    a, sign = abs(v), 1.0 if v > 0 else -1.0
    inside = 0.15 < a < 0.9
    g = -5.0 * (a - 0.15) * (0.9 - a) if inside else 0.0
    dg = -5.0 * (1.05 - 2.0 * a) if inside else 0.0
    return 100.0 * s + sign * g + 0.5 * v, 100.0, dg + 0.5, 50.0 * s * s


def creates_energy_in_a_corner(s: float, v: float, t: float, p: Any) -> Four:
    """It adds energy for rates between 4.2 and 4.6 at lengths below -3."""
    if s < -3.0 and 4.2 < v < 4.6:
        return 3.0 * s - 0.1 * v, 3.0, -0.1, 1.5 * s * s
    return 3.0 * s + v, 3.0, 1.0, 1.5 * s * s


def creates_energy_for_a_second(s: float, v: float, t: float, p: Any) -> Four:
    """It adds energy between 5 and 6 s."""
    c = -0.2 if 5.0 < t < 6.0 else 1.0
    return 3.0 * s + c * v, 3.0, c, 1.5 * s * s


def creates_energy_when_long(s: float, v: float, t: float, p: Any) -> Four:
    """Its damping becomes negative beyond a length of 8."""
    return (8.0 - s) * v, -v, 8.0 - s, 0.0


def springy_but_passive(s: float, v: float, t: float, p: Any) -> Four:
    """It claims no potential, so that what it stores and returns is not passive."""
    return 3.0 * s + v, 3.0, 1.0, 0.0


def creates_a_little(s: float, v: float, t: float, p: Any) -> Four:
    """It adds energy with a force of a millionth of that of the spring."""
    return 3.0 * s - 3e-6 * v, 3.0, -3e-6, 1.5 * s * s


def wrong_slope_when_long(s: float, v: float, t: float, p: Any) -> Four:
    """Its derivative with respect to length is that of a softer spring beyond 5."""
    return 3.0 * s + v, 2.9 if s > 5.0 else 3.0, 1.0, 1.5 * s * s


def wrong_slope_below_zero(s: float, v: float, t: float, p: Any) -> Four:
    """Derivative and potential have the wrong sign for negative lengths, where angles may be."""
    sign = 1.0 if s >= 0.0 else -1.0
    return s**3, sign * 3.0 * s * s, 0.0, sign * s**4 / 4.0


def wrong_slope_near_zero(s: float, v: float, t: float, p: Any) -> Four:
    """Its derivative with respect to length is missing within a millimetre of zero."""
    return 3.0 * s + v, 0.0 if abs(s) < 1e-3 else 3.0, 1.0, 1.5 * s * s


def wrong_slope_of_the_product(s: float, v: float, t: float, p: Any) -> Four:
    """Its derivative with respect to length forgets the damping that depends on length."""
    return 3.0 * s + s * s * v, 3.0, s * s, 1.5 * s * s


def wrong_rate_when_fast(s: float, v: float, t: float, p: Any) -> Four:
    """Its damping saturates at a rate of 6; its derivative does not know."""
    return 3.0 * s + min(max(v, -6.0), 6.0), 3.0, 1.0, 1.5 * s * s


def wrong_rate_late(s: float, v: float, t: float, p: Any) -> Four:
    """Its derivative with respect to rate changes its sign after 8 s, its force does not."""
    return 3.0 * s + v, 3.0, 1.0 if t < 8.0 else -1.0, 1.5 * s * s


def stiffer_after_two_seconds(s: float, v: float, t: float, p: Any) -> Four:
    """It becomes stiffer after 2 s, and says that it has a potential."""
    k = 100.0 if t < 2.0 else 150.0
    return k * s, k, 0.0, k * s * s / 2.0


def flickers(s: float, v: float, t: float, p: Any) -> Four:
    """Its force at rest is larger by a millionth in a hundredth of the time."""
    k = 3.0 * (1.0 + 1e-6 * (math.sin(t) > 0.99))
    return k * s + v, k, 1.0, 1.5 * s * s


def potential_jumps(s: float, v: float, t: float, p: Any) -> Four:
    """Its potential rises by a step at a length of 2.3, where its force is smooth."""
    return 3.0 * s + v, 3.0, 1.0, 1.5 * s * s + (1.0 if s > 2.3 else 0.0)


def no_number_when_short(s: float, v: float, t: float, p: Any) -> Four:
    """It is no number below -9."""
    return math.sqrt(s + 9.0), 0.5 / math.sqrt(s + 9.0), 0.0, 0.0


def wrong_where_it_says_it_holds(s: float, v: float, t: float, p: Any) -> Four:
    """It declares lengths between 20 and 30, and has a wrong derivative in half of them."""
    return 3.0 * s + v, 3.0 if s < 25.0 else 2.0, 1.0, 1.5 * s * s


def right_where_it_says_it_holds(s: float, v: float, t: float, p: Any) -> Four:
    """It holds for positive lengths and times below 4 s only, and says so; nothing is wrong with it."""
    root = math.sqrt(s)
    late = v if t > 4.0 else 0.0
    return root + v - 3.0 * late, 0.5 / root, 1.0 - 3.0 * (t > 4.0), 2.0 / 3.0 * s * root


def hertz(s: float, v: float, t: float, p: Any) -> Four:
    """A contact with dissipation (Hunt and Crossley 1975), whose stiffness rises like a root; nothing is wrong."""
    depth = 0.3 - s
    if depth <= 0.0 or 1.0 - 0.5 * v <= 0.0:
        return 0.0, 0.0, 0.0, 4e3 * depth**2.5 if depth > 0.0 else 0.0
    force = 1e4 * depth**1.5
    return -force * (1.0 - 0.5 * v), 1.5e4 * math.sqrt(depth) * (1.0 - 0.5 * v), 0.5 * force, 4e3 * depth**2.5


def dry_friction(s: float, v: float, t: float, p: Any) -> Four:
    """A force that jumps with the sign of the rate; nothing is wrong with it."""
    return 2.0 * math.copysign(1.0, v) if v != 0.0 else 0.0, 0.0, 0.0, 0.0


def steep(s: float, v: float, t: float, p: Any) -> Four:
    """A bump stop whose force grows by 22 decades over the range; nothing is wrong with it."""
    return 1e-3 * math.expm1(5.0 * s), 5e-3 * math.exp(5.0 * s), 0.0, 1e-3 * (math.expm1(5.0 * s) / 5.0 - s)


def ranged(function: Any, **valid_range: tuple[float, float]) -> Any:
    """Return the registry that offers a function which holds in a range."""
    return corpus.offer_law(FunctionLaw(function, potential=True, passive=True, valid_range=valid_range))


# --- methods; each is the classical Runge-Kutta method but for one thing --------------------------------------------


class Growing(RungeKutta):
    """It creates energy: 1e-9 of the velocity a second."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        return StepState(new.q, new.v * (1.0 + 1e-9 * h))


class EndShort(RungeKutta):
    """It takes a last, shorter step at full length if it is shorter than `share` of the others."""

    share = 0.5

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        usual = state.memory or h
        new = super().step(equations, t, state, usual if h < self.share * usual else h)
        return StepState(new.q, new.v, memory=max(usual, h))


class EndAlmostShort(EndShort):
    """It takes a last step at full length that is at least 4 % shorter."""

    share = 0.98


class Single(RungeKutta):
    """It stores positions in single precision."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        return StepState(new.q.astype(np.float32).astype(float), new.v)


class Wrapped(RungeKutta):
    """It keeps angles between -pi and pi."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        q = new.q.copy()
        q[2::3] = (q[2::3] + math.pi) % (2.0 * math.pi) - math.pi
        return StepState(q, new.v)


class Clipped(RungeKutta):
    """It limits velocities to 20 m/s."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h)
        return StepState(new.q, np.clip(new.v, -20.0, 20.0))


class OwnClock(RungeKutta):
    """It measures time from its first step, whatever the start time of the run."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        now = state.memory or 0.0
        new = super().step(equations, now, state, h)
        return StepState(new.q, new.v, memory=now + h)


class DerivativeSolver(scipy.integrate.OdeSolver):
    """The classical method with steps by the second derivative of the velocities, without an estimate of the error.

    From rest, positions are even and velocities odd functions of time, so that this derivative vanishes by symmetry.
    """

    def __init__(self, fun: Any, t0: float, y0: Any, t_bound: float, rtol: float, atol: float, **other: Any) -> None:
        super().__init__(fun, t0, y0, t_bound, vectorized=False)
        self.tolerance, self.before = rtol, self.y

    def _step_impl(self) -> tuple[bool, str | None]:
        t, y, n, e = self.t, self.y, len(self.y) // 2, 1e-3
        jerk = (self.fun(t + e, y + e * self.fun(t, y)) - self.fun(t - e, y - e * self.fun(t, y)))[n:] / (2.0 * e)
        h = min((self.tolerance / max(float(np.max(np.abs(jerk))), 1e-300)) ** (1 / 4), 0.3, self.t_bound - t)
        k1 = self.fun(t, y)
        k2 = self.fun(t + h / 2, y + h / 2 * k1)
        k3 = self.fun(t + h / 2, y + h / 2 * k2)
        k4 = self.fun(t + h, y + h * k3)
        self.before, self.old = y, t
        self.y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self.t = t + h if self.t_bound - t - h > 1e-12 else self.t_bound
        return True, None

    def _dense_output_impl(self) -> Any:
        return scipy.integrate.DenseOutput(self.old, self.t)


def offer_derivative_solver() -> Any:
    return corpus.offer(lambda o: SciPySolver(DerivativeSolver, o.rtol, o.atol), corpus.Tolerances, adaptive=True)
