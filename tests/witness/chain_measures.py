"""Measures of random chains of rods by an independent code: SciPy's DOP853 in minimal coordinates, and splines.

The chains hang at the ground by a revolute joint, with a torsion spring and a damper in each joint. Kinks and extrema
are those of a cubic spline through 10,001 points, whose error is near 1e-14; derivatives are differences of order 4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import mbdkit

END = 1.5
POINTS = 10_001
MOMENT = 0.777
"""Time [s] of a value between the ends of the steps."""
METHODS: tuple[tuple[dict[str, Any], float | None], ...] = (
    ({"name": "rk4"}, 0.01),
    ({"name": "gauss", "stages": 2}, 0.01),
    ({"name": "gauss", "stages": 3}, 0.02),
    ({"name": "radau-iia", "stages": 3}, 0.02),
    ({"name": "dop853", "adaptive": True, "rtol": 1e-7}, None),
    ({"name": "dopri5", "adaptive": True, "rtol": 1e-8}, None),
)
TEXTS: dict[str, str] = {
    "end": "final(tip.x)",
    "work": "integral(tip.vx**2)",
    "turning": "rms(tip.angular_velocity)",
    "moment": f"at(tip.y, {MOMENT})",
    "path": "mean(abs(tip.vy))",
    "beyond": "integral(max(tip.x - 0.1, 0))",
    "less": "integral(min(tip.vx, tip.vy))",
    "fastest": "max(abs(tip.vx))",
    "lowest": "min(tip.y)",
}
"""Measures of the last rod; those from `path` on have kinks or are extrema."""
PARAMETER = "model.forces.s0.stiffness"


@dataclass(frozen=True)
class Chain:
    """A chain of n uniform rods: lengths [m], masses [kg], angles [rad], rates [rad/s], stiffnesses and dampings."""

    lengths: np.ndarray
    masses: np.ndarray
    angles: np.ndarray
    rates: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray

    @staticmethod
    def random(seed: int) -> Chain:
        """Return a chain of one to three rods."""
        rng = np.random.default_rng(seed)
        n = int(rng.integers(1, 4))
        angles = rng.uniform(-2.5, -0.5, n)
        return Chain(
            rng.uniform(0.4, 1.2, n), rng.uniform(0.5, 2.0, n), angles, rng.uniform(-2.0, 2.0, n),
            rng.uniform(0.0, 20.0, n), rng.uniform(0.0, 0.3, n),
        )  # fmt: skip

    def spec(self, integrator: dict[str, Any], step: float | None, **sections: Any) -> dict[str, Any]:
        """Return the run spec."""
        m = mbdkit.Mechanism()
        below, at = m.ground, np.zeros(2)
        for i, (length, angle) in enumerate(zip(self.lengths, self.angles, strict=True)):
            name, along = "tip" if i == len(self.lengths) - 1 else f"rod{i}", np.array([np.cos(angle), np.sin(angle)])
            velocity = self._velocity(i, self.angles, self.rates)
            rod = m.body(
                name, mass=self.masses[i], inertia=self.masses[i] * length**2 / 12,
                position=tuple(at + length / 2 * along), angle=angle, velocity=tuple(velocity),
                angular_velocity=self.rates[i],
            )  # fmt: skip
            m.revolute(f"J{i}", below, rod, at=tuple(at))
            m.torsion_spring(f"s{i}", below, rod, stiffness=self.stiffness[i], damping=self.damping[i])
            below, at = rod, at + length * along
        time = {"end": END} | ({} if step is None else {"step": step})
        return {"mbdkit": 1, "model": m.to_spec(), "integrator": integrator, "time": time} | sections

    def _arms(self) -> np.ndarray:
        """Return the length of rod j up to the centre of rod i, (n, n)."""
        return np.tril(np.tile(self.lengths, (len(self.lengths), 1)), -1) + np.diag(self.lengths / 2)

    def _velocity(self, i: int, angle: np.ndarray, rate: np.ndarray) -> np.ndarray:
        arm = self._arms()[i]
        return np.array([-(arm * rate) @ np.sin(angle), (arm * rate) @ np.cos(angle)])

    def _rates(self, state: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """Return the rates of angles and their rates (2, V, n) with V stiffnesses (V, n) of the springs."""
        angle, rate = state
        arms = self._arms()
        coupling = np.einsum("i,ij,ik->jk", self.masses, arms, arms)
        between = angle[:, :, None] - angle[:, None]
        mass = coupling * np.cos(between) + np.diag(self.masses * self.lengths**2 / 12)
        relative, speed = (np.diff(x, axis=1, prepend=0.0) for x in (angle, rate))
        torque = -stiffness * relative - self.damping * speed
        load = torque - np.pad(torque[:, 1:], ((0, 0), (0, 1))) - 9.81 * (self.masses @ arms) * np.cos(angle)
        load = load - np.einsum("jk,vjk,vk->vj", coupling, np.sin(between), rate**2)
        return np.stack([rate, np.linalg.solve(mass, load[..., None])[..., 0]])

    def measures(self, stiffness: np.ndarray | None = None) -> np.ndarray:
        """Return the exact measures (V, M) with V stiffnesses (V, n) of the springs; by default, those of the chain."""
        stiffness = self.stiffness[None] if stiffness is None else stiffness
        shape = (2, *stiffness.shape)
        start = np.broadcast_to(np.stack([self.angles, self.rates])[:, None], shape)
        motion = solve_ivp(
            lambda t, y: self._rates(y.reshape(shape), stiffness).ravel(), (0.0, END), start.ravel(), method="DOP853",
            rtol=1e-13, atol=1e-13, dense_output=True,
        )  # fmt: skip
        t = np.linspace(0.0, END, POINTS)
        angles, rates = motion.sol(t).reshape(*shape, -1)
        return np.array([self._measured(t, angle, rate) for angle, rate in zip(angles, rates, strict=True)])

    def _measured(self, t: np.ndarray, angle: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Return the measures (M,) of angles and their rates (n, T)."""
        arm = self._arms()[-1][:, None]
        x, y = np.sum(arm * np.cos(angle), axis=0), np.sum(arm * np.sin(angle), axis=0)
        vx, vy = -np.sum(arm * rate * np.sin(angle), axis=0), np.sum(arm * rate * np.cos(angle), axis=0)

        def integral(values: np.ndarray) -> float:
            return float(CubicSpline(t, values).integrate(0.0, END))

        return np.array([
            x[-1], integral(vx**2), np.sqrt(integral(rate[-1] ** 2) / END), CubicSpline(t, y)(MOMENT),
            _split(t, vy, np.abs) / END, _split(t, x - 0.1, lambda g: max(g, 0.0)),
            integral(vx) - _split(t, vx - vy, lambda g: max(g, 0.0)),
            max(_largest(t, vx), _largest(t, -vx)), -_largest(t, -y),
        ])  # fmt: skip

    def exact(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the exact measures (M,) and their derivatives (M,) with respect to the first stiffness."""
        step = 1e-3 * (1.0 + self.stiffness[0])
        places = np.array([0.0, -2.0, -1.0, 1.0, 2.0])
        moved = self.stiffness + step * np.outer(places, np.eye(len(self.stiffness))[0])
        value, *others = self.measures(moved)
        return value, np.asarray(np.array([1.0, -8.0, 8.0, -1.0]) @ np.array(others) / (12 * step))


def _split(t: np.ndarray, g: np.ndarray, of: Callable[[float], float]) -> float:
    """Return the integral of max(g, 0) or |g|, between the roots of a spline."""
    spline = CubicSpline(t, g)
    ends = np.concatenate([[t[0]], spline.roots(extrapolate=False), [t[-1]]])
    return sum(of(float(spline.integrate(a, b))) for a, b in pairwise(ends))


def _largest(t: np.ndarray, g: np.ndarray) -> float:
    spline = CubicSpline(t, g)
    return float(np.max(spline(np.concatenate([[t[0]], spline.derivative().roots(extrapolate=False), [t[-1]]]))))


@dataclass(frozen=True)
class Case:
    """A measure of a run with its error estimate and derivative, beside the exact ones."""

    seed: int
    method: str
    measure: str
    value: float
    estimate: float
    exact: float
    derivative: float
    derivative_estimate: float
    exact_derivative: float
    size: float

    @property
    def is_known(self) -> bool:
        """Whether there is an estimate."""
        return bool(np.isfinite(self.estimate))

    @property
    def is_inside(self) -> bool:
        """Whether the estimate is between 1/5 and 3 times the true error, or both are rounding errors."""
        return _is_between(abs(self.value - self.exact), self.estimate, 1e-11 * self.size)

    @property
    def is_right(self) -> bool:
        """Whether the estimated error of the derivative is between 1/5 and 3 times the true one, or both are small."""
        away = abs(self.derivative - self.exact_derivative)
        return _is_between(away, self.derivative_estimate, 1e-9 * self.size)


def _is_between(true: float, estimate: float, floor: float) -> bool:
    return estimate <= 3 * true + floor and true <= 5 * estimate + floor


def cases_of(seed: int) -> list[Case]:
    """Return the measures of a random chain with one of the methods."""
    chain, (integrator, step) = Chain.random(seed), METHODS[seed % len(METHODS)]
    exact, slopes = chain.exact()
    spec = chain.spec(integrator, step)
    run = mbdkit.run(spec | {"measures": TEXTS, "check": True})
    found = mbdkit.gradient(spec, TEXTS, PARAMETER)
    cases = []
    for place, name in enumerate(TEXTS):
        cases.append(Case(
            seed, integrator["name"], name, run.measures[name], run.measure_errors[name], exact[place],
            float(found.jacobian[place, 0]), float(found.error[place, 0]), slopes[place], max(abs(exact[place]), 0.1),
        ))  # fmt: skip
    return cases
