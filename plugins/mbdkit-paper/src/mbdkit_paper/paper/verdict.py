"""Verdict on the paper: tests of its results, claims and predictions, and results beyond its scope."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbdkit_paper.paper.choice_of_coordinates import coordinates
from mbdkit_paper.paper.computation_time import substitution, times
from mbdkit_paper.paper.method_comparison import growth, orders, work
from mbdkit_paper.paper.paper_predictions import joints, knee
from mbdkit_paper.paper.published_results import magnitudes, ranking, trajectories
from mbdkit_paper.paper.source_paper import TITLE
from mbdkit_report.analysis.verdict import UNDECIDED, Answer, Verdict, told

if TYPE_CHECKING:
    from mbdkit_studies.study import Study

NOTES = (
    f"The source paper is \u201c{TITLE}\u201d. Its author and DOI are not known to us.",
    (
        "The paper states the step, h = 0.1 s, but no masses, lengths, gravity or initial angles. We assume uniform "
        "rods of 20 m and 1 kg, released 40 degrees below the horizontal. These assumptions reproduce the "
        "published misalignments."
    ),
    "With rods of 1 m released from the horizontal, the same methods and step give misalignments of cm to metres.",
    "Misalignment is given in metres or millimetres as in the paper; it scales with the size of the mechanism.",
    (
        "Verdicts on misalignment are based on ranges, factors and counts, and do not depend on the machine; times are "
        "those of this machine."
    ),
)


def verdict(study: Study) -> Verdict:
    """Return the verdict on the packaged study `paper`.

    Parameters
    ----------
    study
        The study. The time of substitution into SymPy matrices is measured once and stored in its folder.
    """
    size, size_table = magnitudes(study)
    gill, gauss, rank_table = ranking(study)
    path, path_figures, drift_figures = trajectories(study)
    time, time_table, time_figure = times(study)
    speed, speed_table, speed_figure = substitution(study)
    knee_claims, knee_table, knee_figure = knee(study)
    joint, joint_table, joint_figure = joints(study)
    order, order_table = orders(study)
    law, law_table = growth(study)
    choice, choice_table = coordinates(study)
    work_claims, work_table, work_figures = work(study)
    claims = told((size, gill, gauss, path, law, order, time, speed, *knee_claims, joint, choice, *work_claims))
    tables = (
        size_table,
        rank_table,
        knee_table,
        joint_table,
        order_table,
        law_table,
        choice_table,
        work_table,
        time_table,
        speed_table,
    )
    figures = (*path_figures, *drift_figures, knee_figure, joint_figure, *work_figures, time_figure, speed_figure)
    top = told((size, gill, knee_claims[-1], joint, speed))
    sentence = " ".join(claim.sentence for claim in top if claim.answer is not Answer.OPEN)
    return Verdict("paper", "The paper, re-run", sentence or UNDECIDED, claims, tables, figures, NOTES)
