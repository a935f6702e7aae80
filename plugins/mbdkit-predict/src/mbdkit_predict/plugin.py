"""What this part adds to mbdkit: the export of mechanisms to CasADi, and predictions by optimal control."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.registry.feature_items import Accessor, Example, GuidePage, ReportSection, SpecKind, SummaryLine
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import Command
from mbdkit.registry.target import Target

_HERE = Path(__file__).parent
#: Attributes of runs, which are functions of `run_results` with the same names: name and summary.
_OF_RUNS = {
    "objective": "Smallest value of what is minimized.",
    "objective_error": "Estimated error of the objective.",
    "mesh": "Intervals and objective of each mesh.",
    "parameters": "Optimized numbers.",
    "controls": "Histories of the controls.",
    "sensitivities": "Derivatives of the optimum from the multipliers.",
    "starts": "Objectives on the first mesh from several first guesses.",
    "forward_run": "Differences of a run with the controls from the motion.",
    "costates": "Derivatives of the objective by the states, as functions of time.",
    "pontryagin": "Violation of Pontryagin's minimum principle.",
    "gain": "Difference of the optimum from that of another motion.",
}


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return the export, the kind of specs of predictions, their command, results, examples and pages of the guide."""
    return [
        SpecKind(
            name="predict",
            summary="Prediction: a motion by optimal control.",
            order=150,
            phrase="a spec of a prediction",
            marker="mbdkit_predict",
            command="mbdkit predict",
            heading="Predictions",
            load=Target("mbdkit_predict.predict_loading:load_predict_spec"),
            validate=Target("mbdkit_predict.commands:validate_predict"),
            run_kind="predicted",
            model=Target("mbdkit_predict.predict_spec:PredictSpec"),
            compute=Target("mbdkit_predict.prediction:compute"),
            is_integrated=False,
            schema=Target("mbdkit_predict.predict_loading:predict_schema"),
            repeat=Target("mbdkit_predict.prediction:repeated"),
        ),
        Command(
            name="predict",
            summary="Find the motion and the controls that minimize an objective.",
            order=45,
            target=Target("mbdkit_predict.commands:predict"),
        ),
        *(
            Accessor(name=name, summary=summary, of="Run", target=Target(f"mbdkit_predict.run_results:{name}"))
            for name, summary in _OF_RUNS.items()
        ),
        Accessor(
            name="to_casadi",
            summary="Equations of motion and quantities as functions of CasADi.",
            of="Mechanism",
            target=Target("mbdkit_predict.prediction:exported"),
        ),
        SummaryLine(
            name="predict",
            summary="Objective, its error, and optimized numbers.",
            text=Target("mbdkit_predict.run_results:lines"),
            of=frozenset({"predict"}),
        ),
        ReportSection(
            name="prediction",
            summary="Optimum, meshes and sensitivities of a prediction.",
            make=Target("mbdkit_predict.run_results:section"),
        ),
        *Example.folder(_HERE / "examples"),
        *GuidePage.folder(_HERE / "guide", "Analyse"),
    ]
