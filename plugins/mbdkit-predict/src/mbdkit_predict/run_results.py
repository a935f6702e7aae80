"""What predictions add to runs and their reports: objective, error, meshes, controls, sensitivities."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from mbdkit.archive.result_seams import run_attribute, summary_lines
from mbdkit.archive.run import Run
from mbdkit.base.errors import RunError
from mbdkit.base.plain_data import parse_path
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_predict.predict_spec import SAME
from mbdkit_report import Section, Table, columns_of
from mbdkit_report.seams import report_sections


class PredictedGain(NamedTuple):
    """Difference of two optima."""

    value: float  #: Objective of the other motion, minus that of this one.
    error: float  #: Sum of the errors of both objectives.
    share: float  #: The value as a share of the magnitude of the objective of the other motion.


def _recorded(run: Run, name: str) -> Any:
    if name not in run.provenance:
        raise RunError(f"the run has no {name}: it is no prediction")
    value = run.provenance[name]
    return json.loads(value) if isinstance(value, str) else value


def objective(run: Run) -> float:
    """Return the smallest value of what is minimized, on the last mesh."""
    return float(_recorded(run, "objective"))


def objective_error(run: Run) -> float:
    """Return the estimated error of the objective; nan if no optimum was found."""
    return float(_recorded(run, "objective_error"))


def mesh(run: Run) -> list[tuple[int | tuple[int, ...], float]]:
    """Return the number of intervals, of each phase if there are several, and the objective of each mesh with an
    optimum.
    """
    rows = [(_count(row), row["objective"]) for row in _recorded(run, "mesh")]
    return [(count, float(value)) for count, value in rows if value is not None] or [(rows[-1][0], objective(run))]


def _count(row: dict[str, Any]) -> int | tuple[int, ...]:
    count = row["intervals"]
    return tuple(count) if isinstance(count, list) else int(count)


def parameters(run: Run) -> dict[str, float]:
    """Return the optimized numbers by their key path."""
    return {name: float(value) for name, value in _recorded(run, "optimized").items()}


def controls(run: Run) -> dict[str, object]:
    """Return the controls by their key path; `value` (T,) of each is its history."""
    _recorded(run, "objective")
    paths = {name: parse_path(name) for name in run.spec["controls"]}
    states = {name: path[1] for name, path in paths.items() if path[0] == "states" and len(path) == 2}
    return {name: run.states[states.get(name, name)] for name in paths}


def sensitivities(run: Run) -> dict[str, float]:
    """Return derivatives of the optimum from the multipliers: by the key paths in `sensitivities`, by fixed durations,
    and by the values of conditions at the start and the end, such as ``final: block.x``.
    """
    return dict(_recorded(run, "sensitivities"))


def starts(run: Run) -> list[float]:
    """Return the objective on the first mesh from each first guess; nan where no optimum was found."""
    return [math.nan if value is None else float(value) for value in _recorded(run, "starts")]


def forward_run(run: Run) -> dict[str, float]:
    """Return how a run with the controls, by another method, differs from the motion, as a share of its range.

    ``end`` and ``largest`` are the differences at the end and at most; ``of_intervals`` is the sum of those of all
    intervals, each of which starts on the motion. They are nan if there is no optimum, or the run stopped.
    """
    return dict(_recorded(run, "forward_run"))


def costates(run: Run) -> dict[str, np.ndarray]:
    """Return the costates (T,) by name of the state: derivatives of the objective by the state at each time.

    Names are those of the coordinates that joints leave free, such as ``block.x``, of their velocities, ``block.vx``,
    and of first-order states. With the integrand L, ``costates' = -dH/dx`` for ``H = L + costates . x'``, which the
    controls of an optimum minimize. Empty if there is no optimum.
    """
    return {name: np.array(values) for name, values in _recorded(run, "costates").items()}


def pontryagin(run: Run) -> dict[str, float]:
    """Return how far the motion is from Pontryagin's minimum principle; empty if that is not known.

    ``violation`` is the integral over time of the Hamiltonian less its minimum over the admissible controls, the
    first-order change of the objective; ``time`` is when it is largest [s]; ``starts`` is the number of starts of the
    search for the minimum at each time, 0 if it is exact.
    """
    return dict(_recorded(run, "pontryagin") or {})


def gain(run: Run) -> Callable[..., PredictedGain]:
    """Return the function of another prediction that returns the gain of this one; see `PredictedGain`.

    Without an argument, the other one is that of `compare` in the spec.
    """

    def of(other: Run | None = None) -> PredictedGain:
        if other is not None:
            there, its_error = objective(other), objective_error(other)
        else:
            there, its_error = (float(_recorded(run, f"compared_{name}")) for name in ("objective", "error"))
        value = there - objective(run)
        return PredictedGain(value, its_error + objective_error(run), value / abs(there) if there else math.nan)

    return of


@summary_lines
def lines(run: Run) -> list[tuple[str, str]]:
    """Return the lines of the summary."""
    counts = " + ".join(map(str, np.atleast_1d(mesh(run)[-1][0])))
    value, error, ended, slopes = objective(run), objective_error(run), starts(run), sensitivities(run)
    of_optimum = f"{value:.10g} +- {'unknown' if math.isnan(error) else f'{error:.2g}'} on {counts} intervals"
    of_iterate = f"{value:.10g} at the best iterate, which is no optimum"
    method, forward = run.spec["collocation"]["method"], forward_run(run)
    rows = _recorded(run, "mesh")
    last = ([row for row in rows if row["objective"] is not None] or rows)[-1]
    entries = [
        ("collocation", f"{method}, {last['points']} points in each of {counts} intervals"),
        *((f"mesh {k}", ", ".join(map(str, row))) for k, row in enumerate(_rows(run), 1)),
        ("objective", of_optimum if any(row["objective"] is not None for row in rows) else of_iterate),
        *([("starts", _of_starts(ended))] if len(ended) > 1 else []),
        *((name, f"{value:.6g}") for name, value in parameters(run).items()),
    ]
    named = filter(slopes.__contains__, run.spec.get("sensitivities", ()))
    entries += [(f"d/d {name}", f"{slopes[name]:.6g}, derivative of the objective") for name in named]
    if "compared_objective" in run.provenance:
        result = gain(run)()
        share = f"{100 * result.share:.4g} % of the motion that is compared"
        entries.append(("gain", f"{result.value:.6g} +- {result.error:.2g}, {share}"))
    if "pontryagin" in run.provenance and (principle := pontryagin(run)):
        within, count = max(principle["violation"] / (abs(value) or 1.0), 1e-12), principle["starts"]
        how = f"by {count} start{'s' * (count > 1)} at each time" if count else "exactly"
        kept = f"satisfies Pontryagin's minimum principle within {within:.1g} of the objective, examined {how}"
        entries.append(("controls", kept))
    if not math.isnan(forward["end"]):
        at_end, most = (f"{forward[name]:.1e}" for name in ("end", "largest"))
        entries.append(("forward run", f"differs by {at_end} of the range of the motion at the end, {most} at most"))
    return entries


def _rows(run: Run) -> Iterator[tuple[str, str, str, str]]:
    for row in _recorded(run, "mesh"):
        counts, value = " + ".join(map(str, np.atleast_1d(_count(row)))), row["objective"]
        yield (
            f"{counts} x {row['points']}", "no optimum" if value is None else f"{value:.8g}",
            f"{row['iterations']} iterations", row["why"],
        )  # fmt: skip


def _of_starts(values: list[float]) -> str:
    """Return where several starts ended, on the first mesh: different optima, the smallest one first."""
    optima = np.sort([value for value in values if math.isfinite(value)])
    groups = np.split(optima, 1 + np.flatnonzero(np.diff(optima) > SAME * abs(optima[1:]) + 1e-9))
    ended = [f"{len(group)} at {group[0]:.6g}" for group in groups if len(group)]
    none = len(values) - len(optima)
    return f"of {len(values)}, {', '.join(ended + [f'{none} without an optimum'] * bool(none))}"


for attribute in (
    objective, objective_error, mesh, parameters, controls, sensitivities, starts, forward_run, costates, pontryagin,
    gain,
):  # fmt: skip
    run_attribute(attribute)  # not as decorators, which would hide the classes of the results


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
    tables = [
        Table("optimum", "Optimum", columns_of("item; value"), tuple(lines(run)), headline=True),
        Table("meshes", "Meshes", columns_of("intervals x points; objective; iterations; why"), tuple(_rows(run))),
    ]
    if slopes := tuple(sensitivities(run).items()):
        note = "Change of the objective for a small change of the value, with the motion optimized again."
        tables.append(Table("sensitivities", "Sensitivities", columns_of("value; derivative"), slopes, note=note))
    yield Section("prediction", "Prediction", (text,), tables=tuple(tables))
