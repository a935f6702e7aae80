"""What this part adds to mbdkit: identifications, which find parameters of models from measured motion."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.plugin import Command, Example, FileFormat, GuidePage, Item, SpecKind, Target, ViewItem, hookimpl

_HERE = Path(__file__).parent


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the kind of specs, the command, the files with results, examples and the page of the guide."""
    return [
        SpecKind(
            name="identify",
            summary="An identification: parameters of a model from measured motion.",
            order=350,
            phrase="the spec of an identification",
            marker="mbdkit_identify",
            command="mbdkit identify",
            given_instead="this is the spec of an identification, which `mbdkit identify` solves",
            heading="Identifications",
            load=Target("mbdkit_identify.loading:load_identify_spec"),
            validate=Target("mbdkit_identify.commands:validate_identify"),
            schema=Target("mbdkit_identify.loading:identify_schema"),
        ),
        Command(
            name="identify",
            summary="Find parameters of a model from measured motion.",
            order=95,
            target=Target("mbdkit_identify.commands:identify"),
        ),
        FileFormat(
            name="identification",
            summary="The result of an identification.",
            order=400,
            format="mbdkit-identification",
            problems=Target("mbdkit_identify.archive:problems"),
            report=Target("mbdkit_identify.report:identification_report"),
        ),
        ViewItem(
            name="identification",
            summary="Estimates and signals of an identification.",
            of="mbdkit_identify.identification:Identification",
            make=Target("mbdkit_identify.report:identification_view"),
        ),
        *(item for item in Example.folder(_HERE / "examples") if "." not in item.name),  # without their bases
        *GuidePage.folder(_HERE / "guide", "Analyse"),
    ]
