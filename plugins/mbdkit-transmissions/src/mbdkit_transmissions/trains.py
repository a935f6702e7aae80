"""Closed trains of gears and belts, whose ratios must agree: otherwise nothing in them can turn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from mbdkit.plugin import GROUND, Joint, Revolute, SpecError, listed, quoted
from mbdkit.plugin.seams import ElementsByName, element_check
from mbdkit_transmissions.gears import Belt, Gear

AGREEMENT = 1e-9
"""Relative difference up to which two ratios agree, and distance [m] up to which two points do."""

Ratios = dict[str, dict[str, tuple[float, str]]]
"""For each body, the bodies that it turns: the ratio of their angles, and the joint."""


@element_check
def check_trains(joints: Mapping[str, Gear | Belt], mechanism: ElementsByName, prefix: str) -> None:
    """Raise SpecError for the first joint that closes a train between axes of one body, and contradicts the others."""
    everything = {**mechanism.joints, **joints}
    for carrier in (GROUND, *mechanism.bodies):
        axes, turned = dict(_axes(carrier, everything)), Ratios()
        for name, joint in everything.items():
            if not isinstance(joint, Gear | Belt) or not all(
                body in axes and max(abs(x - y) for x, y in zip(axes[body], point, strict=True)) < AGREEMENT
                for body, point in zip(joint.bodies, joint.points, strict=True)
            ):
                continue
            a, b = joint.bodies
            if (known := _way(turned, a, b)) is None:
                turned.setdefault(a, {})[b] = joint.ratio, name
                turned.setdefault(b, {})[a] = 1.0 / joint.ratio, name
            elif abs(known[0] / joint.ratio - 1.0) > AGREEMENT:
                others = listed([f"'{other}'" for other in known[1]], "and")
                raise SpecError(
                    f"this joint turns '{b}' by {joint.ratio:.6g} times the angle of '{a}', but {others} "
                    f"{'turn' if len(known[1]) > 1 else 'turns'} it by {known[0]:.6g} times this angle, so that "
                    "nothing can turn; correct a ratio, or remove a joint",
                    key=f"{prefix}joints.{quoted(name)}",
                )


def _axes(carrier: str, joints: Mapping[str, Joint]) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield each body that turns about a fixed axis of a body, and this axis in its own frame."""
    for joint in joints.values():
        if isinstance(joint, Revolute) and joint.center is None and carrier in joint.bodies:
            (a, b), (xa, ya, xb, yb) = joint.bodies, joint.flat_points
            yield (b, (xb, yb)) if a == carrier else (a, (xa, ya))


def _way(turned: Ratios, a: str, b: str) -> tuple[float, list[str]] | None:
    """Return the ratio of the angle of b to that of a by joints that are known, and their names; None without a way."""
    ways: dict[str, tuple[float, list[str]]] = {a: (1.0, [])}
    bodies = [a]
    for body in bodies:
        for other, (ratio, name) in turned.get(body, {}).items():
            if other not in ways:
                ways[other] = ways[body][0] * ratio, [*ways[body][1], name]
                bodies.append(other)
    return ways.get(b)
