"""Two linkages with all kinds of forces, and their equations in SymPy."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

import mbdkit
from mbdkit import EquationsOfMotion
from tests.integrators.running import driven_chain

RNG = np.random.default_rng(20)


def slider_crank() -> mbdkit.Mechanism:
    """Return a crank, a rod and a sliding block with a spring, a turning force on the rod, and a driven crank."""
    m = mbdkit.Mechanism(gravity=(0.3, -9.7))
    m.body("crank", mass=1.3, inertia=0.1, position=(0.2, 0.2), angle=0.8)
    m.body("rod", mass=0.7, inertia=0.2, position=(1.0, 0.2), angle=-0.4)
    m.body("block", mass=2.0, inertia=0.3, position=(1.7, 0.0))
    m.revolute("A", m.ground, "crank", points=((0.0, 0.0), (-0.3, 0.0)))
    m.revolute("B", "crank", "rod", points=((0.3, 0.0), (-0.8, 0.0)))
    m.revolute("C", "rod", "block", points=((0.8, 0.0), (0.0, 0.0)))
    m.prismatic("D", m.ground, "block", points=((0.0, 0.0), (0.0, 0.0)), axis=(1.0, 0.0), angle=0.0)
    m.spring_damper("s", "crank", "block", points=((0.1, 0.2), (0.0, 0.3)), stiffness=31.0, damping=1.7)
    m.force("push", "rod", point=(0.1, 0.4), value=(1.5, "2*cos(t)"))
    return m


def moved_slider_crank() -> mbdkit.Mechanism:
    """Return the same without a freedom left: as many constraint rows as coordinates."""
    m = slider_crank()
    m.driver("motor", m.ground, "crank", coordinate="angle", motion="0.8 + 0.3*sin(2*t)")
    return m


MECHANISMS = {"driven chain": driven_chain, "slider-crank": slider_crank, "moved slider-crank": moved_slider_crank}


@cache
def symbolic(name: str) -> Any:
    return MECHANISMS[name]().to_sympy()


def somewhere(p: EquationsOfMotion) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return a state off the constraints, with accelerations and multipliers that solve nothing."""
    q = p.q0 + 0.05 * RNG.standard_normal(p.n)
    return q, RNG.standard_normal(p.n), RNG.standard_normal(p.n), RNG.standard_normal(p.m)


def parallelogram(angle: float, cranks: int) -> mbdkit.Mechanism:
    """Return a coupler of 3 m on cranks of 1 m at the same angle; every crank beyond the second is redundant."""
    m = mbdkit.Mechanism()
    tip = np.array([math.cos(angle), math.sin(angle)])
    m.body("coupler", mass=2.0, inertia=1.5, position=(tip[0] + 1.5, tip[1]))
    for k, base in enumerate((0.0, 3.0, 1.0)[:cranks]):
        foot = np.array([base, 0.0])
        m.body(f"crank{k}", mass=1.0 + 0.2 * k, inertia=0.1, position=foot + tip / 2, angle=angle)
        m.revolute(f"foot{k}", m.ground, f"crank{k}", at=foot)
        m.revolute(f"top{k}", f"crank{k}", "coupler", at=foot + tip)
    m.torque("motor", "crank0", value="3*cos(t)")
    return m
