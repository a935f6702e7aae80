"""Names of the elements of a mechanism along the axes of an archive."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

from mbdkit.base.frozen import dataclass, replace

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism

Nested: TypeAlias = "str | Sequence[Nested]"  #: A text, or sequences of texts, nested to any depth.

COORDINATES = ("x", "y", "theta")
AXES = ("x", "y")


@dataclass(frozen=True)
class ArchiveNames:
    """Names along the axes of an archive.

    - `bodies`, `joints`: names, in the order of the engine.
    - `constraints`: ``joint.row`` for every constraint row, such as ``J1.x``.
    - `constraint_units`: unit of the constraint function of every constraint row, ``m`` or ``rad``.
    - `joint_bodies`: first and second body of every joint.
    - `joint_units`: unit of the coordinate of every joint, ``rad`` or ``m``; by default, ``rad``.
    - `forces`, `force_bodies`: names of the force elements, and first and second body of each.
    - `force_units`: unit of the length of every force element, ``m`` or ``rad``.
    - `markers`, `marker_bodies`: names of the markers, and the body of each.
    - `elements`, `element_beams`: names of the elements of beams, and the beam of each.
    - `states`, `state_units`: names of the first-order states without those of inputs, and the unit of each.
    - `inputs`, `input_units`: names of the inputs, and the unit of each.
    - `members`: names of the elements of each further kind, each with its bodies or other texts; see
      `CompiledMechanism.members`.
    """

    bodies: Sequence[str]
    joints: Sequence[str]
    constraints: Sequence[str]
    constraint_units: Sequence[str]
    joint_bodies: Sequence[tuple[str, str]]
    joint_units: Sequence[str] = ()
    forces: Sequence[str] = ()
    force_bodies: Sequence[tuple[str, str]] = ()
    force_units: Sequence[str] = ()
    markers: Sequence[str] = ()
    marker_bodies: Sequence[str] = ()
    elements: Sequence[str] = ()
    element_beams: Sequence[str] = ()
    states: Sequence[str] = ()
    state_units: Sequence[str] = ()
    inputs: Sequence[str] = ()
    input_units: Sequence[str] = ()
    members: Sequence[tuple[str, Sequence[tuple[str, Sequence[str]]]]] = ()

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            object.__setattr__(self, name, _tuples(value))

    def names_of(self, kind: str) -> list[str]:
        """Return the names of the `members` of a kind."""
        return [name for name, _ in dict(self.members).get(kind, ())]

    def bodies_of(self, kind: str, place: int) -> list[str]:
        """Return the first (`place` 0), second (1) or a further body or text of each of the `members` of a kind."""
        return [bodies[place] for _, bodies in dict(self.members).get(kind, ())]

    def with_members(self, **members: Sequence[tuple[str, Sequence[str]]]) -> ArchiveNames:
        """Return names with those of the elements of further kinds, see `members`; empty ones are left out."""
        more = {kind: each for kind, each in members.items() if each}
        return replace(self, members=tuple((dict(self.members) | more).items())) if more else self


def _tuples(value: Nested) -> Nested:
    """Return nested sequences as tuples, which can be compared and hashed."""
    return value if isinstance(value, str) else tuple(map(_tuples, value))


@lru_cache(maxsize=16)
def archive_names(mechanism: CompiledMechanism) -> ArchiveNames:
    """Return the names of the elements of a mechanism."""
    return ArchiveNames(
        bodies=tuple(mechanism.bodies),
        joints=tuple(mechanism.joints),
        constraints=tuple(row.label for row in mechanism.rows),
        constraint_units=tuple(row.unit for row in mechanism.rows),
        joint_bodies=tuple(mechanism.joint_bodies),
        joint_units=tuple(mechanism.joint_units),
        forces=tuple(force.name for force in mechanism.forces),
        force_bodies=tuple(force.bodies for force in mechanism.forces),
        force_units=tuple(force.unit for force in mechanism.forces),
        markers=tuple(name for name, _ in mechanism.markers),
        marker_bodies=tuple(body for _, body in mechanism.markers),
        elements=tuple(f"{beam}[{i}]" for beam, count in mechanism.beams for i in range(count)),
        element_beams=tuple(beam for beam, count in mechanism.beams for _ in range(count)),
        states=tuple(state.name for state in mechanism.named_states),
        state_units=tuple(state.unit for state in mechanism.named_states),
        inputs=tuple(item.name for item in mechanism.inputs),
        input_units=tuple(item.unit for item in mechanism.inputs),
        members=tuple(mechanism.members.items()),
    )
