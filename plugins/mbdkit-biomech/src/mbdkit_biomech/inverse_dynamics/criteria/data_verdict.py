"""The verdict on a result of inverse dynamics, from the doubts about its data and model that the spec does not
accept.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mbdkit.mechanism.improbable_bodies import inertias_about_joints
from mbdkit.runs.findings import findings
from mbdkit.trust.criteria import Evidence, Judgement, judge
from mbdkit.trust.finding import Finding, accepted_doubts, open_doubts
from mbdkit_biomech.inverse_dynamics.compute import Inverse, InverseProblem
from mbdkit_biomech.inverse_dynamics.criteria.column_criteria import column_doubts, doubts_before_fit
from mbdkit_biomech.inverse_dynamics.criteria.data_criterion import data_criterion
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
from mbdkit_biomech.uncertainty.compression_criterion import compression_doubts
from mbdkit_biomech.uncertainty.misfit_criterion import misfit_doubts
from mbdkit_biomech.uncertainty.ranked_doubts import ranked_doubts


class DataDoubts(NamedTuple):
    """Doubts about the data and the model, as sentences that begin with the name of the criterion.

    Attributes
    ----------
    open
        Doubts that the spec does not accept.
    accepted
        Doubts that the spec accepts.
    remarks
        Sentences on the data that do not change the verdict.
    faults
        Findings that make the result bad, and that the spec does not accept.
    """

    open: tuple[str, ...] = ()
    accepted: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


def doubts_about_data(result: Inverse, bars: ResultBars | None) -> DataDoubts:
    """Return the doubts about the data and the model of a result, and remarks on the data."""
    found = ranked_doubts(result, bars, findings("data", result, bars, kind="inverse"))
    remarks = tuple(str(finding) for finding in found if finding.level is None)
    return _sorted(found, result.problem.spec.accept)._replace(remarks=remarks)


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


def doubts_before_computation(problem: InverseProblem) -> DataDoubts:
    """Return those doubts about the data and the model that do not depend on the computed motion and forces."""
    columns = doubts_before_fit(problem.measured, problem.fitter.manifold.length)
    found = [*shared_columns(problem), *columns, *units_of_loads(problem), *missing_points(problem)]
    found += person_findings(problem)
    found += spec_doubts(problem.spec)
    return _sorted(found, problem.spec.accept)


def _sorted(found: Sequence[Finding], accepted: Sequence[str]) -> DataDoubts:
    """Separate open doubts from accepted ones; remarks are left out."""
    faults = open_doubts(found, accepted, "bad")
    return DataDoubts(open_doubts(found, accepted), accepted_doubts(found, accepted), faults=faults)


def verdict_on_data(result: Inverse, misalignment: np.ndarray, doubts: DataDoubts) -> Judgement:
    """Return the verdict, which is ``unknown`` at best: error bars do not cover wrong data, masses and lengths.

    Parameters
    ----------
    misalignment
        (J,) largest misalignment of each joint [m].
    doubts
        The doubts about data and model. Only open doubts lower the level; the accepted ones are added to the reasons.
    """
    joints = result.problem.prepared.workspace.mechanism.joints
    worst = int(np.argmax(misalignment)) if misalignment.size else 0
    return judge(
        Evidence(
            end=float(result.motion.time[-1]),
            size=result.problem.fitter.manifold.length,
            misalignment=float(np.max(misalignment, initial=0.0)),
            joint=joints[worst] if misalignment.size else "",
            warnings=doubts.open,
            faults=doubts.faults,
            accepted=doubts.accepted,
        )
    )
