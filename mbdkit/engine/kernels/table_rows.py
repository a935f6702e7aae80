"""Rows of the tables of a mechanism (`mbdkit.engine.kernels.engine_bundles`), with a name for every column.

Lowering appends rows (``PairRow(kind, first, second, motion)``); kernels and all other readers name a column by the
constant of the same table (``pairs[k, PAIR.motion]``). Such a constant is a NamedTuple of integers, so that compiled
code contains the same number as with a literal index.
"""

from __future__ import annotations

from typing import NamedTuple

BODIES = slice(1, 3)  #: Columns of both bodies in tables of pairs, springs, joints and loads.


class PairRow(NamedTuple):
    """A pair of constraint rows."""

    kind: int  #: `mbdkit.engine.kernels.constraints.KINDS`.
    first: int  #: First body.
    second: int  #: Second body.
    #: Motion, first function of a moving center, or first row of a function of the pose in `Scratch.u`; -1 for none.
    motion: int


class FunctionRow(NamedTuple):
    """A constraint that is a function of the pose of its second body in the frame of its first body."""

    first: int  #: First body.
    second: int  #: Second body.
    pair: int  #: Its pair of constraint rows.
    law: int  #: Row of the law of its value and first two derivatives; the next row is that of its third derivatives.
    row: int  #: First row of its values in `Scratch.u`.


class SpareRow(NamedTuple):
    """A redundant direction."""

    pair: int
    body: int  #: Body in whose frame the direction is fixed.


class SpringRow(NamedTuple):
    """A segment of a force element on a pathway."""

    pathway: int  #: `mbdkit.engine.kernels.applied_forces.PATHWAYS`.
    first: int  #: First body.
    second: int  #: Second body.
    law: int  #: Row of the table of laws; -1 for a linear spring.
    leader: int  #: First segment of the same spring.
    segments: int  #: Number of segments of the spring; 0 for all but its first one.
    guide: int = -1  #: Row of the law of a guided segment; -1 for others.
    place: int = -1  #: Row of ``Scratch.guide`` of a guided segment.


class CouplingRow(NamedTuple):
    """An ordered pair of different segments of the same spring."""

    of_force: int  #: Segment whose generalized force is differentiated.
    of_coordinates: int  #: Segment with respect to whose coordinates it is differentiated.


class LinearColumns(NamedTuple):
    """Columns of numbers of a linear spring."""

    stiffness: int
    damping: int
    free_length: int


class TensionColumns(NamedTuple):
    """Columns of the values of a law on a pathway."""

    force: int
    by_length: int  #: Derivative of the force with respect to the length.
    by_rate: int  #: Derivative of the force with respect to the rate of the length.
    potential: int


class LawRow(NamedTuple):
    """A force law."""

    address: int  #: Address of its machine code.
    parameters: int  #: Index of its number of parameters in `law_parameters`; their values follow.
    claims: int  #: `HAS_POTENTIAL` and `PASSIVE` as bits.
    program: int  #: Address of its program (`mbdkit.engine.native.calls`).


class StateRow(NamedTuple):
    """A first-order state."""

    segment: int  #: First segment of its force element; -1 for none.
    parameter: int  #: Index of its value in `law_parameters`.
    rate: int  #: Row of the law of its rate; -1 if it is held between samples.


class StateUse(NamedTuple):
    """An element of `law_parameters` that holds the value of a first-order state."""

    state: int
    parameter: int


class InputRow(NamedTuple):
    """An input of an expression of the state."""

    kind: int  #: `POSITION_INPUT` or another kind of `mbdkit.engine.kernels.applied_forces`.
    source: int  #: Coordinate, or first segment of a spring.
    parameter: int  #: Index of its value in `law_parameters`.


class LoadValueRow(NamedTuple):
    """A component of a load that is an expression of the state."""

    law: int
    motion: int  #: Motion whose value is replaced.


class SlopeRow(NamedTuple):
    """The derivative of such a component with respect to an input."""

    load: int
    component: int
    law: int
    input: int
    segment: int  #: Segment of the pathway that is the input; -1 for coordinates.


class MultiplierRow(NamedTuple):
    """A multiplier on which the friction in a joint depends."""

    pair: int
    row: int
    parameter: int  #: Index of its value in `law_parameters`.
    friction: int


class LoadRow(NamedTuple):
    """A force or torque on a body."""

    kind: int  #: `TORQUE`, `POINT_FORCE` or `BODY_FORCE`.
    body: int
    reaction_body: int
    x: int  #: Motion of the component x, or of the torque.
    y: int  #: Motion of the component y; -1 for a torque.


class InteractionRow(NamedTuple):
    """Forces and torques on two bodies that depend on their poses and velocities."""

    first: int
    second: int
    law: int  #: Row of the law of the forces; the next row is that of their derivatives.


class SectionRow(NamedTuple):
    """A cross-section at which an element of a beam is integrated."""

    element: int
    node_count: int  #: Number of nodes of the element.
    node: int  #: First node; the others follow.
    second_node: int
    third_node: int


class JointRow(NamedTuple):
    """A joint whose angle or travel is recorded."""

    kind: int  #: `ANGLE` or `TRAVEL` (`mbdkit.engine.kernels.acting`).
    first: int  #: First body.
    second: int  #: Second body.


PAIR = PairRow(*range(4))
FUNCTION = FunctionRow(*range(5))
SPARE = SpareRow(*range(2))
SPRING = SpringRow(*range(8))
COUPLING = CouplingRow(*range(2))
LINEAR = LinearColumns(*range(3))
TENSION = TensionColumns(*range(4))
LAW_ROW = LawRow(*range(4))
STATE_ROW = StateRow(*range(3))
STATE_USE = StateUse(*range(2))
INPUT = InputRow(*range(3))
LOAD_VALUE = LoadValueRow(*range(2))
SLOPE = SlopeRow(*range(5))
MULTIPLIER = MultiplierRow(*range(4))
LOAD = LoadRow(*range(5))
INTERACTION = InteractionRow(*range(3))
SECTION = SectionRow(*range(5))
JOINT = JointRow(*range(3))
