"""Reads linkages of pylinkage, in the JSON format of `pylinkage.mechanism.mechanism_to_json`."""

from __future__ import annotations

import json
import math
from itertools import pairwise

from mbdkit import Mechanism
from mbdkit.plugin import listed
from mbdkit_robots.documents import read_content
from mbdkit_robots.planar import GROUND, refused

#: Keys that the reader understands: those that pylinkage writes for pins, links and cranks.
UNDERSTOOD = {
    "mechanism": ("name", "joints", "links", "ground"),
    "joint": ("id", "type", "position", "name"),
    "link": ("id", "type", "joints", "name", "motor_joint", "angular_velocity", "initial_angle"),
}


def read_linkage(file: str, *, steps_per_second: float, mass_per_length: float) -> Mechanism:
    """Return the mechanism of a JSON file of pylinkage.

    Parameters
    ----------
    steps_per_second
        Number of pylinkage steps per second. The angular velocities of pylinkage are given in radians per step.
    mass_per_length
        Mass per length of the lines through the joints of a link [kg/m]; links are thin rods.

    Raises
    ------
    SpecError
        If the file does not describe such a linkage, or has joints other than pins.
    """
    content = read_content(file)
    try:
        data = json.loads(content)
        joints = {joint["id"]: joint for joint in data["joints"]}
        links = [(link["id"], link.get("type", "link"), link["joints"], link) for link in data["links"]]
        places = {name: (float(joint["position"][0]), float(joint["position"][1])) for name, joint in joints.items()}
    except (ValueError, KeyError, TypeError, IndexError, RecursionError):
        raise refused(f"{file} is no mechanism of pylinkage, as mechanism_to_json writes it") from None
    if wrong := [name for name, joint in joints.items() if joint.get("type") not in ("ground", "revolute")]:
        raise refused(f"joints other than pins are not read: {listed(wrong)}")
    m = Mechanism(name=str(data.get("name") or "linkage"))
    for what, items in (("mechanism", [data]), ("joint", joints.values()), ("link", [link for *_, link in links])):
        if unknown := dict.fromkeys(f"'{key}'" for item in items for key in item if key not in UNDERSTOOD[what]):
            m.left_out += (f"keys of the {what} left out, which may change the motion: {listed(unknown)}",)
    at: dict[str, list[str]] = {name: [GROUND] for name, joint in joints.items() if joint.get("type") == "ground"}
    for name, kind, ids, one in links:
        if kind == "ground":
            continue
        if kind not in ("link", "driver"):
            raise refused(f"link '{name}' has the type '{kind}', which is not read")
        if unknown := [str(joint) for joint in ids if joint not in places]:
            raise refused(f"link '{name}' has joints that do not exist: {listed(unknown)}")
        _add_rod(m, name, [places[joint] for joint in ids], mass_per_length)
        for joint in ids:
            at.setdefault(joint, []).append(name)
        if kind == "driver":
            rate = _crank_rate(name, one, places) * steps_per_second
            m.driver(f"{name} motor", GROUND, name, coordinate="angle", motion=f"{m.bodies[name].angle!r} + {rate!r}*t")
    for joint, bodies in at.items():
        for k, body in enumerate(bodies[1:]):
            m.revolute(joint if k == 0 else f"{joint} {k + 1}", bodies[0], body, at=places[joint])
        if len(bodies) == 1 and bodies[0] != GROUND:
            m.marker(joint, bodies[0], at=places[joint])
    return m


def _crank_rate(name: str, link: dict[str, object], places: dict[str, tuple[float, float]]) -> float:
    """Return the rate of a crank [rad/step]; raise SpecError if its motor, rate or initial angle is wrong."""
    motor, rate, angle = link.get("motor_joint"), link.get("angular_velocity"), link.get("initial_angle", 0.0)
    if motor not in places or not isinstance(rate, int | float) or not isinstance(angle, int | float):
        raise refused(f"link '{name}' is a driver without a motor_joint among the joints or without numbers as angles")
    x, y = places[motor]
    tip_x, tip_y = next((places[joint] for joint in link["joints"] if joint != motor), (x, y))
    if abs(math.remainder(math.atan2(tip_y - y, tip_x - x) - angle, 2 * math.pi)) > 1e-6:
        raise refused(f"the initial_angle {angle:g} of link '{name}' differs from that of the positions of its joints")
    return float(rate)


def _add_rod(m: Mechanism, name: str, points: list[tuple[float, float]], mass_per_length: float) -> None:
    """Add a body whose x axis points from its first joint to its second joint. Its mass is that of the lines between
    its joints.
    """
    if len(points) < 2:
        raise refused(f"link '{name}' has fewer than two joints")
    lengths = [math.dist(a, b) for a, b in pairwise(points)]
    total = sum(lengths)
    middles = [((a[0] + b[0]) / 2, (a[1] + b[1]) / 2) for a, b in pairwise(points)]
    if not total > 0:
        raise refused(f"link '{name}' has no length")
    center = tuple(sum(s * p[k] for s, p in zip(lengths, middles, strict=True)) / total for k in (0, 1))
    inertia = sum(s * (s**2 / 12 + math.dist(center, p) ** 2) for s, p in zip(lengths, middles, strict=True))
    (x0, y0), (x1, y1) = points[0], points[1]
    m.body(name, mass=mass_per_length * total, inertia=mass_per_length * inertia, position=(center[0], center[1]),
           angle=math.atan2(y1 - y0, x1 - x0))  # fmt: skip
