"""A cart with a pole, and its motion by SciPy in minimal coordinates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.integrate import solve_ivp

from mbdkit import Mechanism, RunSpec, load_spec

CART, POLE, INERTIA, HALF, GRAVITY = 0.5, 0.2, 6e-3, 0.3, 9.81


def cart_pole(step: float = 0.005, **sections: object) -> RunSpec:
    """Return the spec of a cart with a pole that hangs, pushed by the input `push`."""
    m = Mechanism(gravity=(0.0, -GRAVITY))
    m.body("cart", mass=CART, inertia=1e-3)
    m.body("pole", mass=POLE, inertia=INERTIA, position=(0.0, -HALF), angle=-np.pi / 2)
    m.prismatic("rail", m.ground, "cart", points=((0.0, 0.0), (0.0, 0.0)), axis=(1.0, 0.0))
    m.revolute("pin", "cart", "pole", points=((0.0, 0.0), (-HALF, 0.0)))
    m.input("push", unit="N", bounds=(-5.0, 5.0))
    m.force("motor", "cart", value=["inputs.push", 0.0])
    given = {"formulation": "joint-coordinates", "integrator": {"name": "rk4"}} | sections
    return load_spec(m, (), time={"end": 1.0, "step": step}, **given)  # type: ignore[arg-type]


ARGUMENTS = {
    "observations": {"x": "cart.x", "angle": "pole.angle", "speed": "cart.vx", "rate": "pole.angular_velocity"},
    "reward": "sin(pole.angle) - cart.x**2",
    "terminated": "abs(cart.x) - 0.6",
    "period": 0.02,
    "duration": 2.0,
}  # fmt: skip
"""Arguments of environments with this spec."""


def motion(start: Sequence[float], pushes: Sequence[float], period: float) -> np.ndarray:
    """Return x, angle and their rates (n + 1, 4) at the ends of n periods with constant forces."""

    def rates(t: float, y: np.ndarray, push: float) -> list[float]:
        _, angle, speed, rate = y
        sine, cosine = np.sin(angle), np.cos(angle)
        mass = [[CART + POLE, -POLE * HALF * sine], [-POLE * HALF * sine, INERTIA + POLE * HALF**2]]
        load = [push + POLE * HALF * cosine * rate**2, -POLE * GRAVITY * HALF * cosine]
        return [speed, rate, *np.linalg.solve(mass, load)]

    states = [np.array(start, dtype=float)]
    for push in pushes:
        solution = solve_ivp(rates, (0.0, period), states[-1], "DOP853", args=(push,), rtol=1e-11, atol=1e-12)
        states.append(solution.y[:, -1])
    return np.array(states)
