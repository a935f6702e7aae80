"""A ball on a damped elastic pad, and the derivatives of its motion by hand."""

from __future__ import annotations

import cmath
from typing import Any

import numpy as np

HEIGHT, STIFFNESS, DAMPING, PAD, GRAVITY = 1.0, 400.0, 5.0, 0.3, 9.81


GAUSS = {"name": "gauss", "stages": 3}


def ball(end: float, step: float, integrator: dict[str, Any] = GAUSS, **law: float) -> dict[str, Any]:
    """Return a ball of 1 kg that falls on a pad."""
    return {
        "mbdkit": 1, "parameters": {"y": HEIGHT, "k": STIFFNESS, "c": DAMPING},
        "model": {
            "name": "mechanism", "bodies": {"ball": {"mass": 1.0, "position": [0.0, "y"]}},
            "forces": {
                "pad": {
                    "type": "law", "law": "one-sided", "acts": "compression", "stiffness": "k", "damping": "c",
                    "free_length": PAD, **law,
                    "pathway": {"type": "two-points", "bodies": ["ground", "ball"], "points": [[0, 0], [0, 0]]},
                },
            },
        },
        "integrator": integrator, "time": {"end": end, "step": step},
    }  # fmt: skip


def bounce(y: complex, k: complex, c: complex, end: float, engages_at: float = PAD) -> tuple[complex, complex]:
    """Return height and velocity at the end: free fall, a damped oscillation while the pad pushes, and free flight."""
    x0 = engages_at - PAD
    begin = cmath.sqrt(2.0 * (y - engages_at) / GRAVITY)
    v0 = -GRAVITY * begin
    omega, rest = cmath.sqrt(k - c * c / 4.0), -GRAVITY / k
    a = x0 - rest
    b = (v0 + 0.5 * c * a) / omega

    def contact(t: complex) -> tuple[complex, complex]:
        decay, cosine, sine = cmath.exp(-0.5 * c * t), cmath.cos(omega * t), cmath.sin(omega * t)
        x = decay * (a * cosine + b * sine)
        return rest + x, -0.5 * c * x + omega * decay * (b * cosine - a * sine)

    def end_of_contact(t: complex) -> complex:
        """Vanishes where the pad no longer pushes, or where a preloaded spring is back at its stop."""
        x, v = contact(t)
        return k * x + c * v if engages_at == PAD else x - x0

    if begin.real > end:
        return y - 0.5 * GRAVITY * end**2, -GRAVITY * end
    lasts: complex = 2.8 / omega.real
    for _ in range(50):  # Newton's method; the derivative of the pull by differences
        lasts -= end_of_contact(lasts) * 1e-6 / (end_of_contact(lasts + 1e-6) - end_of_contact(lasts))
    if begin.real + lasts.real > end:
        x, v = contact(end - begin)
        return PAD + x, v
    x, v = contact(lasts)
    rest_of_time = end - begin - lasts
    return PAD + x + v * rest_of_time - 0.5 * GRAVITY * rest_of_time**2, v - GRAVITY * rest_of_time


def expected(end: float, **known: float) -> np.ndarray:
    """Return the derivatives of height and velocity at the end with respect to y, k and c, by complex step."""
    values = [HEIGHT, STIFFNESS, DAMPING]
    columns = []
    for i in range(3):
        moved = [value + (1e-30j if i == j else 0.0) for j, value in enumerate(values)]
        columns.append([x.imag / 1e-30 for x in map(complex, bounce(*moved, end, **known))])
    return np.array(columns).T


MEASURES = ["final(bodies.ball.y)", "final(bodies.ball.vy)"]
