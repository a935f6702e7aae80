"""Histories of single bodies, joints and constraint rows: named columns, which follow from the table of quantities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

import numpy as np

from mbdkit.archive import recorded_columns as columns
from mbdkit.archive.named_columns import Histories, Source
from mbdkit.base.errors import UnknownNameError
from mbdkit.base.frozen import dataclass, fields
from mbdkit.base.html_view import HtmlView
from mbdkit.mechanism.beam_shape import places_with_ends, with_ends
from mbdkit.mechanism.beams import beam_of, named_body
from mbdkit.quantities.registered_kinds import kind_of_group


class BodyHistory(columns.Trajectory, of="trajectory"):
    """Motion of one body: its centre of mass in the global frame and its angle."""


class JointHistory(columns.Joints, of="joints"):
    """Misalignment of one joint and its reaction: force and torque of the first body on the second.

    Its `angle` is in `angle_units`: ``rad``, or ``m`` for the travel of a slide.
    """

    index: int

    @property
    def misalignment_max(self) -> float:
        """Largest misalignment over every step, recorded or not, m."""
        return float(self.source.joint_misalignments[self.index])

    @property
    def reaction_force_error(self) -> np.ndarray:
        """Bound of the error of the reaction force at each time, (T,), N, if the run was checked: nan where unknown.

        >>> run = mbdkit.run("double-pendulum", check=True)
        >>> run.joints["J1"].reaction_force_error
        """
        return self.source.column("accuracy/reaction_error", self.index, None)

    @property
    def reaction_torque_error(self) -> np.ndarray:
        """Bound of the error of the reaction torque at each time, (T,), N m; see `reaction_force_error`."""
        return self.source.column("accuracy/torque_error", self.index, None)


class ForceHistory(columns.Forces, of="forces"):
    """Length, force and energy of one force element.

    The value is a tension [N], positive where it pulls the bodies together; a torque on the second body [N m], positive
    counter-clockwise; or the magnitude of a force at a point [N]. The second body of a load is the one that it acts on.
    """


class MarkerHistory(columns.Markers, of="markers"):
    """Position and velocity of one marker in the global frame."""


class BeamHistory(columns.Beams, of="beams"):
    """Shape, internal forces and strain energy of one beam.

    Internal forces are those in the middle of each element, in the frame of the cross-section, whose x axis is the
    tangent: the force and moment that the part on the side of end b exerts on the part on the side of end a. The moment
    is positive where it increases the angle along the beam.
    """

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the nodes, which are bodies."""
        return tuple(body for body in self.source.objects(kind_of_group("trajectory")) if self._has_node(body))

    @property
    def position(self) -> np.ndarray:
        """Position (x, y) and angle of every node, (T, nodes, 3), m and rad."""
        nodes = [k for k, body in enumerate(self.source.objects(kind_of_group("trajectory"))) if self._has_node(body)]
        return self.source.array("trajectory/position")[:, nodes[0] : nodes[-1] + 1]

    @property
    def arc_length(self) -> np.ndarray:
        """Distances from end a at which `along` returns values, (elements + 2,) [m], at the start of the run."""
        return places_with_ends(self._length, self.moment.shape[1])

    def along(self, component: str) -> np.ndarray:
        """Return `axial`, `shear` or `moment` at end a, in the middle of the elements, and at end b, (T, elements + 2)
        [N or N m]; see `mbdkit.mechanism.beam_shape.with_ends`.
        """
        forces = np.stack([self.axial, self.shear, self.moment], axis=-1)
        values = with_ends(forces, self.position[..., 2], self._length / self.moment.shape[1])
        return np.asarray(values[..., ("axial", "shear", "moment").index(component)])

    @property
    def _length(self) -> float:
        """Length of the beam in the first row [m].

        Consecutive nodes are joined by circular arcs, each of which turns by the difference between their angles.
        """
        steps = np.diff(self.position[0], axis=0)
        turn = 0.5 * steps[:, 2]
        return float(np.sum(np.hypot(steps[:, 0], steps[:, 1]) / np.sinc(turn / np.pi)))

    def _has_node(self, body: str) -> bool:
        return beam_of(body) == self.name

    def __repr__(self) -> str:
        return f"<beam {self.name}: {len(self.nodes)} nodes>"


class StateHistory(columns.States, of="states"):
    """Value and rate of one first-order state."""


@dataclass(frozen=True)
class InputSettings:
    """The values to which an input was set during a run, in order of time; the first one is that at the start.

    For an input that changes linearly, these are the points between which it does, up to the end of the run.

    Attributes
    ----------
    time
        Times, (S,), s.
    value
        Values, (S,), in the unit of the input.
    """

    time: np.ndarray
    value: np.ndarray

    def __len__(self) -> int:
        return len(self.time)


