"""What mbdkit itself adds through items of plugins: run specs, criteria, examples and pages of the guide."""

from __future__ import annotations

from pathlib import Path

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
    # fmt: off
    criteria = [
        CriterionItem(
            name="baumgarte", summary="Terms of Baumgarte that the step makes unstable.", order=0, stage="spec",
            find=Target("mbdkit.runs.run_criteria:unstable_baumgarte"),
        ),
        CriterionItem(
            name="model-notes", summary="What the model says about its mechanism.", order=10, stage="spec",
            find=Target("mbdkit.runs.run_criteria:model_notes"), of=frozenset({"mechanism", "run"}), level=None,
        ),
        CriterionItem(
            name="unresolved-beams", summary="Oscillations of beams that the step does not resolve.", order=20,
            stage="spec", find=Target("mbdkit.runs.run_criteria:unresolved_beams"), level=None,
        ),
        CriterionItem(
            name="unused-parameters", summary="Parameters that no expression uses.", order=30, stage="spec",
            find=Target("mbdkit.runs.run_criteria:unused_parameters"), of=frozenset({"mechanism", "run"}), level=None,
        ),
        CriterionItem(
            name="short-runs", summary="Tables that change long after the end of the run.", order=40, stage="spec",
            find=Target("mbdkit.runs.run_criteria:short_runs"), level=None,
        ),
        CriterionItem(
            name="zero-reactions", summary="Measures of reactions that are always zero.", order=50, stage="spec",
            find=Target("mbdkit.runs.run_criteria:zero_reactions_of_run"), level=None,
        ),
        CriterionItem(
            name="left-out", summary="Effects of a file that the mechanism lacks.", order=60, stage="spec",
            find=Target("mbdkit.runs.run_criteria:left_out"), of=frozenset({"mechanism", "run"}),
        ),
        CriterionItem(
            name="degrees", summary="Angles that are probably in degrees.", order=70, stage="spec",
            find=Target("mbdkit.runs.run_criteria:degrees"), of=frozenset({"mechanism", "run"}),
        ),
        CriterionItem(
            name="improbable-values",
            summary="Improbable inertias and coefficients of friction, often in another unit.", order=80, stage="spec",
            find=Target("mbdkit.runs.run_criteria:improbable_values"), of=frozenset({"mechanism", "run"}),
            criteria=("improbable-inertias", "improbable-frictions"),
        ),
        CriterionItem(
            name="improbable-sizes", summary="Improbable beams, lengths, preloads and masses.", order=90,
            stage="spec", find=Target("mbdkit.runs.run_criteria:improbable_sizes"), of=frozenset({"mechanism", "run"}),
            criteria=tuple(f"improbable-{what}" for what in ("beams", "lengths", "preloads", "bodies", "people")),
        ),
        CriterionItem(
            name="long-step", summary="A step that is longer than the run.", order=100, stage="spec",
            find=Target("mbdkit.runs.run_criteria:long_step"),
        ),
        CriterionItem(
            name="corners", summary="Tables that overshoot, and too many discontinuities.", order=110, stage="spec",
            find=Target("mbdkit.runs.corners:overshoots_and_corners"), criteria=("corners", "overshoots"),
        ),
        CriterionItem(
            name="method-evidence", summary="Methods of others that failed their checks, or have changed since.",
            order=115, stage="spec", find=Target("mbdkit.runs.run_criteria:method_evidence"),
        ),
        CriterionItem(
            name="moved-start", summary="Positions and angles that assembly changes by far.", order=120, stage="start",
            find=Target("mbdkit.runs.run_criteria:moved_start"),
        ),
        CriterionItem(
            name="changed-velocities", summary="Velocities that assembly changes.", order=130, stage="start",
            find=Target("mbdkit.runs.run_criteria:changed_velocities"),
        ),
        CriterionItem(
            name="table-ends", summary="Ends of the tables of moving centers.", order=140, stage="rows",
            find=Target("mbdkit.runs.row_criteria:watch_moving_centers"),
        ),
        CriterionItem(
            name="slow-friction", summary="Dry friction that slips so slowly that it is viscous.", order=150,
            stage="rows", find=Target("mbdkit.runs.row_criteria:watch_joint_friction"),
        ),
        CriterionItem(
            name="coincident-ends", summary="Forces whose ends meet.", order=160, stage="rows",
            find=Target("mbdkit.runs.row_criteria:watch_coincident_ends"),
        ),
        CriterionItem(
            name="coarse-beams", summary="Beams whose elements are too coarse.", order=170, stage="rows",
            find=Target("mbdkit.runs.coarse_beams:watch_coarse_beams"),
        ),
        CriterionItem(
            name="passive-laws", summary="Laws that are declared passive, but supply energy.", order=180, stage="end",
            find=Target("mbdkit.runs.run_criteria:passive_laws"),
        ),
    ]
    # fmt: on
    return [
        run,
        *criteria,
        *Example.folder(_HERE / "models" / "examples", _EXAMPLES),
        *GuidePage.folder(_HERE / "guide", _PAGES),
    ]
