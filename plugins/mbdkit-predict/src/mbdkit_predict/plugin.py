"""What this part adds to mbdkit: the export of mechanisms to CasADi."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.plugin import Accessor, GuidePage, Item, Target, hookimpl


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the export, and its page of the guide."""
    return [
        Accessor(
            name="to_casadi",
            summary="Equations of motion and quantities as functions of CasADi.",
            of="Mechanism",
            target=Target("mbdkit_predict.export:exported"),
        ),
        *GuidePage.folder(Path(__file__).parent / "guide"),
    ]
