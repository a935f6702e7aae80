"""Random mechanisms for hypothesis: trees and loops of every joint and force, started near a pose that fits.

A pose is drawn first and joints are put where they fit it, so that loops close. A joint that would leave constraints
dependent, or nearly so, is left out, so that no drawn mechanism has to be thrown away for that.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pprint import pformat
from typing import Any, get_args

from hypothesis import strategies as st
from hypothesis.strategies import DrawFn

from mbdkit.mechanism.beams import parts_of
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.forces import Force
from mbdkit.mechanism.joints import Distance, Driver, Joint
from mbdkit.mechanism.mechanism import Mechanism

from .by_hand import ByHand

LONGEST = 0.5
"""How long a drawn mechanism's tables and expressions can be run for [s]."""

KNOTS = 0.25
"""Time between two points of a drawn table [s], which begin at the start: steps that divide this end on them."""

WELL_CONDITIONED = 0.1
"""Least singular value of the scaled Jacobian, see `ByHand.conditioning`, that a joint may leave at the pose."""

APART = 0.3
"""Least distance of the two ends of a distance joint or a spring at the pose [m]."""

Vector = tuple[float, float]


class Drawn:
    """A mechanism that nearly meets its joints, the time of its start [s], and the same with its elements reordered."""

    def __init__(self, mechanism: Mechanism, start: float, reordered: Mechanism):
        self.mechanism, self.start, self.reordered = mechanism, start, reordered

    def __repr__(self) -> str:
        return f"start: {self.start}\n{pformat(self.mechanism.to_spec(), sort_dicts=False, width=120)}"


def number(draw: DrawFn, least: float, most: float, digits: int = 2) -> float:
    """Draw a decimal number; it shrinks towards 0, or towards the least."""
    ten = 10**digits
    return draw(st.integers(round(least * ten), round(most * ten))) / ten


def vector(draw: DrawFn, most: float) -> Vector:
    return number(draw, -most, most), number(draw, -most, most)


def moved(point: Vector, by: Vector) -> Vector:
    return point[0] + by[0], point[1] + by[1]


def middle(p: Vector, q: Vector) -> Vector:
    return (p[0] + q[0]) / 2, (p[1] + q[1]) / 2


NAMES = st.sampled_from(
    [
        "a",
        "b",
        "c",
        "rod 1",
        "no",
        "~",
        "1e3",
        "0x1",
        "null",
        "2:30",
        "# 1",
        "{x}",
        "a: b",
        "'",
        '"',
        "- -",
        "鉸鏈",
        "🦵",
    ]
) | st.text(st.characters(exclude_categories=["C", "Z"], exclude_characters="/."), min_size=1, max_size=5)
"""Names, some of which YAML takes for something else unless they are quoted."""


def names(draw: DrawFn, count: int) -> list[str]:
    """Draw different names; nothing is rejected, which would make mechanisms of many bodies rare."""
    found: list[str] = []
    for index in range(count):
        name = draw(NAMES)
        found.append(name if name not in found else f"{name}{index}")
    return found


# ---- motions -----------------------------------------------------------------------------------------------------

EXPRESSIONS = (
    "sin({w}*{s})", "1 - cos({w}*{s})", "tan({s})", "tanh({w}*{s})", "exp({s}) - 1", "exp(-{s}) - 1", "{s}**2", "{s}",
    "(1 + {s})**3 - 1", "sqrt(1 + {w}*{s}) - 1", "log(1 + {s}**2)", "atan({w}*{s})", "atan2({s}, 2)", "asin({s}/2)",
    "pi/2 - acos({s}/2)", "abs({s} + 3) - 3", "max({s}, {s} - 1)", "min(2*{s}, 4)", "{s}/(1 + {s})", "-{s}**1.0",
    "(2 + sin({s}))**(1 + {s}) - 2",
)  # fmt: skip
"""Functions of the time `s` since the start that begin at 0 and are smooth; `w` is a circular frequency."""


