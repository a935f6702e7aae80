"""What this part adds to mbdkit: sliders in the browser."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.registry.feature_items import GuidePage
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import Command
from mbdkit.registry.target import Target


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the command and its page of the guide."""
    return [
        Command(
            name="explore",
            summary="Change numbers of a spec with sliders in the browser.",
            order=150,
            target=Target("mbdkit_explore.commands:explore"),
        ),
        *GuidePage.folder(Path(__file__).parent / "guide", "Start"),
    ]
