"""Compile a mechanism, whose bodies, joints and forces have names, to flat numbered arrays."""

from __future__ import annotations

import marshal
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import combinations
from typing import Never

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass, replace
from mbdkit.base.plain_data import plain
from mbdkit.base.traced_numbers import float_array, largest, smallest
from mbdkit.engine.compile_forces import CompiledMotions, Lowering, Numbers, acting_kinds, table
from mbdkit.engine.compiled_mechanism import CompiledMechanism, Row
from mbdkit.engine.elimination_order import neighbours
from mbdkit.engine.kernels import table_rows
from mbdkit.engine.kernels.acting import ANGLE, TRAVEL
from mbdkit.engine.kernels.constraints import KINDS
from mbdkit.engine.kernels.cross_sections import NODES, PARAMETERS
from mbdkit.engine.kernels.engine_bundles import Topology
from mbdkit.engine.kernels.pose_functions import ROWS
from mbdkit.engine.nested_dissection import sparse_order
from mbdkit.mechanism.angle_function import Center
from mbdkit.mechanism.bodies import Element
from mbdkit.mechanism.element_kinds import element_kinds
from mbdkit.mechanism.impure_items import impure_item_in
from mbdkit.mechanism.joint_base import PoseFunction
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_data import ELEMENTS
from mbdkit.registry.seam import OwnSeam

#: Largest ratio of masses, and of inertias over squared lever arms, for which the Schur complement is accurate.
WELL_SCALED = 1e6


#: Largest number of distances between points of a body that are computed at once, to limit memory.
MOST_DISTANCES = 1 << 16

#: Up to this number of points of a body, distances are computed one by one, without arrays.
FEW_POINTS = 8


def compile_mechanism(mechanism: Mechanism) -> CompiledMechanism:
    """Compile a validated mechanism to flat arrays.

    `mechanism`: bodies, joints and forces by name. Returns the flat arrays. Pairs of constraint rows are numbered in
    order of elimination.
    """
    bodies = tuple(mechanism.bodies)
    number = {name: i for i, name in enumerate(bodies)}
    ground = number["ground"] = len(bodies)
    motions = CompiledMotions()
    pairs = _pairs(mechanism, number, motions)
    forces = Lowering(mechanism, number, motions)
    forces.add_expressions(mechanism)
    beams = _Beams(mechanism, number)
    centered = _add_centers(pairs, motions)
    functions = _add_functions(pairs, tuple(mechanism.joints), forces, len(motions.start) - 1)
    order, below = sparse_order(neighbours([pair.bodies for pair in pairs], ground))
    place = {pair: k for k, pair in enumerate(order)}

    joint_pairs: list[list[int]] = [[] for _ in mechanism.joints]
    joints = list(mechanism.joints.items())
    rows, place_of_row = [], {}
    for written, pair in enumerate(pairs):
        joint_pairs[pair.joint].append(place[written])
        name, joint = joints[pair.joint]
        for r in range(pair.rows):
            row = pair.first_row + r
            place_of_row[pair.joint, row] = place[written], r
            rows.append(Row(place[written], r, f"{name}.{joint.rows[row]}", joint.units[row]))

    length = characteristic_length(mechanism)
    mass = sum(body.mass for body in mechanism.bodies.values())
    if mass * length**2 < sys.float_info.min:
        raise SpecError(
            f"the bodies, of {mass:g} kg in total and {length:g} m in size, are too small to compute with: mass times "
            f"size squared should be at least {sys.float_info.min:.1e} kg m^2; check their units",
            key="model",
        )
    topology = Topology(
        **_of_bodies(mechanism),
        **_of_pairs([pairs[k] for k in order], rows, smallest(1.0, length)),
        **forces.arrays(),
        reactions=table(
            [
                table_rows.MultiplierRow(*place_of_row[joint, row], parameter, friction)
                for joint, row, parameter, friction in forces.reactions
            ],
            table_rows.MULTIPLIER,
        ),
        sections=table(beams.sections, table_rows.SECTION),
        section_parameters=float_array(beams.parameters, PARAMETERS),
        **_of_joints_and_markers(mechanism, number),
        functions=table(
            [table_rows.FunctionRow(*pairs[k].bodies, place[k], law, pairs[k].motion) for k, law in functions],
            table_rows.FUNCTION,
        ),
        centers=np.array([pair.bodies for pair in centered], dtype=np.int64).reshape(-1, 2),
        motion_start=np.array(motions.start, dtype=np.int64),
        motion_ops=np.array(motions.ops, dtype=np.int64),
        motion_values=float_array(motions.values),
        baumgarte=np.zeros(2),
    )
    return CompiledMechanism(
        topology=topology,
        bodies=bodies,
        joints=tuple(mechanism.joints),
        joint_bodies=tuple(joint.bodies for joint in mechanism.joints.values()),
        rows=tuple(rows),
        joint_pairs=tuple(tuple(members) for members in joint_pairs),
        joint_units=tuple(joint.coordinate_unit for _, joint in joints),
        forces=tuple(forces.elements[: len(mechanism.forces)]),
        beams=tuple((name, beam.elements) for name, beam in mechanism.beams.items()),
        markers=tuple((name, marker.body) for name, marker in mechanism.markers.items()),
        drivers=frozenset(name for name, joint in joints if joint.is_driver),
        coordinates=sum(2 if body.inertia is None else 3 for body in mechanism.bodies.values()),
        length=length,
        motions=tuple(motions.numbers),
        laws=tuple(forces.laws),
        states=tuple(forces.states),
        controllers=tuple(forces.controllers),
        inputs=tuple(forces.compiled_inputs),
        acting=tuple(forces.acting),
        friction=tuple(one.number for one in forces.friction),
        first_friction=forces.first_friction,
        following=tuple(forces.following),
        extensions=forces.extensions,
        members=_members(mechanism, forces.extensions),
        treatments=tuple(chosen for chosen in mechanism.treatments if chosen.key in forces.extensions),
        order=tuple(order),
        below=tuple(frozenset(b) for b in below),
        well_scaled=_is_well_scaled(mechanism),
    )


