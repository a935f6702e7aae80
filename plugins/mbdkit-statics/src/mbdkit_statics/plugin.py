"""What this part adds to mbdkit: equilibria, their paths, modes, and kinematics."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.registry.feature_items import GuidePage, ViewItem
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import Command
from mbdkit.registry.target import Target


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return commands, and what notebooks show of equilibria and modes."""
    return [
        Command(
            name="equilibrium",
            summary="Find a static equilibrium, its stability and its forces.",
            order=50,
            target=Target("mbdkit_statics.commands:equilibrium"),
        ),
        Command(
            name="modes",
            summary="Find natural frequencies, damping ratios and mode shapes.",
            order=60,
            target=Target("mbdkit_statics.commands:modes"),
        ),
        Command(
            name="kinematics",
            summary="Compute the motion that drivers prescribe, without forces.",
            order=70,
            target=Target("mbdkit_statics.commands:kinematics"),
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
