"""What mbdkit itself adds through items of plugins: run specs, criteria, examples and pages of the guide."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from mbdkit.registry.feature_items import CriterionItem, Example, Feature, GuidePage, SpecKind
from mbdkit.registry.target import Target

_HERE = Path(__file__).parent

_EXAMPLES = {
    "Pendulums and springs": "pendulum double-pendulum spring-pendulum chain",
    "Linkages": "four-bar slider-crank quick-return crank-press watt-six-bar n-four-bar",
    "Flexible beams": "flexible-slider-crank leaf-spring spin-up-beam flying-spaghetti roll-up",
    "Vehicles": "double-wishbone car-axis",
    "Control": "pd-leg delayed-balance series-elastic-knee",
    "People and their devices": "gravity-balanced-arm limit-stop",
}

_PAGES = {
    "Start": "first-steps mini spec glossary",
    "Model": "mechanism beams events control",
    "Analyse": "methods measures environments coupling",
    "Trust and extend": "trust reliability promises performance files plugins joints elements kernels changes",
}


def _criterion(
    name: str, order: int, stage: Literal["spec", "start", "rows", "end"], find: str, summary: str, **more: Any
) -> CriterionItem:
    """Return a criterion that a function of `mbdkit.runs` applies."""
    return CriterionItem(
        name=name, summary=summary, order=order, stage=stage, find=Target(f"mbdkit.runs.{find}"), **more
    )


_OF_MECHANISMS = frozenset({"mechanism", "run"})

# fmt: off
#: Criteria: name, order, stage, function and summary.
_CRITERIA = (
    _criterion("baumgarte", 0, "spec", "run_criteria:unstable_baumgarte",
        "Terms of Baumgarte that the step makes unstable."),
    _criterion("model-notes", 10, "spec", "run_criteria:model_notes",
        "What the model says about its mechanism.", of=_OF_MECHANISMS, level=None),
    _criterion("unresolved-beams", 20, "spec", "run_criteria:unresolved_beams",
        "Oscillations of beams that the step does not resolve.", level=None),
    _criterion("unused-parameters", 30, "spec", "run_criteria:unused_parameters",
        "Parameters that no expression uses.", of=_OF_MECHANISMS, level=None),
    _criterion("short-runs", 40, "spec", "run_criteria:short_runs",
        "Tables that change long after the end of the run.", level=None),
    _criterion("zero-reactions", 50, "spec", "run_criteria:zero_reactions_of_run",
        "Measures of reactions that are always zero.", level=None),
    _criterion("left-out", 60, "spec", "run_criteria:left_out",
        "Effects of a file that the mechanism lacks.", of=_OF_MECHANISMS),
    _criterion("degrees", 70, "spec", "run_criteria:degrees",
        "Angles that are probably in degrees.", of=_OF_MECHANISMS),
    _criterion("improbable-values", 80, "spec", "run_criteria:improbable_values",
        "Improbable inertias and coefficients of friction, often in another unit.", of=_OF_MECHANISMS,
        criteria=("improbable-inertias", "improbable-frictions")),
    _criterion("improbable-sizes", 90, "spec", "run_criteria:improbable_sizes",
        "Improbable beams, lengths, preloads and masses.", of=_OF_MECHANISMS,
        criteria=tuple(f"improbable-{what}" for what in ("beams", "lengths", "preloads", "bodies", "people"))),
    _criterion("long-step", 100, "spec", "run_criteria:long_step",
        "A step that is longer than the run."),
    _criterion("corners", 110, "spec", "corners:overshoots_and_corners",
        "Tables that overshoot, and too many discontinuities.", criteria=("corners", "overshoots")),
    _criterion("method-evidence", 115, "spec", "run_criteria:method_evidence",
        "Methods of others that failed their checks, or have changed since."),
    _criterion("moved-start", 120, "start", "run_criteria:moved_start",
        "Positions and angles that assembly changes by far."),
    _criterion("changed-velocities", 130, "start", "run_criteria:changed_velocities",
        "Velocities that assembly changes."),
    _criterion("table-ends", 140, "rows", "row_criteria:watch_moving_centers",
        "Ends of the tables of moving centers."),
    _criterion("slow-friction", 150, "rows", "row_criteria:watch_joint_friction",
        "Dry friction that slips so slowly that it is viscous."),
    _criterion("coincident-ends", 160, "rows", "row_criteria:watch_coincident_ends",
        "Forces whose ends meet."),
    _criterion("coarse-beams", 170, "rows", "coarse_beams:watch_coarse_beams",
        "Beams whose elements are too coarse."),
    _criterion("passive-laws", 180, "end", "run_criteria:passive_laws",
        "Laws that are declared passive, but supply energy."),
)
# fmt: on


def builtin_features() -> list[Feature]:
    """Return the items of mbdkit itself, apart from models, methods, laws and commands."""
    run = SpecKind(
        name="run",
        summary="A run: a motion from an initial state.",
        order=900,
        phrase="a run spec",
        command="mbdkit run",
        heading="Runs",
        load=Target("mbdkit.spec.loading:load_spec"),
        validate=Target("mbdkit.cli.runs:validate_run"),
        run_kind="forward",
        model=Target("mbdkit.spec.run_spec:RunSpec"),
        differentiate=Target("mbdkit.base.higher_layers:gradient_of_run"),
    )
    return [
        run,
        *_CRITERIA,
        *Example.folder(_HERE / "models" / "examples", _EXAMPLES),
        *GuidePage.folder(_HERE / "guide", _PAGES),
    ]
