"""What this part adds to mbdkit: the packaged studies, among them that of the source paper, and the
problems of others on which methods are compared.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.registry.feature_items import Example, GuidePage
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import ModelPlugin
from mbdkit.registry.target import Target
from mbdkit_paper import STUDIES

_HERE = Path(__file__).parent


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return a test problem of integrators, the packaged studies, the examples, which are problems of others with
    published results, and the page on the source paper.
    """
    return [
        ModelPlugin(
            "hinged-beam",
            "A clamped elastic beam as a chain of rigid links with springs in its hinges, a stiff test problem.",
            options=Target("mbdkit_paper.hinged_beam:HingedBeamOptions"),
            build=Target("mbdkit_paper.hinged_beam:build"),
            references=Target("mbdkit_paper.hinged_beam:REFERENCES"),
        ),
        *STUDIES,
        *Example.folder(_HERE / "examples", "Problems with published results"),
        *GuidePage.folder(_HERE / "guide", "Trust and extend"),
    ]