@OwnSeam
def recorded_members(handle: Never, /) -> Iterable[tuple[str, tuple[str, ...]]]:
    """Return the names and the bodies of what archives record of elements."""
    raise NotImplementedError


def _members(
    mechanism: Mechanism, extensions: Mapping[str, object]
) -> dict[str, tuple[tuple[str, tuple[str, ...]], ...]]:
    members, kinds = {}, element_kinds()
    for key, handle in extensions.items():
        own = kinds[key].acts.members
        places = ((name, tuple(body for _, body in one.places())) for name, one in getattr(mechanism, key).items())
        members[key] = tuple(places if own is None else recorded_members.of(own)(handle))
    return members


def _of_bodies(mechanism: Mechanism) -> dict[str, np.ndarray]:
    mass = [(body.mass, body.mass, 1.0 if body.inertia is None else body.inertia) for body in mechanism.bodies.values()]
    weight = [tuple([1.0 / number for number in numbers]) for numbers in mass]
    return {
        "mass": float_array([*mass, (1.0,) * 3]),
        "weight": float_array([*weight, (0.0,) * 3]),
        "gravity": float_array(mechanism.gravity),
    }


def _of_pairs(pairs: Sequence[_Pair], rows: Sequence[Row], unit: float) -> dict[str, np.ndarray]:
    """Return the arrays of `Topology` about pairs of constraint rows, in order of elimination.

    `unit` is the length [m] that relates lengths to angles.
    """
    row_units = [[unit, unit] for _ in pairs]
    for one in rows:
        if one.unit == "rad":
            row_units[one.pair][one.place] = 1.0
    return {
        "pairs": table(
            [table_rows.PairRow(KINDS[pair.kind], *pair.bodies, pair.motion) for pair in pairs], table_rows.PAIR
        ),
        "rows": np.array([pair.rows for pair in pairs], dtype=np.int64),
        "length": float_array([unit]),
        "row_units": float_array(row_units, 2),
        "pair_parameters": float_array([pair.parameters for pair in pairs], 6),
        "spare": table([], table_rows.SPARE),
        "spare_axes": np.zeros((0, 2)),
        "pair_joint": np.array([pair.joint for pair in pairs], dtype=np.int64),
    }


