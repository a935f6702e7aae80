"""Names of quantities: JOINT.angle, BODY.x, BODY.y, BODY.angle, MARKER.x, MARKER.y, and named coordinates."""

from __future__ import annotations

from collections.abc import Mapping

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import did_you_mean, listed
from mbdkit.mechanism.beams import last_nodes
from mbdkit.mechanism.joint_base import JointBase
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_quantities import (
    AXES,
    GROUND,
    Affine,
    Coordinate,
    MarkerCoordinate,
    Point,
    Quantity,
    RelativeAngle,
    Travel,
)

_PREFIXES = {kind: f"{kind[:-1] if kind != 'bodies' else 'body'}" for kind in ("bodies", "joints", "markers")}
_NAMES_SHOWN = 12


class QuantityNames:
    """Finds quantities of a mechanism by name. The last node of a beam is also called ``BEAM.last``."""

    def __init__(self, mechanism: Mechanism):
        self.mechanism = mechanism
        self._number = {name: number for number, name in enumerate(mechanism.bodies)}
        self._last = last_nodes(mechanism.beams)

    def body(self, name: str, key: str, *, may_be_ground: bool = False) -> int:
        """Return the index of a body, `GROUND` for the ground; raise SpecError if there is no body with this name."""
        if may_be_ground and name == self.mechanism.ground:
            return GROUND
        name = self._last.get(name, name)
        if name not in self._number:
            known = [*self._number, *([self.mechanism.ground] if may_be_ground else [])]
            raise SpecError(f"there is no body '{name}'{_hint(name, known, 'bodies')}", key=key)
        return self._number[name]

    def joint(self, name: str, key: str) -> Quantity:
        """Return the coordinate of a joint: a relative angle or a travel.

        Raises SpecError if there is no such joint.
        """
        joints = self.mechanism.joints
        if name not in joints:
            raise SpecError(f"there is no joint '{name}'{_hint(name, joints, 'joints')}", key=key)
        return self._coordinate(joints[name])

    def pose(self, body: int) -> dict[str, Quantity]:
        """Return the coordinates of a body with this index by axis: x, y and angle."""
        return {name: Coordinate(body, axis) for axis, name in enumerate(AXES)}

    def angle_between(self, first: int, second: int) -> Quantity:
        """Return the angle of the second body relative to the first one, given their indices."""
        return RelativeAngle(first, second)

    def _coordinate(self, joint: JointBase) -> Quantity:
        a, b = (self._of(body) for body in joint.bodies)
        if (travel := joint.travel) is None:
            return RelativeAngle(a, b)
        return Travel(Point(a, *travel[:2]), Point(b, *travel[2:4]), (travel[4], travel[5]))

    def _of(self, body: str) -> int:
        return GROUND if body == self.mechanism.ground else self._number[body]

    def find(self, name: str, key: str) -> Quantity:
        """Return the quantity with a name such as ``knee.angle``, or with the name of a coordinate.

        Raises SpecError if the mechanism has no such quantity, or the name is ambiguous.
        """
        if name in self.mechanism.coordinates:
            return self.coordinate(name)
        matches = self._matches(name)
        if len(matches) > 1:
            some = listed((f"{plural}.{element}.{name.rpartition('.')[2]}" for plural, element in matches), "or")
            raise SpecError(f"'{name}' is ambiguous: write {some}", key=key)
        if not matches:
            element = name.rpartition(".")[0]
            known = [*self._number, *self.mechanism.joints, *self.mechanism.markers]
            own = list(self.mechanism.coordinates)
            of_element = f" (did you mean '{name}.angle'?)" if self._matches(f"{name}.angle") else ""
            hint = of_element or did_you_mean(name, own) or did_you_mean(element, known)
            raise SpecError(
                f"the mechanism has no quantity '{name}'{hint}; quantities are JOINT.angle, BODY.x, BODY.y, "
                f"BODY.angle, MARKER.x and MARKER.y{f', and its coordinates {listed(own)}' if own else ''}",
                key=key,
            )
        return next(iter(matches.values()))

    def coordinate(self, name: str) -> Quantity:
        """Return the quantity of a named coordinate of the mechanism, with its sign and zero."""
        given = self.mechanism.coordinates[name]
        if given.relative_to is None:
            of = self.find(given.of, f"model.coordinates.{quoted(name)}.of")
        else:
            of = RelativeAngle(self._of(given.relative_to), self._of(given.of.rpartition(".")[0]))
        return of if (given.scale, given.offset) == (1.0, 0.0) else Affine(of, given.scale, given.offset)

    @property
    def examples(self) -> str:
        """Names that observed quantities may have, as examples in messages."""
        return listed([*list(self.mechanism.coordinates)[:_NAMES_SHOWN], "JOINT.angle", "BODY.x"], "or")

    def element(self, name: str) -> str:
        """Return the element of an existing quantity, such as ``R.Knee`` for ``joints.R.Knee.angle``."""
        return next(element for _, element in self._matches(name))

    def _matches(self, name: str) -> dict[tuple[str, str], Quantity]:
        """Return the quantities that a name can denote, by kind and name of the element."""
        element, _, axis = name.rpartition(".")
        kind, _, rest = element.partition(".")
        matches: dict[tuple[str, str], Quantity] = {}
        for plural, singular in _PREFIXES.items():
            for one in (element, rest) if kind in (plural, singular) else (element,):
                one = self._last.get(one, one) if plural == "bodies" else one
                if (quantity := self._quantity(plural, one, axis)) is not None:
                    matches[plural, one] = quantity
        return matches

    def _quantity(self, kind: str, element: str, axis: str) -> Quantity | None:
        """Return a quantity of an element; None if the element does not exist or does not have this quantity."""
        match kind:
            case "bodies" if element in self._number and axis in AXES:
                return Coordinate(self._number[element], AXES.index(axis))
            case "joints" if element in self.mechanism.joints and axis == "angle":
                return self._coordinate(self.mechanism.joints[element])
            case "markers" if (marker := self.mechanism.markers.get(element)) and axis in AXES[:2] and marker.point:
                return MarkerCoordinate(Point(self._of(marker.body), *marker.point), AXES.index(axis))
        return None

    def knows(self, name: str) -> bool:
        """Return whether a name is that of a named coordinate, or denotes exactly one other quantity."""
        return name in self.mechanism.coordinates or len(self._matches(name)) == 1

    def candidates(self) -> dict[str, Quantity]:
        """Return quantities that may serve as independent coordinates, by name.

        Named coordinates of the mechanism come first, then the coordinates of joints, then those of bodies.
        """
        coordinates: dict[str, Quantity] = {name: self.coordinate(name) for name in self.mechanism.coordinates}
        for name, joint in self.mechanism.joints.items():
            coordinates[f"{name}.angle"] = self._coordinate(joint)
        for axis in ("angle", "x", "y"):
            for name, number in self._number.items():
                coordinates.setdefault(f"{name}.{axis}", self.pose(number)[axis])
        return coordinates


def _hint(name: str, known: Mapping[str, object] | list[str], what: str) -> str:
    names = list(known)
    some = listed(names[:_NAMES_SHOWN]) + (", ..." if len(names) > _NAMES_SHOWN else "")
    return did_you_mean(name, names) or f"; {what}: {some or 'none'}"
