"""Histories of single bodies, joints and constraint rows: named columns of the archive's arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar, overload

import numpy as np

from mbdkit.archive.layout import BY_PATH, FORMAT_VERSION, later
from mbdkit.archive.read_only_dict import ReadOnlyDict
from mbdkit.base.errors import MbdkitError
from mbdkit.base.text import did_you_mean, listed
from mbdkit.quantities.array import MIXED


class UnknownNameError(MbdkitError, KeyError):
    """The requested name does not exist in the run."""

    def __init__(self, what: str, name: object, known: Sequence[str]):
        few = listed(known[:8]) + (", ..." if len(known) > 8 else "")
        hint = did_you_mean(str(name), known) or (f"; available: {few}" if known else "; it has none")
        super().__init__(f"the run has no {what} {name!r}{hint}")

    def __str__(self) -> str:
        return str(self.args[0])


class NotRecordedError(MbdkitError, KeyError):
    """The requested array was not recorded by the run.

    Parameters
    ----------
    what
        Path of the array or name of the group.
    version
        Version of the archive's format.
    """

    def __init__(self, what: str, version: str = FORMAT_VERSION):
        why = "`output.quantities` in its spec selects the recorded quantities"
        if what in BY_PATH and BY_PATH[what].optional:
            why = "its method, stabilization and events do not produce it"
        if what.startswith("accuracy/"):
            why = "`check: true` in its spec, or `--check`, estimates errors"
        if later([path for path in BY_PATH if path == what or BY_PATH[path].group == what], version):
            why = f"its archive has format {version}; `mbdkit rerun` with `-o` writes one of format {FORMAT_VERSION}"
        super().__init__(f"this run did not record {what}; {why}")

    def __str__(self) -> str:
        return str(self.args[0])


class Source(Protocol):
    """Interface of the run from which histories are read."""

    def array(self, path: str) -> np.ndarray:
        """Return the whole array at `path`."""
        ...

    def records(self, path: str) -> bool:
        """Return whether the run recorded the array at `path`."""
        ...

    def column(self, path: str, index: int | None, part: slice | int | None) -> np.ndarray:
        """Return the array at `path` for one `index` of its second axis and a `part` of its third."""
        ...


class Column:
    """A property that returns one column of an array of the archive as a read-only array.

    Parameters
    ----------
    part
        Selected part of the last axis of a three-dimensional array.
    what
        Docstring with shape and unit; by default built from the layout.
    """

    def __init__(self, path: str, part: slice | int | None = None, what: str = ""):
        array = BY_PATH[path]
        self.path = path
        self.part = part
        units = "units by row" if array.units == MIXED else array.units
        rows = "N" if array.dims[0] == "interval" else "T"
        shape = f"({rows}, 2)" if array.dims[-1] == "axis" else f"({rows},)"
        self.__doc__ = what or f"{array.long_name}, {shape}, {units}"

    @overload
    def __get__(self, view: None, owner: type) -> Column: ...

    @overload
    def __get__(self, view: View, owner: type) -> np.ndarray: ...

    def __get__(self, view: View | None, owner: type) -> Any:
        if view is None:
            return self
        return view.source.column(self.path, view.index, self.part)


class View:
    """Base class of histories: a set of columns of a run.

    Parameters
    ----------
    name
        Name of the body, joint or constraint row; empty for a whole group.
    index
        Index along the second axis of the arrays.
    """

    def __init__(self, source: Source, name: str = "", index: int | None = None):
        self.source = source
        self.name = name
        self.index = index

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}>" if self.name else f"<{type(self).__name__}>"


_XY = slice(0, 2)
_THETA = 2


class BodyHistory(View):
    """Motion of one body: its centre of mass in the global frame and its angle."""

    position = Column("trajectory/position", _XY, "position of the centre of mass, (T, 2), m")
    angle = Column("trajectory/position", _THETA, "angle from the global x axis, never wrapped, (T,), rad")
    velocity = Column("trajectory/velocity", _XY, "velocity of the centre of mass, (T, 2), m/s")
    angular_velocity = Column("trajectory/velocity", _THETA, "angular velocity, (T,), rad/s")
    acceleration = Column("trajectory/acceleration", _XY, "acceleration of the centre of mass, (T, 2), m/s^2")
    angular_acceleration = Column("trajectory/acceleration", _THETA, "angular acceleration, (T,), rad/s^2")


class JointHistory(View):
    """Misalignment of one joint and its reaction: force and torque of the first body on the second."""

    misalignment = Column("joints/misalignment")
    velocity_misalignment = Column("joints/velocity_misalignment")
    angle_misalignment = Column("joints/angle_misalignment")
    reaction_force = Column("joints/reaction_force")
    reaction_torque = Column("joints/reaction_torque")
    reaction_force_first = Column("joints/reaction_force_first")
    reaction_force_second = Column("joints/reaction_force_second")
    angle = Column("joints/angle")
    driver_power = Column("joints/driver_power")

    def __init__(
        self,
        source: Source,
        name: str,
        index: int,
        misalignment_max: float,
        bodies: tuple[str, str],
        angle_units: str,
    ):
        super().__init__(source, name, index)
        #: Unit of `angle`: ``rad``, or ``m`` for the travel of a slide.
        self.angle_units = angle_units
        #: First and second body; reactions are exerted by the first on the second.
        self.bodies = bodies
        #: Largest misalignment over every step, recorded or not, m.
        self.misalignment_max = misalignment_max


class ForceHistory(View):
    """Length, force and energy of one force element.

    The value is a tension [N], positive where it pulls the bodies together; a torque on the second body [N m], positive
    counter-clockwise; or the magnitude of a force at a point [N].
    """

    length = Column("forces/length")
    rate = Column("forces/rate")
    value = Column("forces/value")
    power = Column("forces/power")
    potential = Column("forces/potential")

    def __init__(self, source: Source, name: str, index: int, bodies: tuple[str, str], units: str):
        super().__init__(source, name, index)
        #: First and second body; the second body of a load is the one that it acts on.
        self.bodies = bodies
        #: Unit of `value`: ``N`` or ``N m``.
        self.units = units


class MarkerHistory(View):
    """Position and velocity of one marker in the global frame."""

    position = Column("markers/position")
    velocity = Column("markers/velocity")

    def __init__(self, source: Source, name: str, index: int, body: str):
        super().__init__(source, name, index)
        #: Body of the marker.
        self.body = body


class BeamHistory:
    """Shape, internal forces and strain energy of one beam.

    Internal forces are those in the middle of each element, in the frame of the cross-section, whose x axis is the
    tangent: what the part towards the end b exerts on the part towards the end a.

    Parameters
    ----------
    source
        The run.
    name
        Name of the beam.
    elements
        Its elements along the axis ``element``.
    bodies
        Names of all bodies of the run.
    """

    def __init__(self, source: Source, name: str, elements: slice, bodies: Sequence[str]):
        self.source, self.name = source, name
        self.index = elements
        #: Names of the nodes, which are bodies.
        self.nodes: tuple[str, ...] = tuple(body for body in bodies if body.rpartition(".")[0] == name)
        first = list(bodies).index(self.nodes[0])
        self._bodies = slice(first, first + len(self.nodes))

    @property
    def position(self) -> np.ndarray:
        """Position (x, y) and angle of every node, (T, nodes, 3), m and rad."""
        return self.source.array("trajectory/position")[:, self._bodies]

    @property
    def axial(self) -> np.ndarray:
        """Axial force in every element, (T, elements), N; positive in tension."""
        return self._of_elements("axial")

    @property
    def shear(self) -> np.ndarray:
        """Shear force in every element, (T, elements), N."""
        return self._of_elements("shear")

    @property
    def moment(self) -> np.ndarray:
        """Bending moment in every element, (T, elements), N m; positive where it increases the angle along the beam."""
        return self._of_elements("moment")

    @property
    def strain_energy(self) -> np.ndarray:
        """Strain energy of the beam, (T,), J."""
        return np.asarray(self._of_elements("strain_energy").sum(axis=1))

    def _of_elements(self, quantity: str) -> np.ndarray:
        return self.source.array(f"beams/{quantity}")[:, self.index]

    def __repr__(self) -> str:
        return f"<beam {self.name}: {len(self.nodes)} nodes>"


class ObservedHistory(View):
    """One observed quantity of a measured motion: as measured, and as the fitted mechanism has it."""

    raw = Column("motion/raw")
    fitted = Column("motion/fitted")
    residual = Column("motion/residual")

    def __init__(self, source: Source, name: str, index: int, units: str):
        super().__init__(source, name, index)
        #: Unit of the quantity: ``m`` or ``rad``.
        self.units = units


class ActuatorHistory(View):
    """Value, its error and power of one actuator, in inverse dynamics."""

    value = Column("actuators/value")
    power = Column("actuators/power")
    #: Bound of the error of `value` that holds with a probability of 95 % at each time; nan where unknown.
    value_error = Column("actuators/value_error")

    def __init__(self, source: Source, name: str, index: int, units: str):
        super().__init__(source, name, index)
        #: Unit of `value`: ``N`` or ``N m``.
        self.units = units


class LoadHistory(View):
    """One measured load, in inverse dynamics; force and point of application are in the global frame."""

    force = Column("loads/force")
    point = Column("loads/point")
    torque = Column("loads/torque")
    power = Column("loads/power")

    def __init__(self, source: Source, name: str, index: int, body: str):
        super().__init__(source, name, index)
        #: Body that the load acts on.
        self.body = body


class ConstraintHistory(View):
    """Residuals and multipliers of one constraint row."""

    position_residual = Column("constraints/position_residual")
    velocity_residual = Column("constraints/velocity_residual")
    multiplier = Column("constraints/multiplier")
    method_multiplier = Column("constraints/method_multiplier")

    def __init__(self, source: Source, name: str, index: int, units: str):
        super().__init__(source, name, index)
        #: Unit of the constraint function: ``m`` or ``rad``.
        self.units = units


class Energy(View):
    """Energies of the whole mechanism."""

    kinetic = Column("energy/kinetic")
    potential = Column("energy/potential")
    total = Column("energy/total")
    dissipated = Column("energy/dissipated")
    work = Column("energy/work")
    balance = Column("energy/balance")


class Steps(View):
    """Statistics of the integrator for each recorded interval; interval i ends at row i (the start is row 0)."""

    time = Column("steps/time")
    steps = Column("steps/steps")
    size = Column("steps/size")
    iterations = Column("steps/iterations")
    iterations_max = Column("steps/iterations_max")
    rejected = Column("steps/rejected")
    projections = Column("steps/projections")
    position_correction = Column("steps/position_correction")
    velocity_correction = Column("steps/velocity_correction")
    acceleration_correction = Column("steps/acceleration_correction")


@dataclass(frozen=True)
class Event:
    """One crossing of an event.

    Attributes
    ----------
    name
        Name of the event in the spec.
    time
        Time at which the expression crossed zero, s.
    direction
        1 for an upward crossing, -1 for a downward one.
    """

    name: str
    time: float
    direction: int


class Events(Sequence[Event]):
    """Crossings of events in order of time; `of_name` selects the crossings of one event.

    Attributes
    ----------
    names
        Name of the event of each crossing, (E,).
    time
        Times of the crossings, (E,), s.
    direction
        1 for an upward crossing, -1 for a downward one, (E,).
    position, velocity
        x, y and angle of every body at the crossings, and their rates, (E, B, 3), m, rad, m/s, rad/s.
    """

    def __init__(
        self,
        watched: Sequence[str],
        names: np.ndarray,
        time: np.ndarray,
        direction: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
    ):
        self._watched = watched
        self.names, self.time, self.direction = names, time, direction
        self.position, self.velocity = position, velocity

    @classmethod
    def of(cls, run: Source, watched: Sequence[str], bodies: int) -> Events:
        """Return the crossings recorded by a run whose spec has the events `watched`."""
        if watched and run.records("events/time"):
            names = ("name", "time", "direction", "position", "velocity")
            return cls(watched, *(run.array(f"events/{name}") for name in names))
        none = np.zeros(0)
        states = np.zeros((0, bodies, 3))
        return cls(watched, none.astype(object), none, none.astype(np.int64), states, states)

    def of_name(self, name: str) -> Events:
        """Return the crossings of the event `name`; raise UnknownNameError if the spec has no such event."""
        if name not in self._watched:
            raise UnknownNameError("event", name, list(self._watched))
        its = np.flatnonzero(self.names == name)
        values = (self.names, self.time, self.direction, self.position, self.velocity)
        return type(self)(self._watched, *(value[its] for value in values))

    def __len__(self) -> int:
        return len(self.time)

    @overload
    def __getitem__(self, index: int) -> Event: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Event]: ...

    def __getitem__(self, index: int | slice) -> Event | Sequence[Event]:
        if isinstance(index, slice):
            return [self[place] for place in range(*index.indices(len(self)))]
        return Event(str(self.names[index]), float(self.time[index]), int(self.direction[index]))

    def __repr__(self) -> str:
        return f"<{len(self)} crossings of {', '.join(self._watched) or 'no event'}>"


V = TypeVar("V", bound=View | BeamHistory)


class Histories(ReadOnlyDict[str, V]):
    """The histories of a run by name, in the order of the archive.

    Parameters
    ----------
    make
        Creates a history from a name and its index.
    """

    what: ClassVar[str]
    """Kind of object, such as ``body``."""

    def __init__(self, names: Sequence[str], make: Callable[[str, int], V]):
        super().__init__((name, make(name, index)) for index, name in enumerate(names))

    def __missing__(self, name: str) -> V:
        raise UnknownNameError(self.what, name, list(self))

    def __repr__(self) -> str:
        return f"<{len(self)} of {self.what}: {', '.join(list(self)[:8])}{', ...' if len(self) > 8 else ''}>"


class BodyHistories(Histories[BodyHistory]):
    """The bodies of a run by name."""

    what = "body"


class JointHistories(Histories[JointHistory]):
    """The joints of a run by name."""

    what = "joint"


class ForceHistories(Histories[ForceHistory]):
    """The force elements of a run by name."""

    what = "force element"


class MarkerHistories(Histories[MarkerHistory]):
    """The markers of a run by name."""

    what = "marker"


class BeamHistories(Histories[BeamHistory]):
    """The beams of a run by name."""

    what = "beam"


class ConstraintHistories(Histories[ConstraintHistory]):
    """The constraints of a run by name."""

    what = "constraint"


class ObservedHistories(Histories[ObservedHistory]):
    """The observed quantities of a measured motion by name."""

    what = "observed quantity"


class ActuatorHistories(Histories[ActuatorHistory]):
    """The actuators of inverse dynamics by name."""

    what = "actuator"


class LoadHistories(Histories[LoadHistory]):
    """The measured loads of inverse dynamics by name."""

    what = "load"
