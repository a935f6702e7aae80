"""What this part adds to mbdkit: designs, which choose numbers of a spec."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.registry.feature_items import Example, FileFormat, GuidePage, SpecKind
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import Command
from mbdkit.registry.target import Target

_HERE = Path(__file__).parent


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the kind of design specs, commands, examples, and the kind of folders of designs."""
    return [
        SpecKind(
            name="design",
            summary="A design: numbers of a spec that make measures small.",
            order=300,
            phrase="a design spec",
            marker="mbdkit_design",
            command="mbdkit design",
            given_instead="this is a design spec, which `mbdkit design` solves",
            run_instead="this is the spec of a run; a design spec begins with `mbdkit_design: 1`",
            heading="Designs",
            load=Target("mbdkit_design.design_loading:load_design_spec"),
            validate=Target("mbdkit_design.commands:validate_design"),
            schema=Target("mbdkit_design.design_loading:design_schema"),
        ),
        Command(
            name="design",
            summary="Choose numbers of a spec so that measures become small.",
            order=90,
            target=Target("mbdkit_design.commands:design"),
        ),
        Command(
            name="watch",
            summary="Show the progress of a study or design of another process.",
            order=160,
            target=Target("mbdkit_design.commands:watch"),
        ),
        FileFormat(
            name="design",
            summary="The folder of a design.",
            order=200,
            file="design.yaml",
            report=Target("mbdkit_design.design_report:design_report"),
        ),
        *Example.folder(_HERE / "examples"),
        *GuidePage.folder(_HERE / "guide", "Analyse"),
    ]
