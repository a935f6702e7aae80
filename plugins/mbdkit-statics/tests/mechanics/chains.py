"""Mechanisms with known statics and small motions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

import mbdkit

G = 9.81


def spec(model: dict[str, Any]) -> dict[str, Any]:
    return {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.1}}


def chain_stiffness_and_mass(lengths: Sequence[float], masses: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return K and M of uniform rods that hang in a chain, for their small tilts.

    Lagrange's equations by hand: rod i carries everything below it, so that its kinetic energy couples tilts i < j by
    L_i L_j (m_j / 2 + masses below j), and gravity gives g L_i (m_i / 2 + masses below i) on the diagonal alone.
    """
    n = len(lengths)
    below = [sum(masses[i + 1 :]) for i in range(n)]
    mass = np.empty((n, n))
    for i in range(n):
        mass[i, i] = lengths[i] ** 2 * (masses[i] / 3 + below[i])
        for j in range(i + 1, n):
            mass[i, j] = mass[j, i] = lengths[i] * lengths[j] * (masses[j] / 2 + below[j])
    stiffness = np.diag([G * lengths[i] * (masses[i] / 2 + below[i]) for i in range(n)])
    return stiffness, mass


def weight_on_a_spring(
    stiffness: float, damping: float, mass: float = 2.0, length: float = 1.0, gravity: float = G
) -> mbdkit.Mechanism:
    """Return a block on a vertical slide, hung on a spring-damper from the origin."""
    m = mbdkit.Mechanism(gravity=(0.0, -gravity))
    m.body("block", mass=mass, inertia=0.1, position=(0.0, -length))
    m.prismatic("slide", m.ground, "block", at=(0.0, 0.0), axis=(0.0, 1.0), angle=0.0)
    m.spring_damper(
        "spring", m.ground, "block", points=((0, 0), (0, 0)), stiffness=stiffness, damping=damping, free_length=length
    )
    return m


def hung_between(span: float, n: int, length: float) -> mbdkit.Mechanism:
    """Return n equal rods between two supports at one height; initially they lie on two straight lines."""
    m = mbdkit.Mechanism()
    slope = math.acos(span / (n * length))
    end, before = np.zeros(2), m.ground
    for i in range(n):
        angle = -slope if i < n // 2 else slope
        along = length * np.array([math.cos(angle), math.sin(angle)])
        m.body(f"r{i}", mass=1.0, inertia=length**2 / 12, position=end + along / 2, angle=angle)
        m.revolute(f"J{i}", before, f"r{i}", at=end)
        end, before = end + along, f"r{i}"
    m.revolute("end", before, m.ground, points=((length / 2, 0.0), (span, 0.0)))
    return m
