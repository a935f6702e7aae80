"""Formulations of the equations of motion: the levels at which the integrated equations impose the constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

FormulationName = Literal["index-1", "index-2", "index-3", "ggl", "joint-coordinates"]
"""Names of `FORMULATIONS`, as specs write them."""


@dataclass(frozen=True)
class Formulation:
    """One formulation.

    Parameters
    ----------
    name
        Its name in specs.
    holds
        Levels at which the integrated equations impose the constraints.
    coordinates
        Coordinates that are integrated: those of all bodies, or those of the joints of a spanning tree
        (`mbdkit.engine.spanning_tree`). In the latter case the constraints of these joints hold exactly in every state.
    """

    name: FormulationName
    holds: tuple[Literal["position", "velocity", "acceleration"], ...]
    coordinates: Literal["absolute", "joint"] = "absolute"

    @property
    def solves_multipliers(self) -> bool:
        """Whether the multipliers are unknowns of the stages. Otherwise they follow from the state, as the
        accelerations do.

        In the latter case the equations are ordinary differential equations. Every method can integrate them, and
        Baumgarte's terms can be added to their constraint rows.
        """
        return "acceleration" not in self.holds


INDEX_1 = Formulation("index-1", ("acceleration",))

FORMULATIONS: dict[str, Formulation] = {
    one.name: one
    for one in (
        INDEX_1,
        Formulation("index-2", ("velocity",)),
        Formulation("index-3", ("position",)),
        Formulation("ggl", ("position", "velocity")),
        Formulation("joint-coordinates", ("acceleration",), "joint"),
    )
}
"""All formulations by name. The stage equations of each are those of `mbdkit.stepping.collocation`."""

ORDINARY = tuple(name for name, one in FORMULATIONS.items() if not one.solves_multipliers)
"""Formulations whose equations are ordinary differential equations."""
