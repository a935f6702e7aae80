"""The actuators of a spec of inverse dynamics: those it lists, by default one for each observed joint, and residuals.

Residual actuators act on *free roots*: the first body of each part of the mechanism that no joint connects to the
ground.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import did_you_mean, listed
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_quantities import Point, Quantity
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Actuator, Recruitment

RESERVE = "reserve."  #: Prefix of the names of reserves.

#: Prefix of the names of residual actuators if there is only one free root; the name of the coordinate follows.
ROOT = "root"

#: Residual actuators on a body with less than this share of the mass of the heaviest body of its part cause a
#: warning.
LIGHT_ROOT = 0.2


@dataclass(frozen=True)
class NamedActuator:
    """An actuator: the quantity whose generalized force it exerts, and its weight, used if the values are not unique.

    Attributes
    ----------
    name
        Name in the archive.
    quantity
        The quantity; a value u of the actuator has the power u times the rate of this quantity.
    weight
        Weight of the value, see `mbdkit_biomech.inverse_dynamics.spec.inverse_sections.Actuator`.
    is_residual
        Whether it is a residual actuator, which acts from outside on a body that no joint connects to the ground.
    """

    name: str
    quantity: Quantity
    weight: float = 1.0
    is_residual: bool = False

    @property
    def unit(self) -> str:
        """Unit of the value: N for a force, N m for a torque."""
        return "N m" if self.quantity.unit == "rad" else "N"

    @property
    def kind(self) -> str:
        """``actuator``, ``reserve`` or ``residual``."""
        return "residual" if self.is_residual else "reserve" if self.name.startswith(RESERVE) else "actuator"


def members_of_actuators(actuators: Sequence[NamedActuator]) -> list[tuple[str, tuple[str, str]]]:
    """Return name, unit and kind of each actuator, as `mbdkit.quantities.names.ArchiveNames.members`."""
    return [(actuator.name, (actuator.unit, actuator.kind)) for actuator in actuators]


@dataclass(frozen=True)
class Shortening(Quantity):
    """The negative distance between two points; its generalized force is a tension that pulls the points together.

    Only the value and the gradient are implemented; `curvature` returns zeros.
    """

    first: Point
    second: Point
    unit = "m"

    def _apart(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        (ax, ay), (bx, by) = self.first.position(q), self.second.position(q)
        length = elementary.hypot(bx - ax, by - ay)
        safe = np.where(length > 0, length, 1.0)
        return (bx - ax) / safe, (by - ay) / safe, length

    def value(self, q: np.ndarray) -> np.ndarray:
        """Return the negative distance."""
        return np.asarray(-self._apart(q)[2])

    def add_gradient(self, q: np.ndarray, out: np.ndarray) -> None:
        """Add the gradient, which is the generalized force of a unit tension."""
        ex, ey, _ = self._apart(q)
        self.first.add_force(q, ex, ey, out)
        self.second.add_force(q, -ex, -ey, out)


@dataclass(frozen=True)
class Reserve:
    """A reserve: an actuator that acts in addition to the muscles.

    Attributes
    ----------
    of
        Index of the actuator whose moment the reserve shares with the muscles.
    actuator
        The reserve as an actuator, ``reserve.ACTUATOR``.
    optimal
        Optimal force or torque of the reserve [N or N m].
    """

    of: int
    actuator: NamedActuator
    optimal: float


def reserves_of(asked: Recruitment, actuators: Sequence[NamedActuator]) -> list[Reserve]:
    """Return the reserves of recruitment, in the order of the actuators; residual actuators have none.

    Raises
    ------
    SpecError
        If a reserve is given for an actuator that does not exist, or for a residual actuator.
    """
    own = {actuator.name: index for index, actuator in enumerate(actuators) if not actuator.is_residual}
    optimal = asked.reserves if isinstance(asked.reserves, dict) else dict.fromkeys(own, asked.reserves)
    for name in optimal:
        if name not in own:
            raise SpecError(
                f"there is no actuator '{name}'{did_you_mean(name, list(own)) or f'; actuators: {listed(list(own))}'}",
                key=f"recruitment.reserves.{name}",
            )
    return [
        Reserve(index, NamedActuator(RESERVE + name, actuators[index].quantity), optimal[name])
        for name, index in own.items()
        if name in optimal
    ]


def actuators_of(
    given: Mapping[str, Actuator], names: QuantityNames, observed: Mapping[str, Quantity]
) -> list[NamedActuator]:
    """Return the actuators of a spec.

    Parameters
    ----------
    given
        The section `actuators` of the spec.
    observed
        The observed quantities by name.

    Raises
    ------
    SpecError
        If an actuator refers to an unknown joint or body, or to a joint whose coordinate is fixed, or has the name of a
        residual.
    """
    found = [_given(name, one, names) for name, one in given.items()] if given else _of_observed(observed, names)
    residuals = [one for one in _residuals(names) if all(one.quantity != other.quantity for other in found)]
    for one in residuals:
        if one.name in given:
            raise SpecError(
                f"is the residual actuator of the coordinate '{one.name}'; choose another name for this actuator",
                key=f"actuators.{quoted(one.name)}",
            )
    return [*found, *residuals]


def _of_observed(observed: Mapping[str, Quantity], names: QuantityNames) -> list[NamedActuator]:
    found: dict[Quantity, NamedActuator] = {}
    for name, quantity in observed.items():
        if (driven := quantity.unscaled).place is None:
            own = name if name in names.mechanism.coordinates else names.element(name)
            found.setdefault(driven, NamedActuator(own, quantity))
    return list(found.values())


def _given(name: str, one: Actuator, names: QuantityNames) -> NamedActuator:
    key = f"actuators.{quoted(name)}"
    if one.joint is not None:
        return NamedActuator(name, names.joint(one.joint, f"{key}.joint"), one.weight)
    if one.body is not None:
        assert one.coordinate is not None
        quantity = names.pose(names.body(one.body, f"{key}.body"))[one.coordinate]
        return NamedActuator(name, quantity, one.weight)
    if one.bodies is None:
        return NamedActuator(name, _coordinate_of_actuator(name, names), one.weight)
    first, second = (
        names.body(body, f"{key}.bodies[{side}]", may_be_ground=True) for side, body in enumerate(one.bodies)
    )
    if one.points is None:
        return NamedActuator(name, names.angle_between(first, second), one.weight)
    ends = Point(first, *one.points[0]), Point(second, *one.points[1])
    return NamedActuator(name, Shortening(*ends), one.weight)


def _coordinate_of_actuator(name: str, names: QuantityNames) -> Quantity:
    known = list(names.mechanism.coordinates)
    if name not in known:
        hint = did_you_mean(name, known) or f" ({listed(known)})" if known else " (this model names none)"
        raise SpecError(
            "needs one of `joint`, `bodies` and `body`, unless it has the name of a coordinate of the model" + hint,
            key=f"actuators.{quoted(name)}",
        )
    return names.coordinate(name)


def _residuals(names: QuantityNames) -> list[NamedActuator]:
    """Return residual actuators for the first body of each part of the mechanism that no joint connects to the ground.

    They act on the coordinates that the model defines for this body or, unless it defines all of them, on the
    coordinates of the centre of mass.
    """
    mechanism = names.mechanism
    roots = free_roots(mechanism)
    found = []
    for root in roots:
        body, prefix = names.body(root, "model"), ROOT if len(roots) == 1 else root
        pose, named = names.pose(body), _coordinates_of_body(body, names)
        if mechanism.bodies[root].inertia is None:
            del pose["angle"]
        own = {f"{prefix}.{axis}": coordinate for axis, coordinate in pose.items()}
        found += [NamedActuator(*one, is_residual=True) for one in (named if len(named) == len(own) else own).items()]
    return found


def _coordinates_of_body(body: int, names: QuantityNames) -> dict[str, Quantity]:
    """Return the first coordinates that the model defines for x, y and the angle of a body, or of a point of the
    body.
    """
    found: dict[int, tuple[str, Quantity]] = {}
    for name in names.mechanism.coordinates:
        quantity = names.coordinate(name)
        own, axis = quantity.unscaled.place or (None, 0)
        if own == body:
            found.setdefault(axis, (name, quantity))
    return dict(found[axis] for axis in sorted(found))


def free_roots(mechanism: Mechanism) -> list[str]:
    """Return the first body of each part of the mechanism that joints do not connect to the ground."""
    return [part[0] for part in _free_parts(mechanism)]


def light_roots(mechanism: Mechanism) -> list[str]:
    """Return warnings about residual actuators on a body that is much lighter than others of its part.

    The order of bodies in a file, which decides on the root, may have changed: residual actuators on a foot leave the
    joints of the leg without load.
    """
    warnings = []
    for part in _free_parts(mechanism):
        masses = {name: mechanism.bodies[name].mass for name in part}
        root, heaviest = part[0], max(masses, key=masses.__getitem__)
        if masses[root] < LIGHT_ROOT * masses[heaviest]:
            warnings.append(
                f"the residual actuators act on '{root}' ({masses[root]:g} kg), the first body of a part that no joint "
                f"connects to the ground, which is much lighter than '{heaviest}' ({masses[heaviest]:g} kg); list the "
                "body first on which they should act"
            )
    return warnings


def _free_parts(mechanism: Mechanism) -> list[list[str]]:
    """Return the names of the bodies of each part that joints do not connect to the ground, in order."""
    part = {name: {name} for name in (mechanism.ground, *mechanism.bodies)}
    for joint in mechanism.joints.values():
        first, second = (part[name] for name in joint.bodies)
        first |= second
        for name in second:
            part[name] = first
    parts: list[list[str]] = []
    for name in mechanism.bodies:
        if mechanism.ground not in part[name] and not any(name in found for found in parts):
            parts.append([other for other in mechanism.bodies if other in part[name]])
    return parts
