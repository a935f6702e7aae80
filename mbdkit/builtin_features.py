"""What mbdkit itself adds through items of plugins: run specs, formats of tables, examples and pages of the guide."""

from __future__ import annotations

from pathlib import Path

from mbdkit.registry.feature_items import CriterionItem, Example, Feature, GuidePage, SpecKind, TableFormat
from mbdkit.registry.target import Target

_HERE = Path(__file__).parent
_FORMATS = {
    "csv": "Comma-separated values.",
    "parquet": "Parquet.",
    "mat": "MATLAB.",
    "sto": "Storage files of OpenSim.",
    "json": "JSON.",
}


_WATCHERS = (
    ("centers", "Ends of the tables of moving centers.", "moving_centers:MovingCenters"),
    ("friction", "Dry friction that slips so slowly that it is viscous.", "slow_friction:SlowFriction"),
    ("ends", "Forces whose ends meet.", "coincident_ends:CoincidentEnds"),
    ("beams", "Beams whose elements are too coarse.", "coarse_beams:CoarseBeams"),
    ("overlaps", "Circles in contact that overlap deeply.", "deep_overlaps:DeepOverlaps"),
)


def builtin_features() -> list[Feature]:
    """Return the items of mbdkit itself, apart from models, methods, laws and commands."""
    run = SpecKind(
        name="run",
        summary="A run: a motion from an initial state.",
        order=900,
        phrase="a run spec",
        command="mbdkit run",
        heading="RUN",
        load=Target("mbdkit.spec.loading:load_spec"),
        validate=Target("mbdkit.cli.runs:validate_run"),
        run_kind="forward",
        model=Target("mbdkit.spec.run_spec:RunSpec"),
    )
    formats = [
        TableFormat(
            name=name,
            summary=summary,
            order=10 * number,
            suffix=f".{name}",
            write=Target(f"mbdkit.archive.table_formats:write_{name}"),
        )
        for number, (name, summary) in enumerate(_FORMATS.items())
    ]
    watchers = [
        CriterionItem(
            name=name,
            summary=summary,
            order=10 * number,
            stage="rows",
            find=Target(f"mbdkit.runs.{where}.of"),
            of=frozenset({"run"}),
        )
        for number, (name, summary, where) in enumerate(_WATCHERS)
    ]
    return [
        run,
        *formats,
        *watchers,
        *Example.folder(_HERE / "models" / "examples"),
        *GuidePage.folder(_HERE / "guide"),
    ]
