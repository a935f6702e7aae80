"""Formulations of the equations of motion: the levels at which the integrated equations impose the constraints."""

from __future__ import annotations

from typing import Literal

from mbdkit.base.frozen import dataclass

Level = Literal["position", "velocity", "acceleration"]

FormulationName = Literal["index-1", "index-2", "index-3", "ggl", "joint-coordinates"]

#: Names of the ways to impose the constraints of cut joints in joint coordinates.
LoopsName = Literal["index-1", "index-2", "index-3", "ggl"]


@dataclass(frozen=True)
class Formulation:
    """One formulation.

    - `name`: its name in messages and in the claims of integrators; see `formulation_name`.
    - `holds`: levels at which the integrated equations impose the constraints, in joint coordinates those of the cut
      joints.
    - `coordinates`: coordinates that are integrated: those of all bodies, or those of the joints of a spanning tree
      (`mbdkit.engine.spanning_tree`). In the latter case the constraints of these joints hold exactly in every state.
    """

    name: str
    holds: tuple[Level, ...]
    coordinates: Literal["absolute", "joint"] = "absolute"

    @property
    def solves_multipliers(self) -> bool:
        """Whether the multipliers are unknowns of the stages. Otherwise they follow from the state, as the
        accelerations do.

        In the latter case the equations are ordinary differential equations. Every method can integrate them, and
        Baumgarte's terms can be added to their constraint rows.
        """
        return "acceleration" not in self.holds


def formulation_name(name: str, loops: str | None = None) -> str:
    """Return the name of a formulation whose cut joints, in joint coordinates, are imposed as in `loops`."""
    return name if loops in (None, "index-1") else f"{name} (loops: {loops})"


INDEX_1 = Formulation("index-1", ("acceleration",))

_HOLDS: dict[LoopsName, tuple[Level, ...]] = {
    "index-1": INDEX_1.holds,
    "index-2": ("velocity",),
    "index-3": ("position",),
    "ggl": ("position", "velocity"),
}

#: All formulations by name. The stage equations of each are those of `mbdkit.integrators.stages.collocation`.
FORMULATIONS: dict[str, Formulation] = {
    formulation.name: formulation
    for formulation in (
        *(Formulation(name, holds) for name, holds in _HOLDS.items()),
        *(Formulation(formulation_name("joint-coordinates", name), holds, "joint") for name, holds in _HOLDS.items()),
    )
}

#: Formulations whose equations are ordinary differential equations.
ORDINARY = tuple(name for name, formulation in FORMULATIONS.items() if not formulation.solves_multipliers)
