"""Measures of comparison runs, from which the errors of the measures of a run are estimated.

Unlike companions (the comparison runs of `companion_choice`), which are evaluated only at the recorded times of the
run, these are complete runs. Each has its own integrals, extrema, events and recorded rows, so that the runs do not
share an error of these.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from mbdkit.archive.measured_values import ComparedMeasures
from mbdkit.base.plain_data import canonical
from mbdkit.engine.workspace import Workspace
from mbdkit.methods import radau_iia
from mbdkit.methods.kinds import Method
from mbdkit.runs.accuracy.companion import Budget
from mbdkit.runs.accuracy.companion_choice import (
    GUARD_TOLERANCE,
    IMPLICIT_GUARD_TOLERANCE,
    LOOKS,
    OTHER_TENTHS,
    SINGLE_STEPS,
    TENTHS,
    TIGHTEST,
    guards_of_treatment,
    step_factors,
)
from mbdkit.spec import RunSpec

#: Function that returns the values of all expressions in a run of another spec; None if that run fails.
Measure = Callable[[RunSpec], Sequence[float] | None]


def compared_measures(
    spec: RunSpec,
    method: Method,
    workspace: Workspace,
    steps: int,
    expressions: Sequence[str],
    measure: Measure,
    budget: Budget,
) -> ComparedMeasures:
    """Return the values of expressions in comparison runs.

    `spec`, `method`, `workspace`: the run, whose spec gives method and step. `steps`: number of steps of the run.
    `expressions`, `measure`: the expressions, and the function that evaluates them in a comparison run. `budget`:
    determines when comparison runs must stop; the values are then nan.
    """
    unknown: Sequence[float] = [float("nan")] * len(expressions)
    measured = [
        unknown if budget.stopped() else measure(limited(other, budget)) or unknown for other in _finer(spec, method)
    ]
    guard = unknown
    for other in other_methods(spec, method, workspace, steps):
        values = None if budget.stopped() else measure(limited(other, budget))
        if values is not None:
            guard = values
            break
    return dict(zip(expressions, zip(*measured, guard, strict=True), strict=True))


def limited(spec: RunSpec, budget: Budget) -> RunSpec:
    """Return the spec of a run that takes no longer than the rest of a budget."""
    if budget.left is None:
        return spec
    varied = type(spec)(**spec.sections() | {"limits": canonical(spec.limits) | {"wall_time": budget.left}})
    varied._document = spec._document
    return varied


def _finer(spec: RunSpec, method: Method) -> list[RunSpec]:
    given = canonical(spec.integrator)
    if not spec.claims.adaptive:
        assert spec.time.step is not None
        return [_varied(spec, step=spec.time.step / factor, factor=factor) for factor in step_factors(spec)]
    if given.get("rtol") is not None and method.traits.tableau is not None:
        return [
            _varied(spec, factor=factor, integrator={
                **given, "rtol": max(given["rtol"] / factor, TIGHTEST),
                **({} if given.get("atol") is None else {"atol": max(given["atol"] / factor, TIGHTEST)}),
            })
            for factor in map(int, TENTHS)
        ]  # fmt: skip
    rtol = given.get("rtol") or 1e-6
    radau = {"name": "radau-iia", "stages": 5, "adaptive": True}
    return [
        _varied(spec, factor=100, integrator={**radau, "rtol": max(rtol / factor, TIGHTEST)}, **_index_1(spec))
        for factor in OTHER_TENTHS
    ]


def other_methods(
    spec: RunSpec, method: Method, workspace: Workspace, steps: int, interval: float | None = None
) -> list[RunSpec]:
    """Return the specs of runs with other methods, explicit ones first; see `companion_choice`.

    The runs record every step or, if `interval` [s] is given, the states at this interval.
    """
    if (treated := guards_of_treatment(spec, method)) is not None:
        treatment, factors = treated
        section = {treatment.section_key: canonical(treatment.section)}
        is_fixed, step = not spec.claims.adaptive, spec.time.step
        tight: dict[str, Any] = {} if is_fixed else {"adaptive": True, "rtol": GUARD_TOLERANCE}
        return [
            _varied(
                spec,
                integrator={"name": name, **tight},
                step=step / factor if step and is_fixed else None,
                factor=factor,
                **section,
                **_index_1(spec),
            )
            for name, factor in factors.items()
        ]
    tableau, stiff = method.traits.tableau, method.traits.suits_stiff
    family = "" if tableau is None else tableau.name
    adaptive = {"adaptive": True, "max_step": (spec.time.final - spec.time.start) / LOOKS}
    candidates: list[dict[str, Any]] = [
        {"name": "dop853", "rtol": GUARD_TOLERANCE, **adaptive},
        {"name": "radau-iia", "stages": 5, "rtol": IMPLICIT_GUARD_TOLERANCE, **adaptive},
        {"name": "gauss", "stages": 5, "rtol": IMPLICIT_GUARD_TOLERANCE, **adaptive},
    ]
    most = LOOKS + SINGLE_STEPS[0] + SINGLE_STEPS[1] * steps
    projected = {"stabilization": "projection"} if len(workspace.mechanism.rows) else {}
    others = [
        _varied(spec, integrator=candidate, most_steps=most, interval=interval, **(_index_1(spec) | projected))
        for candidate in candidates
        if not family.startswith(candidate["name"]) and (candidate["name"] != "gauss" or stiff)
    ]
    if not stiff or not workspace.mechanism.rows or family == radau_iia.tableau(5).name:
        return others
    last: dict[str, Any] = {"formulation": "index-2", "stabilization": "none"}
    return [*others, _varied(spec, integrator=candidates[1], most_steps=most, interval=interval, **last)]


def with_other_steps(spec: RunSpec, step: float, *, fixed: bool, tightest: float) -> RunSpec:
    """Return the spec of a comparison run by the same adaptive method with other steps.

    `step`: size of fixed steps, or largest size of adaptive ones [s]. `tightest`: smallest tolerance of adaptive steps.
    """
    given = canonical(spec.integrator)
    most = max(2 + round((spec.time.final - spec.time.start) / step), spec.limits.max_steps)
    if fixed:
        method = {key: given[key] for key in ("name", "stages") if key in given}
        return _varied(spec, step=step, most_steps=most, integrator=method)
    return _varied(spec, integrator=given | {"rtol": max(given["rtol"], tightest), "max_step": step}, most_steps=most)


def _index_1(spec: RunSpec) -> dict[str, Any]:
    return {"formulation": "index-1", "stabilization": "none"}


def _varied(
    spec: RunSpec,
    *,
    step: float | None = None,
    factor: int = 1,
    most_steps: int | None = None,
    interval: float | None = None,
    **sections: object,
) -> RunSpec:
    """Return the spec of a comparison run, without measures, checks and gradients.

    `step`: step [s]; None if the method chooses it. `factor`: factor by which ``limits.max_steps`` of the run is
    multiplied. `most_steps`: largest number of steps; if given, it replaces the limit by `factor`. `interval`: interval
    of the recorded states [s]; None if every step is recorded.
    """
    limits = canonical(spec.limits) | {"max_steps": most_steps or factor * spec.limits.max_steps}
    output = canonical(spec.output) | {"every": 1 if interval is None else None, "interval": interval}
    time = {"start": spec.time.start, "end": spec.time.final, "step": step}
    changed = {
        "time": time, "limits": limits, "output": output, "check": False, "accuracy": None, "choose": None,
        "measures": {}, "gradients": [],
    }  # fmt: skip
    varied = type(spec)(**spec.sections() | changed | sections)
    varied._document = spec._document
    return varied
