"""What this part adds to mbdkit: studies, which are families of runs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.registry.feature_items import FileFormat, GuidePage, SpecKind, ViewItem
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import Command
from mbdkit.registry.target import Target


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the kind of study specs, commands, and the kinds of files and folders of studies."""
    return [
        SpecKind(
            name="study",
            summary="A study: many variants of one spec.",
            order=100,
            phrase="a study spec",
            marker="mbdkit_study",
            signs=("axes", "families", "sample"),
            absent=("mbdkit",),
            command="mbdkit study",
            given_instead="this is a study spec, which `mbdkit study` runs; a run spec begins with `mbdkit: 1`",
            load=Target("mbdkit_studies.spec.study_loading:load_study_spec"),
            validate=Target("mbdkit_studies.commands:validate_study"),
            is_packaged=Target("mbdkit_studies.spec.study_loading:is_study_name"),
            schema=Target("mbdkit_studies.spec.study_loading:study_schema"),
        ),
        Command(
            name="study",
            summary="Run a study: many variants of one spec.",
            order=80,
            target=Target("mbdkit_studies.commands:study_app"),
        ),
        FileFormat(
            name="study",
            summary="The folder of a study.",
            order=100,
            file="study.yaml",
            export=Target("mbdkit_studies.report.runs_table:export_study"),
            report=Target("mbdkit_studies.report.study_report:study_page"),
            saves_figures=True,
        ),
        FileFormat(
            name="block",
            summary="A file with many runs of a study.",
            order=300,
            suffix=".h5",
            problems=Target("mbdkit_studies.store.blocks:block_problems"),
        ),
        ViewItem(
            name="study",
            summary="Settings, answers and runs of a study.",
            of="mbdkit_studies.study:Study",
            make=Target("mbdkit_studies.report.study_report:study_view"),
        ),
        *GuidePage.folder(Path(__file__).parent / "guide", "Analyse"),
    ]
