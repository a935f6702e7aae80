"""What mbdkit itself adds through items of plugins: run specs, criteria, examples and pages of the guide."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from mbdkit.registry.feature_items import (
    CriterionItem,
    Example,
    Feature,
    GuidePage,
    SpecKind,
)
from mbdkit.registry.target import Target

_HERE = Path(__file__).parent

_NOTES = (
    ("model-notes", "What the model says about its mechanism.", "run_criteria:model_notes"),
    ("unresolved-beams", "Oscillations of beams that the step does not resolve.", "run_criteria:unresolved_beams"),
    ("unused-parameters", "Parameters that no expression uses.", "run_criteria:unused_parameters"),
    ("short-runs", "Tables that change long after the end of the run.", "notes:short_runs"),
    ("zero-reactions", "Measures of reactions that are always zero.", "notes:zero_reactions_of_run"),
)
_CRITERIA: tuple[tuple[Literal["spec", "start", "rows", "end"], str, str, str], ...] = (
    ("spec", "baumgarte", "Terms of Baumgarte that the step makes unstable.", "run_criteria:unstable_baumgarte"),
    *(("spec", *note) for note in _NOTES),
    ("spec", "left-out", "Effects of a file that the mechanism lacks.", "run_criteria:left_out"),
    ("spec", "degrees", "Angles that are probably in degrees.", "run_criteria:degrees"),
    (
        "spec",
        "improbable-values",
        "Improbable inertias and coefficients of friction, often in another unit.",
        "run_criteria:improbable_values",
    ),
    (
        "spec",
        "improbable-sizes",
        "Improbable beams, lengths and masses, often in another unit.",
        "run_criteria:improbable_sizes",
    ),
    ("spec", "long-step", "A step that is longer than the run.", "run_criteria:long_step"),
    ("spec", "corners", "Tables that overshoot, and too many discontinuities.", "corners:overshoots_and_corners"),
    ("start", "moved-start", "Positions that assembly changes by far.", "run_criteria:moved_start"),
    ("start", "changed-velocities", "Velocities that assembly changes.", "run_criteria:changed_velocities"),
    ("rows", "table-ends", "Ends of the tables of moving centers.", "moving_centers:MovingCenters.of"),
    ("rows", "slow-friction", "Dry friction that slips so slowly that it is viscous.", "slow_friction:of_joints"),
    ("rows", "coincident-ends", "Forces whose ends meet.", "coincident_ends:CoincidentEnds.of"),
    ("rows", "coarse-beams", "Beams whose elements are too coarse.", "coarse_beams:CoarseBeams.of"),
    ("end", "passive-laws", "Laws that are declared passive, but supply energy.", "run_criteria:passive_laws"),
)
_SEVERAL = {
    "improbable-values": ("improbable-inertias", "improbable-frictions"),
    "improbable-sizes": tuple(f"improbable-{what}" for what in ("beams", "lengths", "bodies", "people")),
    "corners": ("corners", "overshoots"),
}
"""Criteria that one item examines, where they are several."""
_WITHOUT_RUN = ("model-notes", "unused-parameters", "left-out", "degrees", "improbable-values", "improbable-sizes")
"""Criteria that also apply to a mechanism without a run."""


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
        differentiate=Target("mbdkit.base.higher_layers:gradient_of_run"),
    )
    notes = {name for name, *_ in _NOTES}
    criteria = [
        CriterionItem(
            name=name,
            summary=summary,
            order=10 * number,
            stage=stage,
            find=Target(f"mbdkit.runs.{where}"),
            of=frozenset({"run", "mechanism"} if name in _WITHOUT_RUN else {"run"}),
            criteria=() if name in notes else _SEVERAL.get(name, (name,)),
            level=None if name in notes else "doubtful",
        )
        for number, (stage, name, summary, where) in enumerate(_CRITERIA)
    ]
    return [
        run,
        *criteria,
        *Example.folder(_HERE / "models" / "examples"),
        *GuidePage.folder(_HERE / "guide"),
    ]
