"""What this part adds to mbdkit: the packaged studies, among them that of the source paper, and the
problems of others on which methods are compared.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.registry.feature_items import Example, GuidePage
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import ModelPlugin, StudyPlugin
from mbdkit.registry.target import Target

_HERE = Path(__file__).parent


@hookimpl
def mbdkit_models() -> list[ModelPlugin]:
    """Return the beam of hinged links, a test problem of integrators."""
    return [
        ModelPlugin(
            "hinged-beam",
            "A clamped elastic beam as a chain of rigid links with springs in its hinges, a stiff test problem.",
            options=Target("mbdkit_paper.hinged_beam:HingedBeamOptions"),
            build=Target("mbdkit_paper.hinged_beam:build"),
            references=Target("mbdkit_paper.hinged_beam:REFERENCES"),
        )
    ]


@hookimpl
def mbdkit_studies() -> list[StudyPlugin]:
    """Return the packaged studies."""
    from mbdkit_paper import STUDIES

    return list(STUDIES)


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the examples, which are problems of others with published results, and the page on the source paper."""
    return [*Example.folder(_HERE / "examples"), *GuidePage.folder(_HERE / "guide")]
