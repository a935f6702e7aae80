"""What this part adds to mbdkit: equilibria, their paths, modes, and kinematics."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.registry.feature_items import GuidePage, ViewItem
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import Command
from mbdkit.registry.target import Target

#: Commands: name, order and summary.
_COMMANDS = (
    ("equilibrium", 50, "Find a static equilibrium, its stability and its forces."),
    ("modes", 60, "Find natural frequencies, damping ratios and mode shapes."),
    ("kinematics", 70, "Compute the motion that drivers prescribe, without forces."),
)


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return commands, and what notebooks show of equilibria and modes."""
    return [
        *(
            Command(name=name, summary=summary, order=order, target=Target(f"mbdkit_statics.commands:{name}"))
            for name, order, summary in _COMMANDS
        ),
        ViewItem(
            name="equilibrium",
            summary="Position, reactions and stability of an equilibrium.",
            of="mbdkit_statics.equilibrium:Equilibrium",
            make=Target("mbdkit_statics.views:equilibrium_view"),
        ),
        ViewItem(
            name="modes",
            summary="Frequencies and shapes of modes.",
            of="mbdkit_statics.modes:Modes",
            make=Target("mbdkit_statics.views:modes_view"),
        ),
        *GuidePage.folder(Path(__file__).parent / "guide", "Analyse"),
    ]
