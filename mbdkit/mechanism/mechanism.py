"""The mechanism: named bodies, beams, joints, forces and markers, with a builder, checks, and conversion to specs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MethodType
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from mbdkit.base import higher_layers
from mbdkit.base.errors import SpecError
from mbdkit.base.html_view import HtmlView
from mbdkit.base.plain_data import plain, quoted, value_text
from mbdkit.base.strict_model import StrictModel
from mbdkit.base.text import counted
from mbdkit.mechanism.beams import last_nodes, parts_of
from mbdkit.mechanism.bodies import GROUND, Element
from mbdkit.mechanism.checks import check_centers, check_mechanism, check_name, check_names, check_tables
from mbdkit.mechanism.element_kinds import (
    ChosenTreatment,
    builder_of,
    check_elements,
    element_kinds,
    kind_built_by,
    reacting_among,
)
from mbdkit.mechanism.element_methods import ElementMethods
from mbdkit.mechanism.joint_base import Constraint, JointBase, Pose
from mbdkit.mechanism.joint_kinds import joint_builder, joint_builders
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism_data import ELEMENTS, Assembly, MechanismData, NamedCoordinate, check_coordinates
from mbdkit.mechanism.parameters import parameter_values, with_expressions
from mbdkit.mechanism.traced_elements import traced
from mbdkit.mechanism.validation_errors import spec_error
from mbdkit.mechanism.values import Motion, Point
from mbdkit.registry.accessors import accessors, computed

if TYPE_CHECKING:
    from mbdkit_statics.symbolic_system import SymbolicSystem

AnyValue = TypeVar("AnyValue")

_POINT: TypeAdapter[tuple[float, float]] = TypeAdapter(Point)


def gravity_text(gravity: Sequence[float]) -> str:
    """Return a gravitational acceleration (x, y) [m/s^2] as text; ``none`` if it is zero."""
    x, y = gravity
    return f"({x:g}, {y:g}) m/s^2" if x or y else "none"


class Mechanism(ElementMethods, HtmlView):
    """A planar multibody system as data.

    Build it with its methods or with :meth:`from_spec`. Bodies are referred to by name: :meth:`body` returns the name,
    and `ground` is the fixed global frame. Points are given either in the frames of the bodies (`points`) or in the
    global frame at the initial positions (`at`, `from_`, `to`). Add a body before the elements that refer to it.

    Parameters
    ----------
    gravity
        Gravitational acceleration (x, y) [m/s^2].
    name
        Name of the mechanism, the title of its runs.

    Attributes
    ----------
    bodies, joints, forces, markers : dict
        The elements by name, in the order in which they were added. Elements of each kind that a plugin adds are in the
        attribute with the key of the kind, such as `muscles`.
    beams : dict
        The beams by name. Their nodes are among `bodies`, and the forces that replace their distributed loads are among
        `forces`.
    assembly : Assembly
        Settings for making the initial state consistent.
    coordinates : dict
        Named coordinates, `NamedCoordinate` by name.
    states : dict
        First-order states of the mechanism itself by name.
    inputs : dict
        Inputs, numbers that a run receives from outside, by name.
    controllers : dict
        Sampled controllers by name.
    is_of_run : bool
        Whether the mechanism is that of a run, in which elements also act that otherwise do not: muscles, to which
        inverse dynamics distributes the moments of actuators.
    treatments : tuple of ChosenTreatment
        How a run treats elements of kinds that have a section in run specs.
    warnings : tuple of str
        Warnings for every run of the mechanism, such as parts of a file that were ignored. They do not change the
        verdict, and are not part of a spec.
    left_out : tuple of str
        Sentences about effects that the model describes and the mechanism lacks, such as a force in a file, although
        they change the motion. They make the verdict doubtful unless a spec accepts `left-out`, and are not part of a
        spec.
    left_out_of_runs : tuple of str
        Sentences about muscles, actuators and controllers in a file that the mechanism lacks. They are like `left_out`
        for runs, and `warnings` for inverse dynamics, which computes the forces of actuators from the motion.

    Examples
    --------
    >>> m = Mechanism()
    >>> rod = m.body("rod", mass=1, inertia=1 / 12, position=(0.5, 0))
    >>> m.revolute("A", m.ground, rod, at=(0, 0))
    >>> m.joints["A"].points
    ((0.0, 0.0), (-0.5, 0.0))
    """

    def __init__(self, gravity: Sequence[float] = (0.0, -9.81), *, name: str = "mechanism"):
        self.name = name
        self.gravity = _point(gravity, "model.gravity")
        for kind in ("bodies", "beams", *ELEMENTS, "coordinates", "states", "inputs", "controllers"):
            setattr(self, kind, {})
        self.assembly = Assembly()
        self.is_of_run = False
        self.treatments: tuple[ChosenTreatment, ...] = ()
        self.warnings: tuple[str, ...] = ()
        self.left_out: tuple[str, ...] = ()
        self.left_out_of_runs: tuple[str, ...] = ()

    @property
    def ground(self) -> str:
        """Name of the fixed global frame, for use as a body argument."""
        return GROUND

    @property
    def reacting(self) -> ChosenTreatment | None:
        """The treatment of elements whose reactions the steps of a run determine; None if there are none."""
        return reacting_among(self.treatments)

    @property
    def elements(self) -> dict[str, dict[str, Element]]:
        """The joints, forces, markers, and elements of further kinds, if there are any: for each kind, the elements by
        name.
        """
        own, further = {kind: getattr(self, kind) for kind in ELEMENTS}, element_kinds()
        if further.keys().isdisjoint(self.__dict__):
            return own
        return own | {kind: elements for kind in further if (elements := self.__dict__.get(kind))}

    def __getattr__(self, name: str) -> Any:
        """Return the elements of a kind that a plugin adds, the method that adds one, or another attribute of a
        plugin.
        """
        if not name.startswith("_"):
            if name in element_kinds():
                return self.__dict__.setdefault(name, {})
            if (kind := kind_built_by(name)) is not None:
                return MethodType(builder_of(kind), self)
            if name in accessors(type(self)):
                return computed(self, name)
            if name in (types := joint_builders()):
                return MethodType(joint_builder(types[name]), self)
        raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'", name=name, obj=self)

    def __dir__(self) -> list[str]:
        """Return the names of the attributes, those of plugins included."""
        of_kinds = [name for kind in element_kinds().values() for name in (kind.key_in_model, kind.builder) if name]
        of_kinds += joint_builders()
        return [*super().__dir__(), *of_kinds, *accessors(type(self))]

    # ---- queries -------------------------------------------------------------------------------------------------

    def to_local(self, body: str, point: Sequence[float]) -> tuple[float, float]:
        """Return the coordinates of a global `point` (x, y) [m] in the frame of `body`, at its initial position."""
        self._known(body, "body")
        return (point[0], point[1]) if body == GROUND else self.bodies[body].to_local((point[0], point[1]))

    def to_global(self, body: str, point: Sequence[float]) -> tuple[float, float]:
        """Return the global coordinates of a `point` (x, y) [m] in the frame of `body`, at its initial position."""
        self._known(body, "body")
        return (point[0], point[1]) if body == GROUND else self.bodies[body].to_global((point[0], point[1]))

    def relative_angle(self, a: str, b: str) -> float:
        """Return angle_b - angle_a [rad] at the initial positions; the ground's angle is 0."""
        for key, name in (("a", a), ("b", b)):
            self._known(name, key)
        angle_a, angle_b = (0.0 if name == GROUND else self.bodies[name].angle for name in (a, b))
        return angle_b - angle_a

    def relative_pose(self, joint: JointBase) -> Pose:
        """Return the pose of the second body of a joint in the frame of the first, at the initial positions."""
        a, b = joint.bodies
        xa, ya, xb, yb = joint.flat_points
        x, y = self.to_local(a, self.to_global(b, (xb, yb)))
        return Pose(x - xa, y - ya, self.relative_angle(a, b), self.relative_angle(GROUND, a), 0.0)

    def constraints_of(self, name: str) -> list[Constraint]:
        """Return the constraints of a joint.

        Raises SpecError if its bodies cannot be joined at their initial positions.
        """
        joint = self.joints[name]
        with SpecError.locate(f"model.joints.{quoted(name)}"):
            return joint.constraints(self.relative_pose(joint))

    def constraint_rows(self) -> list[tuple[str, str]]:
        """Return (name, unit) of each constraint row, such as ``("A.x", "m")``, in the order of the joints."""
        return [
            (f"{name}.{row}", unit)
            for name, joint in self.joints.items()
            for row, unit in zip(joint.rows, joint.units, strict=True)
        ]

    def state_names(self) -> list[str]:
        """Return the names of all first-order states; states of elements are named ``element.state``."""
        of_elements = [
            f"{name}.{state.name}"
            for name, force in self.forces.items()
            if isinstance(force, Law)
            for state in force.force_law.states
        ]
        further = (elements for kind, elements in self.elements.items() if kind not in ELEMENTS)
        named = (item for elements in further for item in elements.items())
        of_kinds = [f"{name}.{state}" for name, element in named for state in element.state_names]
        return [*of_elements, *of_kinds, *self.states]

    def state_unit(self, name: str) -> str:
        """Return the unit of a first-order state, or of an output of a controller; 1 if it is not known."""
        if name in self.states:
            return self.states[name].unit
        controller, _, output = name.rpartition(".")
        return self.controllers[controller].unit_of(output) if controller in self.controllers else "1"

    def held_names(self) -> list[str]:
        """Return the names of all outputs and states of controllers, ``controller.output`` or ``controller.state``."""
        return [f"{name}.{value}" for name, one in self.controllers.items() for value in (*one.outputs, *one.states)]

    def description(self) -> str:
        """Return a line of text with the numbers of elements and of constraint rows."""
        drivers = sum(joint.is_driver for joint in self.joints.values())
        rows = sum(len(joint.rows) for joint in self.joints.values())
        nodes = sum(beam.node_count for beam in self.beams.values())
        parts = [counted(len(self.bodies) - nodes, "body", "bodies")] if nodes < len(self.bodies) else []
        parts += [counted(len(self.beams), "beam")] if self.beams else []
        parts += [counted(len(self.joints) - drivers, "joint"), counted(drivers, "driver")]
        named = {kind: len(elements) for kind, elements in self.elements.items() if elements or kind == "forces"}
        parts += [counted(number, kind[:-1]) for kind, number in named.items() if kind != "joints"]
        return f"{', '.join(parts)}; {counted(rows, 'constraint row')}"

    def validate(self) -> None:
        """Check that names are valid, that references exist, and that each element is compatible with its bodies.

        Raises
        ------
        SpecError
            For the first error; it contains the key path.
        """
        check_mechanism(self.bodies, self.beams, self.elements, self.joints, self.assembly)
        check_centers(self.joints, self.bodies.__getitem__)
        for name in self.coordinates:
            check_name(name, f"model.coordinates.{quoted(name)}")
        check_coordinates(self.coordinates, self.joints, self.bodies, self.markers)
        check_elements(self.elements, self, "model.")
        values = {kind: list(getattr(self, kind)) for kind in ("states", "inputs", "controllers")}
        for part in ("states", "outputs"):
            values |= {f"controllers.{quoted(x)}.{part}": [*getattr(one, part)] for x, one in self.controllers.items()}
        for kind, names in values.items():
            for name in names:
                check_name(name, f"model.{kind}.{quoted(name)}")
        for name, controller in self.controllers.items():
            if name in self.forces:
                raise SpecError(
                    f"'{name}' is also a force; choose another name", key=f"model.controllers.{quoted(name)}"
                )
            if twice := [one for one in controller.outputs if one in controller.states]:
                key = f"model.controllers.{quoted(name)}.outputs.{quoted(twice[0])}"
                raise SpecError(f"'{twice[0]}' is also a state of the controller; choose another name", key=key)
        named = [*self.state_names(), *self.held_names()]
        if twice := [name for name in named if named.count(name) > 1]:
            raise SpecError(f"two states or outputs of controllers are called '{twice[0]}'; rename one", key="model")
        for key, text in self.expressions():
            with SpecError.locate(key):
                higher_layers.state_program(text, self)

    def expressions(self) -> list[tuple[str, str]]:
        """Return (key path, text) of every expression of the state."""
        of_elements = self._of_elements(lambda one: one.expressions())
        return of_elements + [
            (f"model.{kind}.{quoted(name)}.{key}", text)
            for kind in ("states", "controllers")
            for name, value in getattr(self, kind).items()
            for key, text in value.expressions()
        ]

    def motions(self) -> list[tuple[str, Motion]]:
        """Return (key path, motion) of every driver, load and excitation that is a function of time."""
        return self._of_elements(lambda one: one.motions())

    def check_span(self, start: float, end: float) -> None:
        """Check that every table of a function of time covers the times from `start` to `end` [s], or is periodic.

        Raises
        ------
        SpecError
            For the first table that does not cover these times; it contains the key path.
        """
        check_tables(self.motions(), start, end)

    # ---- to and from a spec --------------------------------------------------------------------------------------

    def to_spec(self) -> dict[str, Any]:
        """Return the mechanism as the `model` mapping of a spec: plain data of the model `mechanism`, without default
        values.

        Examples
        --------
        >>> m = Mechanism()
        >>> ball = m.body("ball", mass=1.0)
        >>> m.to_spec()["bodies"]
        {'ball': {'mass': 1.0}}
        """
        spec: dict[str, Any] = {"name": "mechanism"}
        if self.gravity != MechanismData.model_fields["gravity"].default:
            spec["gravity"] = list(self.gravity)
        parts = parts_of(self.beams)
        spec["bodies"] = {name: _plain(body) for name, body in self.bodies.items() if name not in parts}
        if self.beams:
            spec["beams"] = {name: _plain(beam) for name, beam in self.beams.items()}
        for kind, elements in self.elements.items():
            if own := {name: element for name, element in elements.items() if name not in parts}:
                types = {name: {"type": one.type} if hasattr(one, "type") else {} for name, one in own.items()}
                spec[kind] = {name: types[name] | _plain(one) for name, one in own.items()}
        if self.coordinates:
            spec["coordinates"] = {
                name: coordinate.of if coordinate == NamedCoordinate(of=coordinate.of) else _plain(coordinate)
                for name, coordinate in self.coordinates.items()
            }
        for kind in ("states", "inputs", "controllers"):
            if named := getattr(self, kind):
                spec[kind] = {name: _plain(one) for name, one in named.items()}
        if self.assembly != Assembly():
            spec["assembly"] = _plain(self.assembly)
        return spec

    @classmethod
    def from_spec(cls, spec: Mapping[str, object], parameters: Mapping[str, float | str] | None = None) -> Mechanism:
        """Return the mechanism described by a `model` mapping, the format of :meth:`to_spec`.

        Parameters
        ----------
        spec
            Mapping with the keys ``gravity``, ``bodies``, ``beams``, ``joints``, ``forces``, ``markers``,
            ``coordinates``, ``states``, ``inputs``, ``controllers``, ``assembly`` and those of further kinds of
            elements, such as ``muscles``; ``name`` is optional and must be ``mechanism``.
        parameters
            Named parameters: numbers, or expressions of other parameters. Numbers in `spec` may be expressions of them.

        Raises
        ------
        SpecError
            For the first error; it contains the key path.

        Examples
        --------
        >>> m = Mechanism.from_spec({"bodies": {"ball": {"mass": "2*half"}}}, {"half": 0.5})
        >>> m.bodies["ball"].mass
        1.0
        """
        if not isinstance(spec, Mapping):
            raise SpecError(
                f"should be a mapping (`key: value`), not {value_text(spec)}; the mechanism of a loaded spec is "
                "`spec.mechanism()`",
                key="model",
            )
        values = plain(spec, ("model",))
        name = values.pop("name", "mechanism")
        if name != "mechanism":
            raise SpecError(f"only the free-form model 'mechanism' can be read here; got {name!r}", key="model.name")
        numbers = parameter_values(parameters)
        data, _ = with_expressions(MechanismData.model_validate, values, MechanismData, numbers, prefix="model")
        return cls.from_data(data)

    @classmethod
    def from_data(cls, data: MechanismData, *, name: str = "mechanism") -> Mechanism:
        """Return the mechanism described by validated `data`, after checks that involve several of its elements."""
        mechanism = cls(data.gravity, name=name)
        given = {kind: getattr(data, kind, {}) for kind in (*ELEMENTS, *element_kinds())}
        check_names(data.bodies, data.beams, given)
        mechanism.bodies = dict(data.bodies)
        for name, beam in data.beams.items():
            mechanism._add_beam(name, beam)
        for kind, elements in given.items():
            own: dict[str, Element] = getattr(mechanism, kind)
            own |= {name: mechanism._with_points(one, f"model.{kind}.{quoted(name)}") for name, one in elements.items()}
        last = last_nodes(mechanism.beams)
        fixed = tuple(last.get(name, name) for name in data.assembly.fix)
        mechanism.assembly = data.assembly.model_copy(update={"fix": fixed})
        mechanism.coordinates = {name: _with_last(one, last) for name, one in data.coordinates.items()}
        mechanism.states, mechanism.inputs = dict(data.states), dict(data.inputs)
        mechanism.controllers = dict(data.controllers)
        mechanism.validate()
        return mechanism

    # ---- equations of motion -------------------------------------------------------------------------------------

    def to_sympy(self, *, numbers: bool = True) -> SymbolicSystem:
        """Return the index-1 equations of motion as SymPy matrices, for LaTeX output and numerical evaluation.

        Parameters
        ----------
        numbers
            If True, insert the values of masses, lengths, stiffnesses and other parameters. If False, keep them as
            symbols, whose values are in `SymbolicSystem.parameters`. Expressions of t are inserted as written in both
            cases.

        Raises
        ------
        SpecError
            For the first error of the mechanism, or for a force that has no symbolic form. The error contains the key
            path.
        """
        system: SymbolicSystem = higher_layers.symbolic_system(self, numbers=numbers)
        return system

    # ---- private -------------------------------------------------------------------------------------------------

    def _of_elements(self, values: Callable[[Element], list[tuple[str, AnyValue]]]) -> list[tuple[str, AnyValue]]:
        """Return (key path, value) for each pair (key, value) that the function `values` returns for an element."""
        return [
            (f"model.{kind}.{quoted(name)}.{key}", value)
            for kind, elements in self.elements.items()
            for name, one in elements.items()
            for key, value in values(one)
        ]


def own_names() -> list[str]:
    """Return the names of the attributes that mechanisms have without elements of plugins."""
    return list(object.__dir__(Mechanism()))


def _with_last(one: NamedCoordinate, last: Mapping[str, str]) -> NamedCoordinate:
    """Return a coordinate with the names of last nodes of beams in place of ``BEAM.last``."""
    owner, dot, quantity = one.of.rpartition(".")
    other = one.relative_to
    names = {"of": last.get(owner, owner) + dot + quantity, "relative_to": last.get(other, other) if other else other}
    return one.model_copy(update=names)


def _point(value: object, key: str) -> tuple[float, float]:
    try:
        point: tuple[float, float] = traced(partial(_POINT.validate_python, strict=True), Point, value)
    except ValidationError as error:
        raise spec_error(error, Point, prefix=key) from None
    return point


def _plain(element: StrictModel) -> dict[str, object]:
    return element.model_dump(mode="json", exclude_defaults=True)