def motion(draw: DrawFn, start: float, value: float, size: float) -> Any:
    """Draw a number, an expression or a table that has a `value` at the `start`, and goes about `size` away from it."""
    kind = draw(st.sampled_from(["number", "expression", "table"]))
    if kind == "number":
        return value
    if kind == "expression":
        since = "t" if start == 0 else f"(t - {start!r})" if start > 0 else f"(t + {-start!r})"
        text = draw(st.sampled_from(EXPRESSIONS)).format(s=since, w=number(draw, 0.5, 4, digits=1))
        return f"{value!r} + {number(draw, -size, size)!r}*({text})"
    away = [0.25 * number(draw, -size, size) for _ in range(4)]
    times = [start + KNOTS * k for k in range(-1, 4)]
    shape = draw(
        st.sampled_from([{}, {"ends": "natural"}, {"ends": "clamped"}, {"interpolation": "quintic", "ends": "natural"}])
    )
    return {"table": [times, [value + away[0], value, *(value + x for x in away[1:])]], **shape}


# ---- bodies ------------------------------------------------------------------------------------------------------


def add_body(draw: DrawFn, m: Mechanism, name: str, near: Vector) -> None:
    """Add a rigid body or a point mass near a point, with random velocities."""
    kind = draw(st.sampled_from(["rigid", "rigid", "rigid", "point mass"]))
    rigid: dict[str, float] = {}
    if kind == "rigid":
        rigid = {
            "inertia": number(draw, 0.05, 0.5),
            "angle": number(draw, -3.5, 3.5),
            "angular_velocity": number(draw, -1.5, 1.5),
        }
    position = moved(near, vector(draw, 1.0))
    m.body(name, mass=number(draw, 0.5, 3), position=position, velocity=vector(draw, 1.0), **rigid)


def is_point_mass(m: Mechanism, name: str) -> bool:
    return name != GROUND and m.bodies[name].inertia is None


def centre(m: Mechanism, name: str) -> Vector:
    return m.to_global(name, (0.0, 0.0))


def a_point(draw: DrawFn, m: Mechanism, body: str, near: Vector, most: float = 0.6) -> Vector:
    """Draw where something can hold `body`: a global point near another; a point mass is held at its place."""
    return centre(m, body) if is_point_mass(m, body) else moved(near, vector(draw, most))


def local(m: Mechanism, body: str, point: Vector) -> Vector:
    """Return a global point in a body's frame, exactly (0, 0) for a point mass."""
    return (0.0, 0.0) if is_point_mass(m, body) else m.to_local(body, point)


def between(m: Mechanism, a: str, b: str) -> Vector:
    """Return a point between two bodies; the ground is everywhere."""
    here, there = (centre(m, name) for name in (a, b))
    return there if a == GROUND else here if b == GROUND else middle(here, there)


def add_beam(draw: DrawFn, m: Mechanism, name: str, holder: str) -> tuple[str, ...]:
    """Add a soft beam near a body, straight or curved, bent at the start, welded or pinned there; return its nodes."""
    elements, nodes = draw(st.integers(1, 2)), draw(st.sampled_from([2, 3]))
    first, along = moved(centre(m, holder), vector(draw, 0.3)), vector(draw, 0.5)
    last = moved(first, (along[0] + 1.0, along[1]))
    shape: dict[str, Any] = {"a": first, "b": last}
    if draw(st.booleans()):
        shape = {"points": [first, moved(middle(first, last), (0.0, 0.2)), last]}
    names = m.beam(
        name, **shape, elements=elements, nodes=nodes, mass_per_length=number(draw, 0.5, 2),
        stiffness={"axial": number(draw, 10, 40), "shear": number(draw, 10, 40), "bending": number(draw, 0.2, 2)},
        rotary_inertia=number(draw, 0.05, 0.2), damping=draw(st.sampled_from([0.0, 0.02])), velocity=vector(draw, 0.5),
        angular_velocity=number(draw, -1, 1),
    )  # fmt: skip
    if is_point_mass(m, holder) or draw(st.booleans()):
        return names
    if draw(st.booleans()):
        m.weld(f"{name} root", holder, names[0], at=first)
    else:
        m.revolute(f"{name} root", holder, names[0], at=first)
    return names