def _of_joints_and_markers(mechanism: Mechanism, number: dict[str, int]) -> dict[str, np.ndarray]:
    joints, markers = mechanism.joints.values(), mechanism.markers.values()
    recorded = [
        table_rows.JointRow(ANGLE if joint.travel is None else TRAVEL, *(number[body] for body in joint.bodies))
        for joint in joints
    ]
    return {
        "joints": table(recorded, table_rows.JOINT),
        "joint_lines": float_array([joint.travel or (0.0,) * 6 for joint in joints], 6),
        "markers": np.array([number[marker.body] for marker in markers], dtype=np.int64),
        "marker_points": float_array([marker.held for marker in markers], 2),
    }


def compiled_content(mechanism: Mechanism) -> bytes | None:
    """Return bytes that identify all input of `compile_mechanism` and the bodies that assembly keeps fixed.

    Mechanisms with equal keys differ only in initial positions and velocities. If a joint depends on the initial
    positions, these are part of the key as well. Numbers are compared bitwise, so that 0.0 and -0.0 differ. The result
    is None if some input has a type that `marshal` does not support, or if code of others that is not pure takes part.
    """
    if impure_item_in(mechanism) is not None:
        return None
    posed = any(joint.point_moves_on_first or joint.angles() for joint in mechanism.joints.values())
    bodies = [
        (name, body.mass, body.inertia, (body.position, body.angle) if posed else None)
        for name, body in mechanism.bodies.items()
    ]
    elements = [
        (name, type(one).__name__, _content(one))
        for kind, named in mechanism.elements.items()
        for name, one in named.items()
        if kind in ELEMENTS
    ]
    fixed, kinds = mechanism.assembly.fix, acting_kinds(mechanism)
    data = [
        (name, plain(one))
        for named in (
            mechanism.beams,
            mechanism.states,
            mechanism.controllers,
            mechanism.inputs,
            *(getattr(mechanism, kind.key_in_model) for kind in kinds),
        )
        for name, one in named.items()
    ]
    data += [("treatment", plain(chosen.content)) for chosen in mechanism.treatments]
    try:
        return marshal.dumps((bodies, data, elements, len(mechanism.joints), tuple(mechanism.gravity), tuple(fixed)), 2)
    except ValueError:  # `marshal` rejects the type of a value, such as an option of a force law
        return None


def _content(element: Element) -> dict[str, object]:
    """Return the data of an element for the key of `compiled_content`; friction as plain data."""
    friction = getattr(element, "friction", None)
    return element.__dict__ if friction is None else {**element.__dict__, "friction": plain(friction)}


@dataclass(frozen=True)
class _Pair:
    """One or two constraint rows of a joint; `first_row` is the index of the first one among the rows of the joint."""

    joint: int
    first_row: int
    rows: int
    kind: str
    bodies: tuple[int, int]
    parameters: Numbers
    motion: int = -1
    center: Center | None = None
    function: PoseFunction | None = None


def _pairs(mechanism: Mechanism, number: dict[str, int], motions: CompiledMotions) -> list[_Pair]:
    """Return the pairs of rows of all joints. The rows of a pair have the same unit, metres or radians."""
    pairs: list[_Pair] = []
    for j, (name, joint) in enumerate(mechanism.joints.items()):
        a, b = joint.bodies
        for one in mechanism.constraints_of(name):
            motion = -1 if one.motion is None else motions.add(one.motion)
            numbers = (*one.points, *one.constants)
            ends = (number[a], number[b])
            pairs.append(_Pair(j, one.first_row, one.rows, one.kind, ends, numbers, motion, one.center, one.function))
    return pairs


def _add_functions(pairs: list[_Pair], names: Sequence[str], forces: Lowering, first_row: int) -> list[tuple[int, int]]:
    """Add the laws of functions of the pose; return the number of the pair, and of the first law, of each.

    Their values are in rows of ``Scratch.u`` from `first_row` on.
    """
    functions = []
    for k, pair in enumerate(pairs):
        if pair.function is not None:
            functions.append((k, forces.function(names[pair.joint], pair.function)))
            pairs[k] = replace(pair, motion=first_row + ROWS * (len(functions) - 1))
    return functions


