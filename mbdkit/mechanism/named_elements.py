"""The named elements of a mechanism: adding one of any kind, with the keys that it has in a spec."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, TypeVar, get_args, get_origin

from pydantic import TypeAdapter, ValidationError

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import parse_path, plain, quoted
from mbdkit.base.text import did_you_mean, listed
from mbdkit.mechanism.beams import Beam, last_nodes, with_body
from mbdkit.mechanism.bodies import Body, Element, Marker
from mbdkit.mechanism.checks import check_known, check_name
from mbdkit.mechanism.element_kinds import check_elements, class_of, element_kinds, kinds_in
from mbdkit.mechanism.forces import Force
from mbdkit.mechanism.joints import Joint
from mbdkit.mechanism.mechanism_data import Assembly, MechanismData, NamedCoordinate, check_coordinates
from mbdkit.mechanism.parameters import with_expressions
from mbdkit.mechanism.state_values import Controller, FirstOrderState, Input
from mbdkit.mechanism.traced_elements import traced

#: Type of the elements of each kind of the core: each key of the model `mechanism` with elements by name.
_KINDS = {
    kind: get_args(field.annotation)[1]
    for kind, field in MechanismData.model_fields.items()
    if get_origin(field.annotation) is dict
}

AnyPlaced = TypeVar("AnyPlaced", bound=Element)

_adapter = cache(TypeAdapter)


class NamedElements:
    """The part of `Mechanism` that holds its elements by name."""

    bodies: dict[str, Body]
    beams: dict[str, Beam]
    joints: dict[str, Joint]
    forces: dict[str, Force]
    markers: dict[str, Marker]
    coordinates: dict[str, NamedCoordinate]
    states: dict[str, FirstOrderState]
    inputs: dict[str, Input]
    controllers: dict[str, Controller]
    assembly: Assembly

    def add(self, kind: str, name: str, /, **keys: object) -> None:
        """Add an element with the keys that it has in a spec; the other methods name the keys of one type of element.

        Parameters
        ----------
        kind
            Key of the model in a spec, such as ``joints``.
        name
            Name of the element.
        **keys
            Keys of the element in a spec; ``from`` is written ``from_``.

        Examples
        --------
        >>> m = Mechanism()
        >>> m.add("bodies", "rod", mass=2.0, inertia=0.375, position=(0.75, 0.0))
        >>> m.add("joints", "A", type="revolute", bodies=("ground", "rod"), at=(0.0, 0.0))
        """
        further = element_kinds()
        if kind not in _KINDS and kind not in further:
            with SpecError.locate("model"):  # its part is not installed
                kinds_in({kind: {}})
            known = [*_KINDS, *further]
            hint = did_you_mean(kind, known) or f"; there are {listed(known)}"
            raise SpecError(f"there are no elements called '{kind}'{hint}", key="model")
        key = f"model.{kind}.{quoted(name)}"
        check_name(name, key)
        if name in getattr(self, kind):
            raise SpecError(f"the name '{name}' is already in use", key=key)
        model = class_of(further[kind]) if kind in further else _KINDS[kind]
        element = _validated(model, key, {key.removesuffix("_"): value for key, value in keys.items()})
        if isinstance(element, Element):
            element = self._with_points(element, key)
        if kind == "beams":
            self._add_beam(name, element)
        if kind == "coordinates":
            check_coordinates({name: element}, self.joints, self.bodies, self.markers)
        elif kind == "joints" or kind in further:
            check_elements({kind: {name: element}}, self, "model.")
        getattr(self, kind)[name] = element

    def hold(self, *bodies: str, tolerance: float = 1e-12) -> None:
        """Set the bodies that assembly does not move, and the tolerance of assembly.

        Parameters
        ----------
        bodies
            Names of the bodies that assembly does not move; they replace those of an earlier call.
        tolerance
            Largest constraint residual of a consistent initial state [m, rad].
        """
        for index, name in enumerate(bodies):
            self._known(name, f"model.assembly.fix[{index}]")
        self.assembly = _validated(Assembly, "model.assembly", {"fix": bodies, "tolerance": tolerance})

    def _add_beam(self, name: str, beam: Beam) -> None:
        """Add a beam with its nodes and with the forces that replace its load."""
        self.beams[name] = beam
        self.bodies |= beam.bodies(name)
        self.forces |= beam.loads(name)

    def _known(self, name: str, key: str) -> None:
        check_known(name, self.bodies, key)

    def _with_points(self, element: AnyPlaced, key: str) -> AnyPlaced:
        """Return an element with its points in the frames of its bodies, which must exist."""
        last = last_nodes(self.beams)
        for attachment, body in element.places():
            if body in last and not attachment.startswith(element.KEYS_WITHOUT_LAST):
                element = with_body(element, parse_path(attachment), last[body])
                continue
            self._known(body, f"{key}.{attachment}")
        return element.placed(self.bodies, key)


def _validated(kind: object, key: str, values: Mapping[str, object]) -> Any:
    """Return an element with these values; raise SpecError, with the element's `key`, if they are not valid."""
    validate = _adapter(kind).validate_python
    try:
        return traced(validate, kind, values)
    except ValidationError:
        data = plain(values, parse_path(key))
    try:  # rejected values may be tuples in place of lists, or numbers with units, such as "2 N/mm"
        element, _ = with_expressions(validate, data, kind, {}, prefix=key)
    except SpecError as error:
        raise error if error.key.startswith(key) else error.located(prefix=key) from None
    return element
