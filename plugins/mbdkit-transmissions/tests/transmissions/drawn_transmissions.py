"""Drawn mechanisms: trees and loops of links with joints of all types of this part between them."""

from __future__ import annotations

import numpy as np

from mbdkit import Mechanism


def drawn(generator: np.random.Generator) -> Mechanism:
    """Return a mechanism of three to five links under gravity, of which one or two pairs are joined by functions.

    In about every second one, a rod between the ends of two links closes a loop.
    """
    m = Mechanism(gravity=(0.0, -9.81))
    count = int(generator.integers(3, 6))
    ends: dict[str, tuple[float, float]] = {m.ground: (0.0, 0.0)}
    parents: dict[str, str] = {}
    for i in range(count):
        name, parent = f"b{i}", str(generator.choice(list(ends)))
        (x, y), tilt, length = ends[parent], generator.uniform(-3.0, 3.0), generator.uniform(0.3, 0.8)
        along = length * np.array([np.cos(tilt), np.sin(tilt)])
        place = (float(x + along[0] / 2), float(y + along[1] / 2))
        m.body(name, mass=generator.uniform(0.5, 2.0), inertia=generator.uniform(0.02, 0.1), position=place)
        m.revolute(f"P{i}", parent, name, at=(x, y))
        ends[name], parents[name] = (float(x + along[0]), float(y + along[1])), parent
    joined = list(generator.permutation(list(parents)))[: int(generator.integers(1, 3))]
    for k, name in enumerate(joined):
        _join(m, generator, f"F{k}", parents[str(name)], str(name))
    if count > 3 and generator.integers(0, 2):
        first, second = (str(name) for name in generator.choice(list(parents), 2, replace=False))
        place = tuple(float(x) for x in np.mean([ends[first], ends[second]], axis=0))
        m.body("rod", mass=0.5, inertia=0.05, position=place)
        m.revolute("R0", first, "rod", at=ends[first])
        m.revolute("R1", second, "rod", at=ends[second])
    return m


def _join(m: Mechanism, generator: np.random.Generator, joint: str, parent: str, name: str) -> None:
    ratio = round(float(generator.uniform(-1.5, 1.5)), 2)
    x, y = m.bodies[name].position
    match int(generator.integers(0, 7)):
        case 0:
            m.coupling(joint, parent, name, equation=f"angle - {ratio}*first + 0.1*sin(second)")
        case 1:  # around the centres of mass, whose distance may change
            distance = float(np.hypot(x, y))
            m.gear(joint, m.ground, name, radii=(0.4 * distance, 0.6 * distance), pressure_angle=0.0)
        case 2:
            m.belt(joint, m.ground, name, radii=(0.05, 0.08))
        case 3:
            m.body(f"R{joint}", mass=0.5, inertia=0.01, position=(x, y - 0.1))
            m.prismatic(f"S{joint}", m.ground, f"R{joint}", at=(x, y - 0.1), axis=(1.0, 0.0))
            m.rack(joint, name, f"R{joint}", radius=0.1)
        case 4:  # a roller that moves freely around a cam
            m.body(f"R{joint}", mass=0.5, inertia=0.01, position=(x, y + 0.14))
            m.cam(joint, name, f"R{joint}", profile="0.1 + 0.02*sin(angle)**2", follower={"roller": 0.02})
        case 5:
            m.body(f"R{joint}", mass=0.3, inertia=0.002, position=(x, y + 0.1))
            m.rolling(joint, name, f"R{joint}", radius=0.1)
        case _:
            m.slot(joint, m.ground, name, curve={"y": f"{y} + 0.3*(x - {x}) + 0.4*(x - {x})**2"})