class InputHistory(columns.Inputs, of="inputs"):
    """Value of one input, in `units`. A row at a time at which the input was set shows the value before it."""

    @property
    def set(self) -> InputSettings:
        """Times and values at which the input was set."""
        own = self.source.array("inputs/set/name") == self.name
        return InputSettings(self.source.array("inputs/set/instant")[own], self.source.array("inputs/set/value")[own])


class ConstraintHistory(columns.Constraints, of="constraints"):
    """Residuals and multipliers of one constraint row, whose constraint function is in `units`: ``m`` or ``rad``."""


class Energy(columns.Energy, of="energy"):
    """Energies of the whole mechanism.

    `dissipated` contains the losses of dampers, passive laws, joints with friction, beams and rigid contacts. `work`
    contains the work of drivers, loads and active elements, among them the whole work of compliant contacts, whose
    losses are negative work.
    """


class Steps(columns.Steps, of="steps"):
    """Statistics of the integrator for each recorded interval; interval i ends at row i (the start is row 0)."""


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


@dataclass(frozen=True)
class Impacts:
    """Impacts of rigid contacts, and impulses of drivers whose velocities jump, in order of time.

    Attributes
    ----------
    time
        Times of the impacts, (I,), s. A geometric sequence of impacts that is left out has one entry, at its end.
    contact
        Name of the contact or driver of each impact, (I,).
    normal_impulse, tangential_impulse
        Impulses on the second body, (I,), N s; 0 at the end of a sequence, and for drivers, whose impulses are among
        those of the joints.
    energy_lost
        For a contact, the energy that all contacts dissipate at this time; for a driver, the energy that all drivers
        take from the bodies at this time, negative if they add energy; (I,), J. Simultaneous impacts of contacts all
        have the same entry, and so have simultaneous impulses of drivers; `total_energy_lost` counts each energy once.
    joint
        Names of the joints, drivers included, (J,).
    reaction_impulse
        Impulse of the first body of each joint on the second in all impacts at this time, (I, J, 2), N s, global frame;
        nan in archives that lack it.
    reaction_torque_impulse
        Impulse of the torque on the second body at its joint point, (I, J), N m s; nan in archives that lack it.
    """

    time: np.ndarray
    contact: np.ndarray
    normal_impulse: np.ndarray
    tangential_impulse: np.ndarray
    energy_lost: np.ndarray
    joint: np.ndarray
    reaction_impulse: np.ndarray
    reaction_torque_impulse: np.ndarray

    @classmethod
    def of(cls, run: Source) -> Impacts:
        """Return the impacts recorded by a run; none if it has neither rigid contacts nor `impacts: allow`."""
        joints = run.array("joints/joint")
        count = len(run.array("impacts/time")) if run.records("impacts/time") else 0
        absent = {
            "contact": np.zeros(count, dtype=object),
            "joint": joints,
            "reaction_impulse": np.full((count, len(joints), 2), np.nan),
            "reaction_torque_impulse": np.full((count, len(joints)), np.nan),
        }
        none = np.zeros(count)
        paths = {item.name: f"impacts/{item.name}" for item in fields(cls)}
        return cls(*(run.array(x) if run.records(x) else absent.get(name, none) for name, x in paths.items()))

    @property
    def total_energy_lost(self) -> float:
        """Energy that all impacts of the run take from the bodies [J]; simultaneous impacts count once."""
        return float(np.sum(np.unique(np.column_stack([self.time, self.energy_lost]), axis=0)[:, 1]))

    def __len__(self) -> int:
        return len(self.time)


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

    def __init__(self, watched: Sequence[str], *arrays: np.ndarray):
        self._watched, self._arrays = watched, arrays
        self.names, self.time, self.direction, self.position, self.velocity = arrays

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
        return type(self)(self._watched, *(values[its] for values in self._arrays))

    def __len__(self) -> int:
        return len(self.time)

    @overload
    def __getitem__(self, index: int) -> Event: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Event]: ...

    def __getitem__(self, index: int | slice) -> Event | Sequence[Event]:
        if isinstance(index, slice):
            return [self[number] for number in range(*index.indices(len(self)))]
        return Event(str(self.names[index]), float(self.time[index]), int(self.direction[index]))

    def __repr__(self) -> str:
        return f"<{len(self)} crossings of {', '.join(self._watched) or 'no event'}>"


class BodyHistories(Histories[BodyHistory]):
    """The bodies of a run by name. The last node of a beam is also called ``BEAM.last``."""

    def __missing__(self, name: str) -> BodyHistory:
        body = named_body(name, list(self))
        return self[body] if body != name else super().__missing__(name)


class JointHistories(Histories[JointHistory], HtmlView):
    """The joints of a run by name."""
