"""The section of predictions in the report of a run."""

from __future__ import annotations

from collections.abc import Iterator

from mbdkit.archive.run import Run
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_predict.run_results import lines, mesh, sensitivities
from mbdkit_report import Section, Table, columns_of
from mbdkit_report.seams import report_sections

_METHOD = (
    "The motion minimizes {minimize}. It was found by direct collocation with the stages of {method} with {points} "
    "points; constraints and their rates are zero at all collocation points. The nonlinear program was solved by "
    "IPOPT. The error of the objective is estimated from its changes on finer meshes, and the controls were integrated "
    "by another method. The optimum is a local one: other first guesses may lead to a smaller objective."
)


@report_sections
def section(run: Run, mechanism: Mechanism | None) -> Iterator[Section]:
    """Yield the section of a prediction; nothing for other runs."""
    if run.kind != "predicted":
        return
    spec, names = run.spec, {"radau": "Radau IIA methods", "gauss": "Gauss methods"}
    collocation = spec["collocation"]
    text = _METHOD.format(minimize=spec["minimize"], method=names[collocation["method"]], points=collocation["points"])
    meshes = tuple((" + ".join(map(str, n)) if isinstance(n, tuple) else n, value) for n, value in mesh(run))
    tables = [
        Table("optimum", "Optimum", columns_of("item; value"), tuple(lines(run)), headline=True),
        Table("meshes", "Meshes", columns_of("intervals; objective"), meshes),
    ]
    slopes = tuple(sensitivities(run).items())
    if slopes:
        note = "Change of the objective for a small change of the value, with the motion optimized again."
        tables.append(Table("sensitivities", "Sensitivities", columns_of("value; derivative"), slopes, note=note))
    yield Section("prediction", "Prediction", (text,), tables=tuple(tables))