# ---- joints ------------------------------------------------------------------------------------------------------
# Each adds a joint `name` to `m` that fits the pose, and returns whether it could.


def revolute(draw: DrawFn, m: Mechanism, name: str, a: str, b: str, start: float) -> bool:
    held = [body for body in (a, b) if is_point_mass(m, body)]
    if len(held) == 2:
        return False
    at = a_point(draw, m, held[0] if held else a, between(m, a, b))
    m.revolute(name, a, b, points=(local(m, a, at), local(m, b, at)))
    return True


def prismatic(draw: DrawFn, m: Mechanism, name: str, a: str, b: str, start: float) -> bool:
    if is_point_mass(m, a) or is_point_mass(m, b):
        return False
    tilt, along = number(draw, -3, 3), number(draw, -1, 1)
    at = a_point(draw, m, a, between(m, a, b))
    slider = moved(at, (along * math.cos(tilt), along * math.sin(tilt)))
    inward = tilt - m.relative_angle(GROUND, a)
    scale = draw(st.sampled_from([1.0, 0.2, 5.0]))
    m.prismatic(
        name,
        a,
        b,
        points=(local(m, a, at), local(m, b, slider)),
        axis=(scale * math.cos(inward), scale * math.sin(inward)),
        angle=draw(st.sampled_from([None, m.relative_angle(a, b)])),
    )
    return True


def point_on_line(draw: DrawFn, m: Mechanism, name: str, a: str, b: str, start: float) -> bool:
    """Add a pin of `b`, which may be a point mass, in a slot of `a`."""
    if is_point_mass(m, a):
        return False
    pin = a_point(draw, m, b, between(m, a, b))
    tilt, along = number(draw, -3, 3), number(draw, -1, 1)
    at = moved(pin, (along * math.cos(tilt), along * math.sin(tilt)))
    inward = tilt - m.relative_angle(GROUND, a)
    scale = draw(st.sampled_from([1.0, 0.2, 5.0]))
    axis = (scale * math.cos(inward), scale * math.sin(inward))
    m.point_on_line(name, a, b, points=(local(m, a, at), local(m, b, pin)), axis=axis)
    return True


def weld(draw: DrawFn, m: Mechanism, name: str, a: str, b: str, start: float) -> bool:
    if is_point_mass(m, a) or is_point_mass(m, b):
        return False
    at = a_point(draw, m, a, between(m, a, b))
    angle = draw(st.sampled_from([None, m.relative_angle(a, b)]))
    m.weld(name, a, b, points=(local(m, a, at), local(m, b, at)), angle=angle)
    return True


def distance(draw: DrawFn, m: Mechanism, name: str, a: str, b: str, start: float) -> bool:
    near = [between(m, a, b) if body == GROUND else centre(m, body) for body in (a, b)]
    p, q = (a_point(draw, m, body, point) for body, point in zip((a, b), near, strict=True))
    if math.dist(p, q) < APART:
        return False
    m.distance(name, a, b, points=(local(m, a, p), local(m, b, q)), length=math.dist(p, q))
    return True


def driver(draw: DrawFn, m: Mechanism, name: str, a: str, b: str, start: float) -> bool:
    coordinate = draw(st.sampled_from(["angle", "x", "y"]))
    if is_point_mass(m, a) or (coordinate == "angle" and is_point_mass(m, b)):
        return False
    points = None
    if coordinate == "angle":
        value = m.relative_angle(a, b)
    else:
        held = a_point(draw, m, b, centre(m, b) if b != GROUND else centre(m, a))
        if draw(st.booleans()) and b != GROUND:
            held = centre(m, b)  # and leave the points out
        else:
            points = ((0.0, 0.0), local(m, b, held))
        value = m.to_local(a, held)[coordinate == "y"]
    m.driver(name, a, b, coordinate=coordinate, motion=motion(draw, start, value, 0.3), points=points)
    return True


