"""A two-link arm whose second link is geared to the ground, in coordinates of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from mbdkit import Mechanism

GRAVITY, HALF, LENGTH, MASS, INERTIA = 9.81, 0.5, 1.0, 1.0, 0.1
RATIO = 2.5
"""Angle of the second link divided by that of the first: (0.6 + 0.4) / 0.4."""


def links() -> Mechanism:
    """Return the arm without its transmission."""
    m = Mechanism(gravity=(0.0, -GRAVITY))
    m.body("a", mass=MASS, inertia=INERTIA, position=(HALF, 0.0))
    m.body("b", mass=MASS, inertia=INERTIA, position=(LENGTH + HALF, 0.0))
    m.revolute("A", m.ground, "a", at=(0.0, 0.0))
    m.revolute("B", "a", "b", at=(LENGTH, 0.0))
    return m


def geared() -> Mechanism:
    """Return the arm with a gear that rolls on one of the ground."""
    m = links()
    m.gear("G", m.ground, "b", radii=(0.6, 0.4), points=((0.0, 0.0), (-HALF, 0.0)))
    return m


def coupled() -> Mechanism:
    """Return the arm with a coupling of its angles."""
    m = links()
    m.coupling("G", "a", "b", equation=f"angle - {RATIO - 1.0}*first")
    return m


def crossed() -> Mechanism:
    """Return the arm with a belt over pulleys around its pins, which turns the second link in the same direction."""
    m = links()
    m.belt("G", m.ground, "b", radii=(0.3, 0.2), crossed=True, points=((0.0, 0.0), (-HALF, 0.0)))
    return m


def acceleration(a: Any, rate: Any) -> Any:
    """Return the second derivative of the angle of the first link [rad/s^2], by Lagrange's equation."""
    k, coupled_mass = RATIO, 2.0 * MASS * LENGTH * HALF * RATIO
    inertia = MASS * (HALF**2 + LENGTH**2 + (k * HALF) ** 2) + INERTIA * (1.0 + k**2)
    inertia = inertia + coupled_mass * np.cos((k - 1.0) * a)
    slope = -coupled_mass * (k - 1.0) * np.sin((k - 1.0) * a)
    weight = MASS * GRAVITY * ((HALF + LENGTH) * np.cos(a) + k * HALF * np.cos(k * a))
    return -(0.5 * slope * rate**2 + weight) / inertia


def exact(end: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the angles of both links and the torque of the transmission on the second one at a time, from rest."""
    found = solve_ivp(
        lambda t, y: [y[1], acceleration(*y)], (0.0, end), [0.0, 0.0], method="DOP853", rtol=1e-13, atol=1e-14
    )
    a, rate = found.y[:, -1]
    change, k = acceleration(a, rate), RATIO
    along = np.array([np.cos(k * a), np.sin(k * a)])
    at = LENGTH * (change * np.array([-np.sin(a), np.cos(a)]) - rate**2 * np.array([np.cos(a), np.sin(a)]))
    at += HALF * k * (change * np.array([-along[1], along[0]]) - k * rate**2 * along)
    lever, force = HALF * along, MASS * (at + np.array([0.0, GRAVITY]))
    torque = INERTIA * k * change + lever[0] * force[1] - lever[1] * force[0]
    return np.array([a, k * a]), torque
