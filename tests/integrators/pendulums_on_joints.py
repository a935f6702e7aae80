"""Pendulums and a floating body, whose motion Lagrange's equations give."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from tests.studies import test_lanes

from mbdkit.mechanism.mechanism import Mechanism
from tests.engine.random_mechanisms import add_rod, chain, driven_frame, loop, slides, tree
from tests.integrators.running import driven_chain

JOINT = "joint-coordinates"


def floating(rng: np.random.Generator) -> Mechanism:
    """Return a tree of pins on a free body beside one on the ground, without any force but gravity."""
    m = tree(rng, 5)
    end = add_rod(m, rng, "root", np.array([3.0, 1.0]), 0.3)
    for name, angle in (("a", 1.0), ("b", -1.0)):
        add_rod(m, rng, name, end, angle)
        m.revolute(name, name, "root", at=end)
    return m


def by_driver(rng: np.random.Generator) -> Mechanism:
    """Return a chain with a spring and a torque that is driven at its root."""
    return driven_chain()


KINDS: dict[str, tuple[Callable[[np.random.Generator], Mechanism], set[str], int]] = {
    "chain": (chain, set(), 6),
    "tree": (tree, set(), 9),
    "floating": (floating, set(), 10),
    "driven": (by_driver, set(), 3),
    "slides": (slides, set(), 5),
    "rolling": (test_lanes.rolling, {"lift"}, 5),
    "laws": (test_lanes.with_laws, set(), 3),
    "blade": (test_lanes.blade, set(), 13),
    "frame": (driven_frame, {"x", "y"}, 6),
    "loop": (loop, {"J3", "rod"}, 4),
}
"""Mechanisms, the joints that their spanning trees cut, and the number of coordinates counted by hand."""


def forced_pendulum() -> Mechanism:
    """Return two rods of 1 m and 1 kg, the first driven by a torque of 2 cos(3 t), the second on a spring."""
    m = Mechanism()
    end = np.zeros(2)
    for i, angle in enumerate((-1.0, -0.4)):
        along = np.array([np.cos(angle), np.sin(angle)])
        m.body(f"r{i}", mass=1.0, inertia=1 / 12, position=end + along / 2, angle=angle)
        end = end + along
    m.revolute("A", m.ground, "r0", points=((0, 0), (-0.5, 0)))
    m.revolute("B", "r0", "r1", points=((0.5, 0), (-0.5, 0)))
    m.torque("drive", "r0", value="2*cos(3*t)")
    m.torsion_spring("spring", "r0", "r1", stiffness=4.0, damping=0.3)
    return m


def lagrange(t: float, y: np.ndarray) -> np.ndarray:
    """Return the rates of the two angles and of their rates by Lagrange's equations of the forced pendulum."""
    a, b, u, w = y
    g, c, s = 9.81, np.cos(a - b), np.sin(a - b)
    couple = -4.0 * (b - a) - 0.3 * (w - u)
    mass = np.array([[1 / 12 + 0.25 + 1.0, 0.5 * c], [0.5 * c, 1 / 12 + 0.25]])
    right = [
        -0.5 * s * w * w - 1.5 * g * np.cos(a) + 2 * np.cos(3 * t) - couple,
        0.5 * s * u * u - 0.5 * g * np.cos(b) + couple,
    ]
    return np.array([u, w, *np.linalg.solve(mass, right)])
