"""What this part adds to mbdkit: inverse dynamics of measured motion, workload, and models of legs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.plugin import (
    Accessor,
    Command,
    CriterionItem,
    Example,
    GuidePage,
    Item,
    ModelPlugin,
    ReportSection,
    SpecKind,
    SummaryLine,
    Target,
    ViewItem,
    hookimpl,
)

_HERE = Path(__file__).parent
_ROOM = "mbdkit_biomech.inverse_dynamics"
_MODELS = "mbdkit_biomech.models.leg"
_CRITERIA = {
    "columns": "Columns of the motion and their smoothing.",
    "loads": "Measured loads.",
    "model": "The model, forces without a point, turns and signs of angles.",
    "record": "The record, units of loads, and errors.",
    "person": "The person: plane of motion, joint centres, lengths and plates.",
}


@hookimpl
def mbdkit_models() -> list[ModelPlugin]:
    """Return models of legs."""
    return [
        ModelPlugin(
            "leg",
            "One or two legs of thigh, shank and foot, scaled by body mass and height, on a fixed hip or on a free "
            "trunk.",
            Target(f"{_MODELS}:LegOptions", type),
            Target(f"{_MODELS}:build"),
            Target(f"{_MODELS}:REFERENCES"),
            order=60,
        ),
        ModelPlugin(
            "leg-four-bar",
            "The same leg with a knee that is a crossed four-bar linkage.",
            Target(f"{_MODELS}:LegFourBarOptions", type),
            Target(f"{_MODELS}:build_four_bar"),
            Target(f"{_MODELS}:FOUR_BAR_REFERENCES"),
            order=70,
        ),
    ]


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the kind of specs of inverse dynamics, commands, examples, and what summaries and reports say of it."""
    return [
        SpecKind(
            name="inverse",
            summary="Inverse dynamics: forces from a measured motion.",
            order=200,
            phrase="a spec of inverse dynamics",
            marker="motion",
            command="mbdkit inverse",
            given_instead="this is a spec of inverse dynamics, with a measured motion: compute it with "
            "`mbdkit inverse`",
            run_instead="this is a run spec: run it with `mbdkit run`; a spec of inverse dynamics has a section "
            "`motion`, and neither `integrator` nor a step",
            heading="INVERSE DYNAMICS",
            load=Target(f"{_ROOM}.inverse_loading:load_inverse_spec"),
            validate=Target("mbdkit_biomech.commands:validate_inverse"),
            schema=Target(f"{_ROOM}.inverse_schema:inverse_schema"),
            run_kind="inverse",
            model=Target(f"{_ROOM}.inverse_spec:InverseSpec"),
            repeat=Target("mbdkit_biomech.commands:repeated_inverse"),
        ),
        Command(
            name="inverse",
            summary="Compute joint and actuator forces from a measured motion.",
            order=30,
            target=Target("mbdkit_biomech.commands:inverse"),
        ),
        Command(
            name="workload",
            summary="Print the workload of joints: peaks, impulses and work.",
            order=40,
            target=Target("mbdkit_biomech.commands:workload"),
        ),
        Accessor(
            name="moment_arms",
            summary="Moment arms of a muscle.",
            of="Run",
            target=Target(f"{_ROOM}.moment_arms:arms_of"),
        ),
        SummaryLine(
            name="inverse",
            summary="Fit, gaps, actuators, residuals and reserves.",
            text=Target(f"{_ROOM}.inverse_summary:inverse_lines"),
            of=frozenset({"inverse"}),
        ),
        ReportSection(
            name="loads",
            summary="Loads over the motion, workload, and disagreement of model and data.",
            order=100,
            make=Target(f"{_ROOM}.load_sections:inverse_sections"),
            charts=Target(f"{_ROOM}.load_sections:inverse_charts"),
            film=Target(f"{_ROOM}.load_frames:film_with_arrows"),
        ),
        ViewItem(
            name="workload",
            summary="Peaks and impulses of the loads.",
            of=f"{_ROOM}.workload:Workload",
            make=Target(f"{_ROOM}.views:workload_view"),
        ),
        *(
            CriterionItem(
                name=part,
                summary=summary,
                order=10 * number,
                stage="data",
                find=Target(f"{_ROOM}.data_verdict:doubts_of_{part}"),
                of=frozenset({"inverse"}),
            )
            for number, (part, summary) in enumerate(_CRITERIA.items())
        ),
        *Example.folder(_HERE / "examples"),
        *GuidePage.folder(_HERE / "guide"),
    ]