JOINTS: tuple[Callable[[DrawFn, Mechanism, str, str, str, float], bool], ...] = (
    revolute, prismatic, point_on_line, weld, distance, driver,
)  # fmt: skip
assert len(JOINTS) == len(get_args(get_args(Joint)[0])), "every type of joint is drawn"


def add_joint(draw: DrawFn, m: Mechanism, name: str, a: str, b: str, start: float) -> None:
    """Add a random joint between two bodies where one fits."""
    ends = (a, b) if draw(st.booleans()) else (b, a)
    if not draw(st.sampled_from(JOINTS))(draw, m, name, *ends, start):
        return
    hand = ByHand(m)
    if hand.conditioning(hand.q, start) < WELL_CONDITIONED:
        del m.joints[name]


# ---- forces ------------------------------------------------------------------------------------------------------
# Each adds a force element `name` to `m` where one fits. A new type of force element gets its own function here, a
# place in FORCES, and its equations in `ByHand.actions`.


def spring_damper(draw: DrawFn, m: Mechanism, name: str, a: str, b: str, start: float) -> None:
    near = [between(m, a, b) if body == GROUND else centre(m, body) for body in (a, b)]
    p, q = (a_point(draw, m, body, point) for body, point in zip((a, b), near, strict=True))
    if math.dist(p, q) >= APART:
        m.spring_damper(
            name,
            a,
            b,
            points=(local(m, a, p), local(m, b, q)),
            stiffness=number(draw, 0, 40, 0),
            damping=number(draw, 0, 2, 1),
            free_length=number(draw, 0, 1, 1),
        )


def torsion_spring(draw: DrawFn, m: Mechanism, name: str, a: str, b: str, start: float) -> None:
    if not (is_point_mass(m, a) or is_point_mass(m, b)):
        m.torsion_spring(
            name,
            a,
            b,
            stiffness=number(draw, 0, 4, 1),
            damping=number(draw, 0, 0.3),
            free_angle=number(draw, -2, 2, 1),
        )


def torque(draw: DrawFn, m: Mechanism, name: str, a: str, b: str, start: float) -> None:
    body, other = (b, a) if a == GROUND else (a, b)
    if is_point_mass(m, body):
        return
    reaction = None if is_point_mass(m, other) else draw(st.sampled_from([None, other]))
    m.torque(name, body, value=load(draw, start, 0.5), reaction_body=reaction)


def force(draw: DrawFn, m: Mechanism, name: str, a: str, b: str, start: float) -> None:
    body = b if a == GROUND else a
    at = a_point(draw, m, body, centre(m, body))
    frame = "global" if is_point_mass(m, body) else draw(st.sampled_from(["global", "body"]))
    value = [load(draw, start, 5.0), load(draw, start, 5.0)]
    m.force(name, body, value=value, point=local(m, body, at), frame=frame)


def law(draw: DrawFn, m: Mechanism, name: str, a: str, b: str, start: float) -> None:
    """Add a law of the package; a one-sided one is well in touch or well out of it, since it has a kink between."""
    along = draw(st.sampled_from(["line", "angle", "x", "y"]))
    if (is_point_mass(m, a) and along != "line") or (is_point_mass(m, b) and along == "angle"):
        return
    points = None
    if along == "angle":
        length = m.relative_angle(a, b)
    else:
        near = [between(m, a, b) if body == GROUND else centre(m, body) for body in (a, b)]
        p, q = (a_point(draw, m, body, point) for body, point in zip((a, b), near, strict=True))
        if along == "line" and math.dist(p, q) < APART:
            return
        points = (local(m, a, p) if along == "line" else (0.0, 0.0), local(m, b, q))
        length = math.dist(p, q) if along == "line" else m.to_local(a, q)[along == "y"]
    stiffness, damping = number(draw, 0, 10, 0), number(draw, 0, 0.5, 1)
    kind = draw(st.sampled_from(["linear", "one-sided", "table"]))
    options: dict[str, Any] = {"stiffness": stiffness, "damping": damping, "free_length": number(draw, -1, 1, 1)}
    if kind == "one-sided":
        far = draw(st.sampled_from([-4.0, 4.0]))
        options |= {"free_length": length + far, "acts": draw(st.sampled_from(["tension", "compression"]))}
    elif kind == "table":
        lengths = [length + x for x in (-3.0, -1.0, 0.5, 2.0, 4.0)]
        forces = [stiffness * (x - length) + number(draw, -2, 2, 1) for x in lengths]
        options = {"table": [lengths, forces], "damping": damping}
    m.law(name, a, b, law=kind, along=along, points=points, **options)


