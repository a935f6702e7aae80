"""A compiled mechanism: flat numbered arrays for the kernels, and the names that belong to the numbers."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass, field
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import counted, listed
from mbdkit.engine.force_laws import CompiledLaw
from mbdkit.engine.friction_forces import FollowingForce
from mbdkit.engine.kernels.engine_bundles import Topology
from mbdkit.engine.kernels.pose_functions import OF_TIME
from mbdkit.engine.kernels.table_rows import BODIES, FUNCTION, LAW_ROW, LINEAR, PAIR, STATE_ROW
from mbdkit.mechanism.element_kinds import ChosenTreatment, element_kinds, reacting_among
from mbdkit.mechanism.pathways import LawForce
from mbdkit.mechanism.values import Motion
from mbdkit.registry.element_items import ElementKind

#: Limit of a ratio: the sum of the squared numbers of pairs of rows on each body, by the number of all pairs of rows.
#:
#: Above this limit, the Schur complement is denser than the whole system, and the pivoted solver is used.
MOST_COUPLINGS = 60


def with_ground(x: np.ndarray) -> np.ndarray:
    """Return coordinates or velocities, (3 B,) or (B, 3), as a vector (3 (B + 1),) that ends with zeros for ground."""
    with_it = np.zeros(x.size + 3)
    with_it[:-3] = x.ravel()
    return with_it


@dataclass(frozen=True)
class Row:
    """One constraint row: its pair, its index in the pair (0 or 1), its label ``joint.row`` and its unit."""

    pair: int
    place: int
    label: str
    unit: str


@dataclass(frozen=True)
class ForceElement:
    """Name of a force element or load, its first and second body, and the unit of its length, m or rad.

    A load acts on its second body.
    """

    name: str
    bodies: tuple[str, str]
    unit: str


@dataclass(frozen=True)
class ActingForce:
    """A compiled force element with a law along a pathway.

    `kind`, `name`: word for the kind of element, such as ``force``, and name of the element. `force`: the element.
    `place`: index among all force elements, along the second axis of `mbdkit.kernels.Observed.forces`. `state`: index
    of its first state among the first-order states.
    """

    kind: str
    name: str
    force: LawForce
    place: int
    state: int


@dataclass(frozen=True)
class ElementState:
    """A first-order state of a force element or of the mechanism.

    `name`, `unit`: name, such as ``element.state``, and unit. `by_method`: whether the method of the run itself sets
    its value, such as those of reactions of a plugin's elements.
    """

    name: str
    unit: str
    by_method: bool = False


@dataclass(frozen=True)
class SampledController:
    """A sampled controller.

    `period`: time between two samples [s]. `delay`: time from a sample until its outputs apply [s]. `outputs`,
    `states`: for each output and each state, its index among the first-order states, and the row of ``topology.laws``
    that computes its value at a sample. `output_names`: names of the outputs. `python`: the function that computes the
    outputs, whose rows are -1; empty if there is none. `arguments`: for each quantity that the function gets, its name
    and the row that computes it.
    """

    name: str
    period: float
    delay: float
    outputs: tuple[tuple[int, int], ...]
    states: tuple[tuple[int, int], ...]
    output_names: tuple[str, ...] = ()
    python: str = ""
    arguments: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True)
class CompiledInput:
    """An input of a mechanism.

    - `name`, `unit`, `initial`, `bounds`: those of `mbdkit.mechanism.state_values.Input`.
    - `state`: index of its value among the first-order states. The rate of this state is 0, or the state `slope`.
    - `slope`: index of the first-order state with its rate, for an input that is linear between the times at which it
      is set; otherwise -1.
    """

    name: str
    unit: str
    initial: float
    bounds: tuple[float, float] | None
    state: int
    slope: int = -1

    @property
    def is_linear(self) -> bool:
        """Whether the input changes linearly between the times at which it is set."""
        return self.slope >= 0


@dataclass(frozen=True)
class Redundancy:
    """Redundant constraints of a mechanism; none by default.

    `rows`: number of redundant constraint rows. As many are excluded from the equations that are solved. `not_unique`:
    joints, drivers included, whose reactions are not uniquely determined by the motion.
    """

    rows: int = 0
    not_unique: tuple[str, ...] = ()

    def describe(self, drivers: Collection[str] = ()) -> str:
        """Return a description such as ``1 redundant row: joints A and D``; empty if there are no redundant rows."""
        if not self.rows:
            return ""
        kinds = (
            ("joint", [name for name in self.not_unique if name not in drivers]),
            ("driver", [name for name in self.not_unique if name in drivers]),
        )
        named = [f"{kind}{'s' * (len(names) > 1)} {listed(names, 'and')}" for kind, names in kinds if names]
        return f"{counted(self.rows, 'redundant row')}: {listed(named, 'and')}"


@dataclass(frozen=True, eq=False)
class CompiledMechanism:
    """A mechanism in the form used by the kernels. It is immutable and can be shared by any number of runs.

    - `topology`: flat arrays for the kernels.
    - `bodies`, `joints`: names, in the order of the mechanism.
    - `joint_bodies`: (J,) names of the first and the second body of each joint.
    - `rows`: constraint rows in the order of the mechanism's joints, redundant ones included.
    - `joint_pairs`: (J,) numbers of the pairs of rows of each joint.
    - `joint_units`: (J,) unit of the coordinate of each joint, m for a travel and rad for an angle.
    - `forces`: force elements and loads, in the order of the mechanism.
    - `acting`: all force elements with laws along pathways, except friction. Kernels number those of further kinds
      after the force elements and loads.
    - `friction`: indices of the joints with friction.
    - `first_friction`: index of the first friction force among all force elements.
    - `following`: side forces of joints, which follow their reactions; their force elements come after those of
      friction.
    - `extensions`: what further kinds of elements need in runs, by their key in the model; see
      `mbdkit.plugin.ElementKind`.
    - `beams`: name and number of elements of each beam.
    - `markers`: name and body of each marker.
    - `drivers`: names of the joints that are drivers.
    - `coordinates`: number of coordinates: 3 for each body, 2 for each point mass, whose angle is not counted.
    - `length`: characteristic length [m]; see `mbdkit.engine.compile_mechanism.characteristic_length`.
    - `motions`: each motion as given in the model: a number, an expression or a table.
    - `laws`: name of the element and compiled law, in the order of ``topology.laws``: for each force element with a
      law, this law and those of the rates of its states; and laws of forces between two bodies and of expressions of
      the state. Linear springs have no law.
    - `order`, `below`: order of elimination of the pairs, and the resulting fill, as returned by `sparse_order`.
    - `well_scaled`: whether the Schur complement is accurate enough; otherwise the pivoted solver is used.
    - `redundancy`: constraints that are excluded because the other constraints imply them.
    - `states`: first-order states of elements and of the mechanism, and values that are constant during a step: those
      that the method sets, outputs and states of sampled controllers and, last, those of `inputs`.
    - `controllers`, `inputs`: sampled controllers, and inputs.
    - `members`: names and bodies of the elements, for each kind that has no attribute above; an element may have
      several entries.
    - `treatments`: treatments of elements in a run.
    """

    topology: Topology
    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    joint_bodies: tuple[tuple[str, str], ...]
    rows: tuple[Row, ...]
    joint_pairs: tuple[tuple[int, ...], ...]
    joint_units: tuple[str, ...]
    forces: tuple[ForceElement, ...]
    beams: tuple[tuple[str, int], ...]
    markers: tuple[tuple[str, str], ...]
    drivers: frozenset[str]
    coordinates: int
    length: float
    motions: tuple[Motion, ...]
    laws: tuple[tuple[str, CompiledLaw], ...]
    order: tuple[int, ...]
    below: tuple[frozenset[int], ...]
    well_scaled: bool
    redundancy: Redundancy = Redundancy()
    states: tuple[ElementState, ...] = ()
    controllers: tuple[SampledController, ...] = ()
    inputs: tuple[CompiledInput, ...] = ()
    acting: tuple[ActingForce, ...] = ()
    friction: tuple[int, ...] = ()
    first_friction: int = 0
    following: tuple[FollowingForce, ...] = ()
    extensions: Mapping[str, Any] = field(default_factory=dict)
    treatments: tuple[ChosenTreatment, ...] = ()
    members: Mapping[str, tuple[tuple[str, tuple[str, ...]], ...]] = field(default_factory=dict)

    def with_numbers(self, arrays: Mapping[str, np.ndarray], length: float) -> CompiledMechanism:
        """Return the mechanism with other floating-point numbers in some arrays of its topology, in the same places.

        `arrays`: these arrays by name; entries that are 0 remain so, and others remain different from 0. `length`:
        characteristic length [m].
        """
        other = object.__new__(CompiledMechanism)
        other.__dict__.update(self.__dict__, topology=self.topology._replace(**arrays), length=length)
        return other

    def freedoms(self) -> str:
        """Return a description such as ``1 degree of freedom, 10 joints, 1 driver``, with any redundant rows.

        The number of degrees of freedom is the number of coordinates minus the number of independent constraint rows.
        """
        number = self.coordinates - int(np.sum(self.topology.rows))
        parts = [
            counted(number, "degree of freedom", "degrees of freedom"),
            counted(len(self.joints) - len(self.drivers), "joint"),
            counted(len(self.drivers), "driver") if self.drivers else "",
            self.redundancy.describe(self.drivers),
        ]
        return ", ".join(part for part in parts if part)

    @property
    def in_python(self) -> tuple[SampledController, ...]:
        """The controllers whose outputs a Python function computes."""
        return tuple(controller for controller in self.controllers if controller.python)

    @property
    def named_states(self) -> tuple[ElementState, ...]:
        """The first-order states without those of inputs, which come last."""
        return self.states[: min((item.state for item in self.inputs), default=len(self.states))]

    @property
    def initial_states(self) -> np.ndarray:
        """(Z,) initial values of the first-order states."""
        return self.topology.law_parameters[self.topology.states[:, STATE_ROW.parameter]]

    @property
    def reacting(self) -> ChosenTreatment | None:
        """The treatment of elements whose reactions the steps of a run determine; None if there are none."""
        return reacting_among(self.treatments)

    def kinds(self) -> list[tuple[object, ElementKind]]:
        """Return the objects of `extensions`, each with its kind of elements."""
        return [(handle, element_kinds()[key]) for key, handle in self.extensions.items()]

    def refuse_kinds(self, what: str) -> None:
        """Raise SpecError if there are elements of a plugin's kind that does not support `what`, such as gradients, or
        whose treatment does not.
        """
        for _, kind in self.kinds():
            if what in kind.supports:
                raise SpecError(kind.supports[what], key=f"model.{kind.key_in_model}")
        for chosen in self.treatments:
            if what in chosen.item.supports:
                raise SpecError(chosen.item.supports[what], key=f"{chosen.section_key}.treatment")

    def refuse_states(self, what: str) -> None:
        """Raise SpecError if the mechanism has first-order states, which `what`, a computation, does not support."""
        if self.states:
            names = listed([state.name for state in self.states], "and")
            raise SpecError(f"{what} does not include first-order states ({names})", key="model")

    def refuse_side_forces(self, what: str) -> None:
        """Raise SpecError if a joint has a side force; `what` names the computation that does not support them."""
        for force in self.following:
            message = f"{what} does not include {force.side.name} of joint '{force.name}'; set it to 0"
            raise SpecError(message, key=f"model.joints.{quoted(force.name)}.{force.side.key}")

    def refuse_friction_of_shared_reactions(self) -> None:
        """Raise SpecError if a joint with friction has a reaction that is not unique."""
        for name in (self.joints[number] for number in self.friction):
            if name in self.redundancy.not_unique:
                raise SpecError(
                    f"the reaction of joint '{name}' is not unique, because joints are redundant, so that its friction "
                    "is not known; remove the redundant joints, or the friction",
                    key=f"model.joints.{quoted(name)}.friction",
                )

    def beam_elements(self, name: str) -> slice:
        """Return the indices of the elements of a beam among the elements of all beams."""
        names, counts = zip(*self.beams, strict=True)
        place = names.index(name)
        first = sum(counts[:place])
        return slice(first, first + counts[place])

    @property
    def size(self) -> int:
        """Length of a state vector, 3 (B + 1)."""
        return 3 * (len(self.bodies) + 1)

    @cached_property
    def has_power(self) -> bool:
        """Whether there are loads, drivers, dampers or force laws, so that work or dissipated energy can change."""
        return self.does_work(self.topology)

    def does_work(self, top: Topology) -> bool:
        """Return the same for a topology without some of these loads and laws."""
        damped = np.any(top.linear[:, LINEAR.damping]) or np.any(top.section_parameters[:, -3:])
        of_joints = np.concatenate([top.functions[:, FUNCTION.law], top.functions[:, FUNCTION.law] + 1])
        laws = np.delete(np.arange(len(top.laws)), of_joints)
        return bool(len(top.loads) or damped or len(laws) or self.is_driven)

    @cached_property
    def is_driven(self) -> bool:
        """Whether constraints depend on the time."""
        return bool(len(self.drives) or self._depends_on_time)

    @cached_property
    def _depends_on_time(self) -> bool:
        """Whether joints that are functions of the pose depend on the time."""
        claims = self.topology.laws[self.topology.functions[:, FUNCTION.law], LAW_ROW.claims]
        return bool(np.any(claims == OF_TIME))

    @cached_property
    def in_functions(self) -> np.ndarray:
        """(L,) whether numbers of laws are those of joints that are functions of the pose."""
        top = self.topology
        found = np.zeros(len(top.law_parameters), dtype=bool)
        for begin in top.laws[top.functions[:, FUNCTION.law], LAW_ROW.parameters].tolist():
            found[begin + 1 : begin + 1 + int(top.law_parameters[begin])] = True
        return found

    @cached_property
    def is_locked(self) -> bool:
        """Whether nothing can move, so that all velocities and energies of motion are rounding errors: drivers hold
        what they drive if their motions are numbers.
        """
        is_held = not self._depends_on_time and all(isinstance(self.motions[k], int | float) for k in self.drives)
        return self.coordinates == int(np.sum(self.topology.rows)) and is_held

    @cached_property
    def drives(self) -> np.ndarray:
        """Indices of the motions that drive constraints, in increasing order."""
        motions = self.topology.pairs[:, PAIR.motion]
        return np.unique(motions[(motions >= 0) & (motions < len(self.motions))])

    @cached_property
    def needs_pivots(self) -> bool:
        """Whether the pivoted solver is needed: the Schur complement would be inaccurate, or denser than the whole
        system.
        """
        top = self.topology
        on_body = np.bincount(top.pairs[:, BODIES].ravel(), minlength=len(top.mass))[:-1]
        crowded = int(np.sum(on_body**2)) > MOST_COUPLINGS * max(len(top.pairs), 1)
        return crowded or not self.well_scaled

    @cached_property
    def unknowns(self) -> int:
        """Number of unknowns of the index-1 equations: accelerations and multipliers of the independent rows."""
        return 3 * len(self.bodies) + int(np.sum(self.topology.rows))

    @property
    def row_index(self) -> np.ndarray:
        """(P, 2) index of each multiplier among the unknowns of the pivoted system; -1 for redundant or absent rows."""
        index = np.full((len(self.topology.pairs), 2), -1, dtype=np.int64)
        for i, row in enumerate(self.solved_rows):
            index[row.pair, row.place] = 3 * len(self.bodies) + i
        return index

    @property
    def solved_rows(self) -> list[Row]:
        """Constraint rows of the pivoted system.

        In a pair with a redundant direction, the solved row is a combination of both rows of the pair.
        """
        return [row for row in self.rows if row.place < self.topology.rows[row.pair]]

    @property
    def natural_order(self) -> np.ndarray:
        """(n,) indices of the unknowns of the pivoted system: coordinates, then multipliers in order of elimination."""
        multipliers = self.row_index.ravel()
        return np.concatenate([np.arange(3 * len(self.bodies)), multipliers[multipliers >= 0]])

    def unknown_name(self, index: int) -> str:
        """Return the body or joint, as text, to which an unknown of the pivoted system belongs."""
        if 0 <= index < 3 * len(self.bodies):
            return f"body {self.bodies[index // 3]!r}{self._joints_on(index // 3)}"
        if index >= 0 and index < self.unknowns:
            return f"joint {self.solved_rows[index - 3 * len(self.bodies)].label.split('.')[0]!r}"
        return "the mechanism"

    def _joints_on(self, body: int) -> str:
        pairs = self.topology.pairs
        held = [
            name
            for name, members in zip(self.joints, self.joint_pairs, strict=True)
            if any(body in pairs[k, BODIES] for k in members)
        ]
        if not held:
            return ""
        listed = ", ".join(held[:4]) + (", ..." if len(held) > 4 else "")
        return f" (joint{'s' * (len(held) > 1)} {listed})"
