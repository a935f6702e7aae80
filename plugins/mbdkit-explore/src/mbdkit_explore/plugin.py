"""What this part adds to mbdkit: sliders in the browser."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.plugin import Command, GuidePage, Item, Target, hookimpl


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
        *GuidePage.folder(Path(__file__).parent / "guide"),
    ]
