"""Mechanisms with random bodies, joints and velocities: chains, trees, loops, ladders; held and driven."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from mbdkit.mechanism.mechanism import Mechanism


def add_rod(m: Mechanism, rng: np.random.Generator, name: str, start: np.ndarray, angle: float) -> np.ndarray:
    """Add a rod of random mass that starts at `start`, with random velocities; return its other end."""
    length = rng.uniform(0.5, 1.5)
    along = length * np.array([math.cos(angle), math.sin(angle)])
    mass = rng.uniform(0.5, 2.0)
    moving = {"velocity": rng.normal(size=2), "angular_velocity": rng.normal()}
    m.body(name, mass=mass, inertia=mass * length**2 / 12, position=start + along / 2, angle=angle, **moving)
    return start + along


def chain(rng: np.random.Generator, n: int = 6) -> Mechanism:
    """Return n rods in a row, from the ground."""
    m = Mechanism()
    end, before = np.zeros(2), m.ground
    for i in range(n):
        joint = end
        end = add_rod(m, rng, f"r{i}", joint, rng.uniform(-3, 3))
        m.revolute(f"J{i}", before, f"r{i}", at=joint)
        before = f"r{i}"
    return m


def tree(rng: np.random.Generator, n: int = 9) -> Mechanism:
    """Return rods that each hang on a random earlier one, some on the ground."""
    m = Mechanism()
    ends = [np.zeros(2)]
    for i in range(n):
        parent = int(rng.integers(0, i + 1))
        joint = ends[parent]
        ends.append(add_rod(m, rng, f"r{i}", joint, rng.uniform(-3, 3)))
        m.revolute(f"J{i}", m.ground if parent == 0 else f"r{parent - 1}", f"r{i}", at=joint)
    return m


def loop(rng: np.random.Generator, n: int = 5) -> Mechanism:
    """Return a chain closed to the ground, driven at its root, with a distance joint and a slider on the way."""
    m = chain(rng, n)
    last = m.bodies[f"r{n - 1}"]
    m.revolute("close", f"r{n - 1}", m.ground, at=last.position)
    m.driver("motor", m.ground, "r0", coordinate="angle", motion="0.3 + 2*t**2 + sin(t)")
    m.distance("rod", "r1", f"r{n - 2}", points=((0.1, 0.2), (-0.1, 0.1)), length=1.0)
    return m


def ladder(rng: np.random.Generator, rungs: int = 4) -> Mechanism:
    """Return two chains from the ground, tied together at every joint by distance joints."""
    m = Mechanism()
    for side in range(2):
        end, before = np.array([1.5 * side, 0.0]), m.ground
        for i in range(rungs):
            joint = end
            end = add_rod(m, rng, f"{'ab'[side]}{i}", joint, -math.pi / 2 + rng.uniform(-0.4, 0.4))
            m.revolute(f"{'AB'[side]}{i}", before, f"{'ab'[side]}{i}", at=joint)
            before = f"{'ab'[side]}{i}"
    for i in range(rungs):
        m.distance(f"rung{i}", f"a{i}", f"b{i}", points=((0.1, 0.0), (0.1, 0.0)), length=1.5)
    return m


def driven_frame(rng: np.random.Generator) -> Mechanism:
    """Return a free frame that carries a point mass driven along both of its axes, and springs and loads."""
    m = Mechanism()
    add_rod(m, rng, "frame", np.zeros(2), 0.4)
    m.body("mass", mass=0.7, position=(0.3, 0.8), velocity=rng.normal(size=2))
    m.driver("x", "frame", "mass", coordinate="x", motion="0.5*cos(3*t)")
    m.driver("y", "frame", "mass", coordinate="y", motion="0.2 + t**2")
    m.spring_damper("s", m.ground, "mass", points=((1.0, 1.0), (0.0, 0.0)), stiffness=30.0, damping=2.0)
    m.torsion_spring("twist", m.ground, "frame", stiffness=3.0, damping=0.3)
    m.torque("drive", "frame", value="cos(t)")
    m.force("push", "frame", value=[1.0, "2*t"], point=(0.1, 0.2))
    return m


def slides(rng: np.random.Generator) -> Mechanism:
    """Return an arm pinned to the ground with a frame on its slide, a rod in the frame's and one welded to that."""
    m = Mechanism()
    for i, name in enumerate(("arm", "frame", "rod", "fin")):
        add_rod(m, rng, name, rng.normal(size=2), float(i) - 1.0)
    m.revolute("pivot", m.ground, "arm", points=((0.1, 0.2), (-0.4, 0.1)))
    m.prismatic("long", "arm", "frame", points=((0.2, 0.0), (-0.1, 0.1)), axis=(3.0, -1.0), angle=1.1)
    m.prismatic("cross", "rod", "frame", points=((0.0, 0.1), (0.3, 0.2)), axis=(0.2, 0.5))
    m.weld("foot", "rod", "fin", points=((-0.3, 0.0), (0.1, 0.4)))
    m.spring_damper("s", "arm", "rod", points=((0.0, 0.4), (0.2, 0.0)), stiffness=20.0, damping=1.0)
    add_rod(m, rng, "roller", rng.normal(size=2), 0.5)
    m.point_on_line("slot", "frame", "roller", points=((0.1, -0.2), (0.3, 0.1)), axis=(0.4, 1.0))
    return m


def flexible(rng: np.random.Generator, elements: int = 2) -> Mechanism:
    """Return a rod between a straight beam from the ground and a curved one, both damped, bent and in motion."""
    m = Mechanism()
    stiffness = {"axial": 90.0, "shear": 40.0, "bending": 5.0}
    common = {"elements": elements, "stiffness": stiffness, "mass_per_length": 0.8, "damping": 0.05}
    arm = m.beam("arm", a=(0.0, 0.0), b=(1.0, 0.3), nodes=2, **common)
    rod_end = add_rod(m, rng, "rod", np.array([1.0, 0.3]), rng.uniform(-3, 3))
    points = [rod_end, rod_end + rng.uniform(0.3, 0.6, 2), rod_end + np.array([1.0, 0.1])]
    hook = m.beam("hook", points=points, nodes=3, load=(0.5, "sin(t)"), load_frame="body", **common)
    m.weld("clamp", m.ground, arm[0], at=(0.0, 0.0))
    m.revolute("pin", arm[-1], "rod", at=(1.0, 0.3))
    m.weld("bolts", "rod", hook[0], at=rod_end)
    for name, body in m.bodies.items():  # bent by more than joints would, and turned several times
        if name in hook[1:]:
            x, y = np.array(body.position) + rng.normal(0.0, 0.1, 2)
            m.bodies[name] = body.model_copy(
                update={"position": (x, y), "angle": body.angle + 4 * math.pi + rng.normal(0.0, 0.3)}
            )
    return m


KINDS: dict[str, Callable[[np.random.Generator], Mechanism]] = {
    "chain": chain,
    "tree": tree,
    "loop": loop,
    "ladder": ladder,
    "driven frame": driven_frame,
    "slides": slides,
}
