"""A program that compiles a few kernels only, for tests of their cache."""

from __future__ import annotations

ACCELERATION = """\
import json
import mbdkit
from mbdkit.stepping import warm_up

def acceleration(*_):
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0), velocity=(0.0, 1.0), angular_velocity=2.0)
    m.revolute("A", m.ground, rod, points=((0.0, 0.0), (-0.5, 0.0)))
    equations = mbdkit.EquationsOfMotion.of(m)
    return float(equations.accelerations(0.0, equations.q0, equations.v0)[0][0])

warm_up._run_everything = acceleration  # a few kernels stand for all of them
warm_up.ensure_compiled()
"""
"""Defines `acceleration`: that along x of the centre of a horizontal rod that turns about its end at 2 rad/s."""
