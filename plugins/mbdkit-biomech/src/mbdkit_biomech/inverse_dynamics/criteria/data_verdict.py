"""The doubts about the data and the model of a result of inverse dynamics, from which its verdict follows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from mbdkit.mechanism.improbable_bodies import inertias_about_joints
from mbdkit.runs.findings import findings
from mbdkit.trust.finding import Doubts, Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse, InverseProblem
from mbdkit_biomech.inverse_dynamics.criteria.column_criteria import column_doubts, doubts_before_fit
from mbdkit_biomech.inverse_dynamics.criteria.doubt import data_criterion
from mbdkit_biomech.inverse_dynamics.criteria.load_criteria import load_doubts, units_of_loads
from mbdkit_biomech.inverse_dynamics.criteria.load_point_criterion import forces_at_centres, missing_points
from mbdkit_biomech.inverse_dynamics.criteria.model_criteria import model_doubts, spec_doubts
from mbdkit_biomech.inverse_dynamics.criteria.record_criteria import large_errors, record_doubts
from mbdkit_biomech.inverse_dynamics.criteria.shared_columns import equal_columns, shared_columns
from mbdkit_biomech.inverse_dynamics.criteria.smoothing_criteria import cutoff_doubts
from mbdkit_biomech.inverse_dynamics.criteria.turn_criteria import knee_doubts, turn_doubts, uncertain_turns
from mbdkit_biomech.inverse_dynamics.errors.error_bars import ResultBars
from mbdkit_biomech.inverse_dynamics.errors.stated_deviations import large_deviations
from mbdkit_biomech.inverse_dynamics.muscles.knees import left_out_of_recruitment
from mbdkit_biomech.uncertainty.compression_criterion import compression_doubts, misfit_doubts
from mbdkit_biomech.uncertainty.ranked_doubts import ranked_doubts


def doubts_about_data(result: Inverse, bars: ResultBars | None) -> Doubts:
    """Return the doubts about the data and the model of a result, and remarks on the data."""
    found = ranked_doubts(result, bars, findings("data", result, bars, kind="inverse"))
    return Doubts.of(found, result.problem.spec.accept)


@data_criterion
def doubts_of_columns(result: Inverse, bars: ResultBars | None) -> list[Finding]:
    """Return the doubts about columns of the motion and their smoothing, and remarks on columns."""
    return [
        *shared_columns(result.problem),
        *column_doubts(result),
        *cutoff_doubts(result),
        *_remarks(equal_columns(result.problem)),
    ]


@data_criterion
def doubts_of_loads(result: Inverse, bars: ResultBars | None) -> list[Finding]:
    """Return the doubts about loads, and remarks on forces without a point."""
    return [*load_doubts(result, bars), *_remarks(forces_at_centres(result.problem))]


@data_criterion
def doubts_of_model(result: Inverse, bars: ResultBars | None) -> list[Finding]:
    """Return the doubts about the model, about forces without a point, and about turns and signs of angles."""
    mechanism = result.problem.names.mechanism
    remarks = [*uncertain_turns(result), *large_deviations(result, bars), *inertias_about_joints(mechanism)]
    remarks += left_out_of_recruitment(result)
    return [
        *model_doubts(result),
        *missing_points(result.problem),
        *turn_doubts(result),
        *knee_doubts(result),
        *compression_doubts(result),
        *_remarks(remarks),
    ]


@data_criterion
def doubts_of_record(result: Inverse, bars: ResultBars | None) -> list[Finding]:
    """Return the doubts about the record, the units of loads, and errors."""
    return [*record_doubts(result, bars), *units_of_loads(result.problem), *large_errors(result, bars)]


@data_criterion
def doubts_of_person(result: Inverse, bars: ResultBars | None) -> list[Finding]:
    """Return the doubts about the person and remarks on it."""
    uncertain = None if bars is None else bars.uncertain
    remarks = [] if uncertain is None else [uncertain.failures if uncertain.failed else "", uncertain.too_few]
    return [*person_findings(result.problem), *misfit_doubts(result, bars), *_remarks(filter(None, remarks))]


def person_findings(problem: InverseProblem) -> list[Finding]:
    """Return what was found about the person of a spec."""
    person = problem.source.person
    return [] if person is None else [*person.findings]


def _remarks(sentences: Iterable[str]) -> Iterator[Finding]:
    return (Finding("", None, sentence, is_named=False) for sentence in sentences)


def doubts_before_computation(problem: InverseProblem) -> tuple[str, ...]:
    """Return those doubts about the data and the model that do not depend on the computed motion and forces, and that
    the spec does not accept.
    """
    columns = doubts_before_fit(problem.measured, problem.fitter.manifold.length)
    found = [*shared_columns(problem), *columns, *units_of_loads(problem), *missing_points(problem)]
    found += person_findings(problem)
    found += spec_doubts(problem.spec)
    return Doubts.of(found, problem.spec.accept).open
