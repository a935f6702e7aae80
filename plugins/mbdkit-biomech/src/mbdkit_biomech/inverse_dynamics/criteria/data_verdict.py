"""The doubts about the data and the model of a result of inverse dynamics, from which its verdict follows.

They are listed by what they change in the largest joint force: the most important one comes first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.mechanism.improbable_bodies import inertias_about_joints
from mbdkit.runs.findings import findings
from mbdkit.trust.finding import Doubts, Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse, InverseProblem, reactions_of
from mbdkit_biomech.inverse_dynamics.criteria import (
    column_criteria,
    load_criteria,
    load_point_criterion,
    model_criteria,
    record_criteria,
)
from mbdkit_biomech.inverse_dynamics.criteria.doubt import data_criterion
from mbdkit_biomech.inverse_dynamics.errors.error_bars import ResultBars
from mbdkit_biomech.inverse_dynamics.muscles.knees import left_out_of_recruitment
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import free_roots
from mbdkit_biomech.uncertainty.changed_problem import Changer

#: First words of the names of the sources of error that a criterion doubts.
SOURCES: Mapping[str, tuple[str, ...]] = {
    "centers": ("centre",), "lengths": ("centre", "lengths"), "load-point": ("pressure",), "load-time": ("offset",),
    "load-offset": ("gain",), "misfit": ("centre", "pressure", "gain", "mass", "inertia", "zero"),
    "fibers": ("fibre", "tendon"), "max-force": ("strength",), "inertia": ("inertia",),
    **dict.fromkeys(("noise", "fit", "cutoff", "gaps", "ends", "large-errors", "outliers"), ("noise",)),
}  # fmt: skip


def doubts_about_data(result: Inverse, bars: ResultBars | None) -> Doubts:
    """Return the doubts about the data and the model of a result, and remarks on the data."""
    found = ranked_doubts(result, bars, findings("data", result, bars, kind="inverse"))
    return Doubts.of(found, result.problem.spec.accept)


@data_criterion
def doubts_of_data(result: Inverse, bars: ResultBars | None) -> list[str | Finding]:
    """Return the doubts about columns, loads, model, record and person, and remarks on them as sentences."""
    problem, uncertain = result.problem, None if bars is None else bars.uncertain
    return [
        *column_criteria.shared_columns(problem),
        *column_criteria.column_doubts(result),
        *record_criteria.cutoff_doubts(result),
        *column_criteria.equal_columns(problem),
        *load_criteria.load_doubts(result, bars),
        *load_point_criterion.forces_at_centres(problem),
        *model_criteria.model_doubts(result),
        *load_point_criterion.missing_points(problem),
        *model_criteria.turn_doubts(result),
        *model_criteria.knee_doubts(result),
        *model_criteria.compression_doubts(result),
        *model_criteria.uncertain_turns(result),
        *record_criteria.large_deviations(result, bars),
        *inertias_about_joints(problem.names.mechanism),
        *left_out_of_recruitment(result),
        *record_criteria.record_doubts(result, bars),
        *load_criteria.units_of_loads(problem),
        *record_criteria.large_errors(result, bars),
        *person_findings(problem),
        *model_criteria.misfit_doubts(result, bars),
        *([] if uncertain is None else uncertain.remarks),
    ]


def person_findings(problem: InverseProblem) -> list[Finding]:
    """Return what was found about the person of a spec."""
    person = problem.source.person
    return [] if person is None else [*person.findings]


def doubts_before_computation(problem: InverseProblem) -> tuple[str, ...]:
    """Return those doubts about the data and the model that do not depend on the computed motion and forces, and that
    the spec does not accept.
    """
    found = [
        *column_criteria.shared_columns(problem),
        *column_criteria.doubts_before_fit(problem.measured, problem.fitter.manifold.length),
        *load_criteria.units_of_loads(problem),
        *load_point_criterion.missing_points(problem),
        *person_findings(problem),
        *model_criteria.spec_doubts(problem.spec),
    ]
    return Doubts.of(found, problem.spec.accept).open


def ranked_doubts(result: Inverse, bars: ResultBars | None, findings: Sequence[Finding]) -> list[Finding]:
    """Return findings with the change of the largest joint force, the largest first; those whose effect is not known,
    and remarks, keep their order.

    The effect of residuals is the residual force at the time of the largest force, and that of an offset of the plates
    the change without its correction. Other effects are the parts of the error bar by the sources that are doubted.
    """
    force = np.linalg.norm(reactions_of(result)[..., :2], axis=2)
    if not force.size or not any(one.level for one in findings):
        return list(findings)
    row, joint = map(int, np.unravel_index(np.argmax(force), force.shape))
    name = result.problem.prepared.workspace.mechanism.joints[joint]
    known = {one.criterion: _effect(one.criterion, result, bars, row, joint) for one in findings if one.level}

    def with_effect(one: Finding) -> Finding:
        if not one.level or not known[one.criterion]:
            return one
        effect = f"(about {float(f'{known[one.criterion]:.2g}'):g} N of the largest force, of {name})"
        return replace(one, sentence=f"{one.sentence.rstrip('.')} {effect}")

    return sorted(map(with_effect, findings), key=lambda one: -known[one.criterion] if one.level else 0.0)


def _effect(criterion: str, result: Inverse, bars: ResultBars | None, row: int, joint: int) -> float:
    """Return the effect of the doubts of a criterion on the force of a joint in a row [N]; 0 if it is not known."""
    if criterion in ("residuals", "residual-size"):
        root = free_roots(result.problem.names.mechanism)[0]
        residual, _ = load_criteria.residual_wrench(result, root, None, only_residuals=False)
        return float(np.linalg.norm(residual[row, :2]))
    person = result.problem.source.person
    if criterion == "plates" and person is not None and person.plates.offset is not None and person.plates.loads:
        try:
            other = Changer(result).at({("offset",): -person.plates.offset.late}).forces()
        except MbdkitError:
            return 0.0
        return float(np.nan_to_num(np.linalg.norm((reactions_of(other) - reactions_of(result))[row, joint, :2])))
    if bars is None or not (parts := bars.accuracy.further):
        return 0.0
    of = [str(name).split(" ")[0] in SOURCES.get(criterion, ()) for name in parts["source"].values]
    share = float(np.sum(np.maximum(parts["contribution"].values[of, row, joint], 0.0)))
    return float(np.nan_to_num(bars.accuracy.reaction_error[row, joint] * share**0.5))
