"""What this part adds to mbdkit: the packaged studies, among them that of the source paper."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.plugin import GuidePage, Item, StudyPlugin, hookimpl


@hookimpl
def mbdkit_studies() -> list[StudyPlugin]:
    """Return the packaged studies."""
    from mbdkit_paper import STUDIES

    return list(STUDIES)


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the page of the guide on the source paper."""
    return GuidePage.folder(Path(__file__).parent / "guide")
