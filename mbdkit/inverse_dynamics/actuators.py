"""The actuators of a spec: those that it names, one for each observed joint by default, and residuals of free roots."""

from __future__ import annotations

from dataclasses import dataclass

from mbdkit.inverse_dynamics.mechanism_quantities import (
    AXES,
    Coordinate,
    Point,
    Quantity,
    RelativeAngle,
    Shortening,
    Travel,
)
from mbdkit.inverse_dynamics.quantity_names import QuantityNames
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.spec import InverseSpec
from mbdkit.spec.inverse_sections import Actuator

ROOT = "root"
"""Name of the residual actuators of the only free root, before the name of the coordinate."""


@dataclass(frozen=True)
class NamedActuator:
    """An actuator: the quantity whose generalized force it exerts, and its weight where values are not unique.

    Attributes
    ----------
    name
        Name in the archive.
    quantity
        The power of a value u is u times the rate of this quantity.
    weight
        Weight of the value, see `mbdkit.spec.inverse_sections.Actuator`.
    """

    name: str
    quantity: Quantity
    weight: float = 1.0

    @property
    def unit(self) -> str:
        """Unit of the value: N for a force, N m for a torque."""
        return "N m" if self.quantity.unit == "rad" else "N"


def actuators_of(spec: InverseSpec, names: QuantityNames, observed: dict[str, Quantity]) -> list[NamedActuator]:
    """Return the actuators of a spec.

    Parameters
    ----------
    observed
        The observed quantities by name.

    Raises
    ------
    SpecError
        If an actuator refers to an unknown joint or body, or to a joint whose coordinate is fixed.
    """
    if spec.actuators:
        found = [_given(name, one, names) for name, one in spec.actuators.items()]
    else:
        found = [
            NamedActuator(name.rpartition(".")[0].rpartition(".")[2], quantity)
            for name, quantity in observed.items()
            if isinstance(quantity, RelativeAngle | Travel)
        ]
    return [*found, *_residuals(names.mechanism, names)]


def _given(name: str, one: Actuator, names: QuantityNames) -> NamedActuator:
    key = f"actuators.{name}"
    if one.joint is not None:
        return NamedActuator(name, names.joint(one.joint, f"{key}.joint"), one.weight)
    if one.body is not None:
        assert one.coordinate is not None
        quantity = Coordinate(names.body(one.body, f"{key}.body"), AXES.index(one.coordinate))
        return NamedActuator(name, quantity, one.weight)
    assert one.bodies is not None
    assert one.points is not None
    ends = [
        Point(names.body(body, f"{key}.bodies[{side}]", may_be_ground=True), *point)
        for side, (body, point) in enumerate(zip(one.bodies, one.points, strict=True))
    ]
    return NamedActuator(name, Shortening(ends[0], ends[1]), one.weight)


def _residuals(mechanism: Mechanism, names: QuantityNames) -> list[NamedActuator]:
    """Return residual actuators of the first body of each part of the mechanism that no joint holds to the ground."""
    roots = free_roots(mechanism)
    found = []
    for root in roots:
        body, prefix = names.body(root, "model"), ROOT if len(roots) == 1 else root
        axes = AXES if mechanism.bodies[root].inertia is not None else AXES[:2]
        found += [NamedActuator(f"{prefix}.{axis}", Coordinate(body, place)) for place, axis in enumerate(axes)]
    return found


def free_roots(mechanism: Mechanism) -> list[str]:
    """Return the first body of each part of the mechanism that joints do not connect to the ground."""
    part = {name: {name} for name in (mechanism.ground, *mechanism.bodies)}
    for joint in mechanism.joints.values():
        first, second = (part[name] for name in joint.bodies)
        first |= second
        for name in second:
            part[name] = first
    roots: list[str] = []
    for name in mechanism.bodies:
        if mechanism.ground not in part[name] and not any(root in part[name] for root in roots):
            roots.append(name)
    return roots
