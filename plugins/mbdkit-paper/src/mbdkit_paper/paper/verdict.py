"""Verdict on the paper: tests of its results, claims and predictions, and results beyond its scope."""

from __future__ import annotations

import math

from mbdkit_paper.paper.computation_time import substitution, times
from mbdkit_paper.paper.method_comparison import growth, orders, work
from mbdkit_paper.paper.paper_predictions import joints, knee
from mbdkit_paper.paper.published_results import METHODS, magnitudes, ranking, trajectories
from mbdkit_paper.paper.source_paper import TITLE
from mbdkit_paper.wording import UNDECIDED, Words, least_most, reported
from mbdkit_report import Answer, Cell, Claim, Table, Verdict
from mbdkit_studies import METHOD, MODEL, STEP, Study, family, value
from mbdkit_studies.results.judge import study_verdict


@study_verdict
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
    claims = reported((size, gill, gauss, path, law, order, time, speed, *knee_claims, joint, choice, *work_claims))
    beyond = (order_table, law_table, choice_table, work_table, time_table, speed_table)
    tables = (size_table, rank_table, knee_table, joint_table, *beyond)
    figures = (*path_figures, *drift_figures, knee_figure, joint_figure, *work_figures, time_figure, speed_figure)
    top = reported((size, gill, knee_claims[-1], joint, speed))
    sentence = " ".join(claim.sentence for claim in top if claim.answer is not Answer.OPEN)
    return Verdict(
        "paper", "The paper, re-run", sentence or UNDECIDED, claims, tables, figures, WORDS.notes(title=TITLE)
    )


COORDINATES = "coordinates"
BODIES, JOINTS = "bodies", "joints"
ROUND_OFF = 1e-12  #: Misalignment [m] of rods of 20 m counts as round-off below this.
FAR = 1e3
#: Misalignment does not measure the accuracy of a method if an error is more than this many times larger.
WORDS = Words(__file__)


def coordinates(study: Study) -> tuple[Claim, Table]:
    """Compare misalignments and errors of methods in body coordinates and in joint coordinates."""
    rows: list[tuple[Cell, ...]] = []
    errors: dict[tuple[object, ...], dict[str, float]] = {}
    drift: dict[str, dict[str, list[float]]] = {BODIES: {}, JOINTS: {}}
    for point in family(study, "coordinates"):
        label, method = str(point.axes[COORDINATES]), str(point.axes[METHOD])
        apart, error = value(point, "misalignment_max"), value(point, "end_error")
        rows.append((point.axes[MODEL], method, label, point.axes[STEP], apart, error))
        if method not in METHODS:  # it was added
            continue
        drift[label].setdefault(method, []).append(apart)
        errors.setdefault((method, point.axes[MODEL], point.axes[STEP]), {})[label] = error
    pairs = [pair for pair in errors.values() if len(pair) == 2]
    closed = max((max(found) for found in drift[JOINTS].values()), default=math.nan)
    ratios = [pair[JOINTS] / pair[BODIES] for pair in pairs]
    ends = [pair[JOINTS] for pair in pairs]
    answer, between = Answer.OPEN, least_most(ratios)
    if ratios and not math.isnan(sum(ratios)):
        far = max(ends) > FAR * closed
        answer = Answer.NO if closed < ROUND_OFF and far else Answer.YES
    apart_by = ", ".join(f"{max(found):.1e} m ({method})" for method, found in drift[BODIES].items())
    left = "round-off" if closed < ROUND_OFF else f"at most {closed:.1e} m"
    spread = f"{min(ends, default=math.nan):.1e} m to {max(ends, default=math.nan):.1e} m"
    values = {"apart": apart_by, "left": left, "spread": spread, "between": between}
    return WORDS.claim("coordinates", answer, **values), WORDS.table("coordinates", rows)