def load(draw: DrawFn, start: float, size: float) -> Any:
    return motion(draw, start, number(draw, -size, size), size)


FORCES: tuple[Callable[[DrawFn, Mechanism, str, str, str, float], None], ...] = (
    spring_damper, torsion_spring, torque, force, law,
)  # fmt: skip
assert len(FORCES) == len(get_args(get_args(Force)[0])), "every type of force is drawn"


# ---- mechanisms --------------------------------------------------------------------------------------------------


def disturb(draw: DrawFn, m: Mechanism) -> None:
    """Move the start away from the pose, but for angles that a joint takes over as they are given."""
    taken = {
        name
        for joint in m.joints.values()
        if not isinstance(joint, Distance | Driver) and getattr(joint, "angle", 0.0) is None
        for name in joint.bodies
    }
    nodes = parts_of(m.beams)
    for name, body in m.bodies.items():
        if name in nodes:  # which are where their beam says
            continue
        change: dict[str, Any] = {"position": moved(body.position, vector(draw, 0.03))}
        if body.inertia is not None and name not in taken:
            change["angle"] = body.angle + number(draw, -0.03, 0.03)
        m.bodies[name] = body.model_copy(update=change)


@st.composite
def mechanisms(draw: DrawFn, most_bodies: int = 6, most_loops: int = 3, most_forces: int = 4) -> Drawn:
    """Draw a tree of bodies with joints that close loops, drivers and forces, disturbed or not.

    Parameters
    ----------
    draw
        From hypothesis.
    most_bodies, most_loops, most_forces
        Largest number of bodies, of attempts at a joint beside those of the tree, and at a force.
    """
    start = draw(st.sampled_from([0.0, 0.5, -1.25, 2.0]))
    m = Mechanism(gravity=draw(st.sampled_from([(0.0, -9.81), (0.0, 0.0), (3.0, -4.0)])))
    bodies = names(draw, draw(st.integers(1, most_bodies)))
    loops = draw(st.integers(0, most_loops))
    joints = iter(names(draw, len(bodies) + loops))
    placed = [GROUND]
    for name in bodies:
        parent = draw(st.sampled_from(placed[::-1]))
        add_body(draw, m, name, centre(m, parent))
        if draw(st.integers(0, 9)) < 9:  # else it is held by a later joint, or falls
            add_joint(draw, m, next(joints), parent, name, start)
        placed.append(name)
    for _ in range(loops):
        add_joint(draw, m, next(joints), *two(draw, placed), start)
    if draw(st.integers(0, 3)) == 0:
        placed += add_beam(draw, m, f"{bodies[0]} beam", draw(st.sampled_from(placed)))
    for name in names(draw, draw(st.integers(0, most_forces))):
        draw(st.sampled_from(FORCES))(draw, m, name, *two(draw, placed), start)
    if draw(st.booleans()):
        disturb(draw, m)
    m.validate()
    return Drawn(m, start, reordered(draw, m))


def reordered(draw: DrawFn, m: Mechanism) -> Mechanism:
    """Return the same mechanism with bodies, joints and forces written in another order."""
    other = Mechanism(m.gravity)
    for kind in ("bodies", "joints", "forces"):
        elements = getattr(m, kind)
        setattr(other, kind, {name: elements[name] for name in draw(st.permutations(list(elements)))})
    other.beams = m.beams
    return other


def two(draw: DrawFn, placed: list[str]) -> tuple[str, str]:
    """Draw two different bodies, the ground among them."""
    a, b = draw(st.permutations(placed))[:2]
    return a, b
