"""Measures of comparison runs, from which the errors of the measures of a run are estimated.

Unlike companions, which are evaluated only at the recorded times of the run, these are complete runs. Each has its own
integrals, extrema, events and recorded rows, so that the runs do not share an error of these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mbdkit.archive.measured_values import ComparedMeasures
from mbdkit.base.plain_data import canonical
from mbdkit.runs.accuracy.companion import Budget, Comparison
from mbdkit.runs.accuracy.companion_choice import finer_runs, guards_of_treatment, most_steps, other_runs
from mbdkit.runs.preparation import RunSetup
from mbdkit.spec import RunSpec
from mbdkit.spec.sections import LARGEST_COUNT

#: Function that returns the values of all expressions in a run of another spec; None if that run fails.
Measure = Callable[[RunSpec], Sequence[float] | None]


def compared_measures(
    setup: RunSetup, steps: int, expressions: Sequence[str], measure: Measure, budget: Budget
) -> ComparedMeasures:
    """Return the values of expressions in comparison runs.

    `setup`: the run, whose spec gives method and step. `steps`: number of steps of the run. `expressions`, `measure`:
    the expressions, and the function that evaluates them in a comparison run. `budget`: determines when comparison runs
    must stop; the values are then nan.
    """

    def values(other: RunSpec) -> Sequence[float] | None:
        return None if budget.stopped() else measure(limited(other, budget))

    unknown: Sequence[float] = [float("nan")] * len(expressions)
    measured = [values(_spec_of(run, setup.spec)) or unknown for run in finer_runs(setup)]
    guards = (found for other in other_methods(setup, steps) if (found := values(other)) is not None)
    return dict(zip(expressions, zip(*measured, next(guards, unknown), strict=True), strict=True))


def limited(spec: RunSpec, budget: Budget) -> RunSpec:
    """Return the spec of a run that takes no longer than the rest of a budget."""
    if budget.left is None:
        return spec
    return with_sections(spec, limits=canonical(spec.limits) | {"wall_time": budget.left})


def other_methods(setup: RunSetup, steps: int, interval: float | None = None) -> list[RunSpec]:
    """Return the specs of runs with other methods, explicit ones first; see `other_runs`.

    The runs record every step or, if `interval` [s] is given and the run does not determine reactions of elements, the
    states at this interval.
    """
    spec = setup.spec
    most: int | None = most_steps(steps)
    if guards_of_treatment(spec, setup.method) is not None:
        most, interval = None, None
    return [_spec_of(run, spec, most, interval) for run in other_runs(setup, spec.time.final)]


def with_other_steps(spec: RunSpec, step: float, *, tightest: float) -> RunSpec:
    """Return the spec of a comparison run by the same adaptive method with other steps.

    `step`: largest size of the steps [s]. `tightest`: smallest tolerance.
    """
    given = canonical(spec.integrator)
    most = max(2 + round((spec.time.final - spec.time.start) / step), spec.limits.max_steps)
    return _varied(spec, most, given | {"rtol": max(given["rtol"], tightest), "max_step": step})


def _spec_of(run: Comparison, spec: RunSpec, most: int | None = None, interval: float | None = None) -> RunSpec:
    """Return the spec of a comparison run; `most`: largest number of steps, by default that of the run times the
    factor of the steps.
    """
    sections: dict[str, Any] = {}
    if run.formulation and run.stabilization is not None:
        sections |= {"formulation": run.formulation, "stabilization": run.stabilization.kind}
    if run.treatment is not None:
        sections[run.treatment.section_key] = canonical(run.treatment.section)
    step = None if run.is_adaptive or spec.time.step is None else spec.time.step / run.factor
    integrator = {"name": run.item.name, **canonical(run.options)}
    return _varied(spec, most or run.factor * spec.limits.max_steps, integrator, step, interval, **sections)


def _varied(
    spec: RunSpec,
    most: int,
    integrator: Mapping[str, Any],
    step: float | None = None,
    interval: float | None = None,
    **sections: object,
) -> RunSpec:
    """Return the spec of a comparison run, without measures, checks and gradients.

    `most`: largest number of steps. `integrator`: name and options of the method. `step`: step [s]; None if the method
    chooses it. `interval`: interval of the recorded states [s]; None if every step is recorded.
    """
    return with_sections(
        spec,
        integrator=integrator,
        time={"start": spec.time.start, "end": spec.time.final, "step": step},
        limits=canonical(spec.limits) | {"max_steps": min(most, LARGEST_COUNT)},
        output=canonical(spec.output) | {"every": 1 if interval is None else None, "interval": interval},
        check=False,
        accuracy=None,
        choose=None,
        measures={},
        gradients=[],
        **sections,
    )


def with_sections(spec: RunSpec, **sections: object) -> RunSpec:
    """Return a spec with other sections; errors name the file and line of the given one."""
    varied = type(spec)(**spec.sections() | sections)
    varied._document = spec._document
    return varied