def _add_centers(pairs: list[_Pair], motions: CompiledMotions) -> list[_Pair]:
    """Append the programs of moving centres to those of all motions; return their pairs, in order."""
    centered = []
    for k, pair in enumerate(pairs):
        if pair.center is not None:
            pairs[k] = replace(pair, motion=motions.add_center(pair.center))
            centered.append(pairs[k])
    return centered


class _Beams:
    def __init__(self, mechanism: Mechanism, number: dict[str, int]):
        self.sections: list[table_rows.SectionRow] = []
        self.parameters: list[Numbers] = []
        elements = 0
        for name, beam in mechanism.beams.items():
            stiffness = beam.element_stiffness
            damping = tuple(beam.damping * one for one in stiffness)
            for section in beam.sections(name):
                nodes = [number[node] for node in section.nodes]
                spare = NODES - len(nodes)
                self.sections.append(
                    table_rows.SectionRow(elements + section.element, len(nodes), *nodes, *nodes[-1:] * spare)
                )
                shapes = (*section.shape, *[0.0] * spare, *section.slope, *[0.0] * spare)
                self.parameters.append((*shapes, section.length, *stiffness, *section.reference, *damping))
            elements += beam.elements


def characteristic_length(mechanism: Mechanism) -> float:
    """Return the largest distance [m] between two joint points, or a joint point and the centre of mass, of a body.

    Lengths of beams are compared with these distances. If all are 0, they are those between points of the elements that
    the run treats, such as the shapes of contacts, but at most 1 m; without any, the result is 1.
    """
    points: dict[str, list[tuple[float, float]]] = {name: [(0.0, 0.0)] for name in mechanism.bodies}
    for joint in mechanism.joints.values():
        for _, name, point in joint.attachments():
            if name in points and (len(points[name]) > FEW_POINTS or point not in points[name]):
                points[name].append(point)
    longest = largest([_longest_distance(points), *(beam.length for beam in mechanism.beams.values())])
    if longest == 0.0:
        for element in (one for key, _ in mechanism.treatments for one in mechanism.elements[key].values()):
            for name, point in element.extent_points():
                points[name].append(point)
        longest = smallest(_longest_distance(points), 1.0)
    return longest or 1.0


def _longest_distance(points: Mapping[str, Collection[tuple[float, float]]]) -> float:
    """Return the largest distance between two points of the same body [m]."""
    longest = 0.0
    for held in points.values():
        if len(held) <= FEW_POINTS:
            lengths = [elementary.hypot(x - a, y - b) for (x, y), (a, b) in combinations(held, 2)]
            longest = largest([longest, *lengths])
        else:
            x, y = np.array(sorted(held)).T
            rows = max(1, MOST_DISTANCES // len(x))
            for first in range(0, len(x), rows):
                some = slice(first, first + rows)
                distances = elementary.hypot(x[some, None] - x, y[some, None] - y)
                longest = max(longest, float(np.max(distances)))
    return longest


def _is_well_scaled(mechanism: Mechanism) -> bool:
    """Return whether the masses and inertias have ratios of at most `WELL_SCALED`.

    Masses are compared with inertias over squared lever arms of the joints. The inertias of bodies whose angles are
    coupled by a joint are compared with each other.
    """
    arms = dict.fromkeys(mechanism.bodies, 0.0)
    for joint in mechanism.joints.values():
        for _, name, (x, y) in joint.attachments():
            if name in arms:
                arms[name] = largest(arms[name], x * x + y * y)
        a = joint.bodies[0]
        if joint.point_moves_on_first and a in arms:  # the reaction on `a` acts at the joint point of `b`
            for _, name, point in joint.attachments()[-1:]:
                x, y = mechanism.to_local(a, mechanism.to_global(name, point))
                arms[a] = largest(arms[a], x * x + y * y)
    scales = [body.mass for body in mechanism.bodies.values()]
    scales += [body.inertia / arms[name] for name, body in mechanism.bodies.items() if body.inertia and arms[name] > 0]
    tied = {name for joint in mechanism.joints.values() if len(joint.angles()) == 2 for _, name in joint.angles()}
    inertias = [inertia for name in tied if name in arms and (inertia := mechanism.bodies[name].inertia)]
    return all(not sizes or largest(sizes) <= WELL_SCALED * smallest(sizes) for sizes in (scales, inertias))
