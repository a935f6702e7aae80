"""What this part adds to mbdkit: what notebooks show of gradients, and a page of the guide."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.registry.feature_items import GuidePage, ViewItem
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.target import Target


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return what notebooks show of gradients, and the page of the guide."""
    return [
        ViewItem(
            name="gradient",
            summary="Measures of a run and their derivatives.",
            of="mbdkit_gradients.measure_gradients:Gradient",
            make=Target("mbdkit_gradients.measure_gradients:gradient_view"),
        ),
        *GuidePage.folder(Path(__file__).parent / "guide", "Analyse"),
    ]
