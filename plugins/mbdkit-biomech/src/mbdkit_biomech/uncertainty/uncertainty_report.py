"""The section of the report on what contributes to the error bars of joint forces, with a chart over time."""

from __future__ import annotations

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_biomech.uncertainty.contributions import (
    NAMED,
    PERSON_MODEL_ERROR,
    contributions,
    has_contributions,
    largest_joints,
)
from mbdkit_report import Axis, Cell, Figure, Line, Section, Table, columns_of
from mbdkit_report.seams import report_charts, report_sections

DRAWN = 6  #: Number of sources of a chart; those that are left out have smaller shares.


@report_sections
def uncertainty_sections(run: Run, _mechanism: Mechanism | None) -> tuple[Section, ...]:
    """Return the section with the sources of the error bars at the largest forces; empty without uncertainty."""
    if not has_contributions(run):
        return ()
    rows: list[tuple[Cell, ...]] = []
    sentences = []
    for joint in largest_joints(run):
        own = contributions(run, joint)
        sentences.append(f"{joint}: {own.sentence}.")
        rows += [(joint, own.time, own.force, own.error, name, share) for name, share in [*own.shares.items()][:DRAWN]]
    heads = columns_of("joint; time [s]; force [N]; error bar [N]; source; share")
    note = (
        "Shares in the square of the error bar at the largest force of each joint. The error bars do not contain "
        f"{PERSON_MODEL_ERROR}."
    )
    shown = Table("sources", "Sources of the error bars", heads, tuple(rows), note)
    first = f"The {NAMED} largest sources at the largest force of each joint, and what reduces the first one."
    return (Section("uncertainty", "Uncertainty", (first, *sentences), None, (shown,)),)


@report_charts
def uncertainty_charts(run: Run) -> list[Figure]:
    """Return a chart of the shares over time for the joints with the largest forces; empty without uncertainty."""
    accuracy, time, found = run.accuracy, np.asarray(run.time), []
    for joint in largest_joints(run):
        assert accuracy is not None
        place = list(run.joint_names).index(joint)
        size = accuracy.parts["contribution"][..., place] * accuracy.reaction_error[:, place]
        order = np.argsort(-np.nansum(np.abs(size), axis=1), kind="stable")[:DRAWN]
        lines = tuple(Line(str(accuracy.parts["source"][index]), time, size[index]) for index in order)
        caption = (
            f"Error bar of the force of {joint}, divided among its sources in proportion to their shares in its square."
        )
        axis = Axis("part of the error bar", "N")
        found.append(Figure(f"sources-{joint}", f"Sources of error, {joint}", caption, Axis("time", "s"), axis, lines))
    return found
