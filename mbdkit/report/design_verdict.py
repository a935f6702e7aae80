"""The verdict on a design: its gain, the reliability of the gain, and the tables of its points."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.analysis.verdict import Answer, Claim, Verdict
from mbdkit.base.text import counted
from mbdkit.figures.page_model import Cell, Column, Table
from mbdkit.measures.take import describe
from mbdkit.report.design_charts import goal_words, variable_unit
from mbdkit.spec.key_words import key_words
from mbdkit.spec.yaml_reader import write_yaml

if TYPE_CHECKING:
    from mbdkit.designs.compared_settings import Comparison
    from mbdkit.designs.design import Design

SAME = 1e-3
"""Difference of two optima that counts as zero: of goals relative to the start, of variables relative to the bounds."""


def design_verdict(design: Design) -> Verdict:
    """Return the verdict on a design, without charts."""
    claims = [
        *_gains(design),
        _certified(design),
        *_limits(design),
        *(_compared(design, one) for one in design.compared),
    ]
    at_best, every = design.searches
    note = f"{at_best} of {every} searches ended at this point to 0.1 % of the goal."
    alone = " A single search finds a local minimum; `optimizer.starts` makes several." if every == 1 else ""
    return Verdict(
        name="design",
        title="Verdict",
        sentence=" ".join([*(claim.sentence for claim in claims if claim.sentence), *design.warnings]),
        claims=tuple(claims),
        tables=tuple(_tables(design)),
        notes=(" ".join(filter(None, (note + alone, design.derivatives))),),
    )


def measure_units(design: Design) -> dict[tuple[str, str], str]:
    """Return the units of goals and limits by scenario and name; empty for numbers without one."""
    found = {
        (scenario, measure.name): describe(measure, spec).units
        for scenario, spec in design.spec.specs.items()
        for measure in design.spec.defined_measures()
    }
    return {place: "" if unit == "1" else unit for place, unit in found.items()}


def goal_units(design: Design) -> dict[str, str]:
    """Return the units of what is minimised by name; empty for a sum of squares, or if scenarios differ."""
    if design.spec.sums_squares:
        return dict.fromkeys(design.spec.totals, "")
    units = measure_units(design)
    found = {name: {units[scenario, name] for scenario in design.spec.specs} for name in design.spec.totals}
    return {name: one.pop() if len(one) == 1 else "" for name, one in found.items()}


def _gains(design: Design) -> Iterator[Claim]:
    """Yield a claim for each goal: that it gains more than the estimated errors."""
    units = goal_units(design)
    for name, best in design.best.goals.items():
        before, error, is_gain = design.start.goals[name], design.trust.errors[name], design.trust.is_gain[name]
        share = f" ({100 * (best - before) / abs(before):+.3g} %)" if before else ""
        unit = f" {units[name]}" if units[name] else ""
        sentence = f"The {goal_words(name)} changes from {before:.6g} to {best:.6g}{unit}{share}."
        known = "of unknown error" if np.isnan(error) else f"with an estimated error of {error:.1g}{unit}"
        answer = Answer.OPEN if is_gain is None else Answer.YES if is_gain else Answer.NO
        statement = f"The gain of the {goal_words(name)} exceeds the errors of both points."
        yield Claim(f"gain-{name}", statement, "", f"{before:.6g} to {best:.6g}{unit}, {known}", answer, sentence)


def _certified(design: Design) -> Claim:
    level = design.trust.verdict
    answer = {"good": Answer.YES, "unknown": Answer.OPEN, "doubtful": Answer.PARTLY}.get(level, Answer.NO)
    text = f"worst verdict: {level}{f', {design.trust.reason}' if design.trust.reason else ''}"
    return Claim("runs", "The runs at the best point can be trusted.", "", text, answer, "")


def _limits(design: Design) -> Iterator[Claim]:
    if design.spec.subject_to:
        answer = Answer.YES if design.is_feasible else Answer.NO
        text = f"{counted(len(design.spec.subject_to), 'limit')} in {counted(len(design.spec.specs), 'scenario')}"
        yield Claim("limits", "The best point satisfies all limits.", "", text, answer, "")


def _compared(design: Design, one: Comparison) -> Claim:
    """Return the claim that other settings of the runs find the same best point."""
    name = f"compared-{[*design.spec.compare].index(one.name) + 1}"
    statement = f"With {one.name}, the best point is the same."
    if one.believed is None or one.actual is None:
        return Claim(name, statement, "", one.reason, Answer.NO, one.reason)
    (goal,) = design.best.goals
    unit = f" {units}" if (units := goal_units(design)[goal]) else ""
    believed, actual, best = (point.goals[goal] for point in (one.believed, one.actual, design.best))
    moved = max(
        abs(one.believed.variables[key] - design.best.variables[key]) / (high - low)
        for key, (low, high) in ((key, variable.bounds) for key, variable in design.spec.variables.items())
    )
    size = max(abs(best), abs(design.start.goals[goal]))
    same = moved <= SAME and abs(believed - best) <= SAME * size and one.is_feasible
    in_fact = "a run fails there" if one.fails else f"it is {actual:.6g}{unit}"
    text = f"goal there {believed:.6g}{unit}, in fact {in_fact}; best {best:.6g}{unit}"
    if same:
        return Claim(name, statement, "", text, Answer.YES, f"{one.confirmation()} {one.reason}".strip())
    beyond = "" if one.is_feasible or one.fails else ", and limits are violated there"
    sentence = (
        f"With {one.name}, the optimum seems to have a {goal_words(goal)} of {believed:.6g}{unit}; in fact "
        f"{in_fact}{beyond}. {one.confirmation()} {one.reason}"
    )
    return Claim(name, statement, "", text, Answer.NO, sentence.rstrip())


def _tables(design: Design) -> Iterator[Table]:
    """Yield the tables of variables, of goals and limits in each scenario, of comparisons, and of a Pareto front."""
    start, best = design.start.variables, design.best.variables
    rows: list[tuple[Cell, ...]] = [
        (key_words(name), variable.bounds[0], start[name], best[name], variable.bounds[1],
         variable_unit(design, name), design.side(name))
        for name, variable in design.spec.variables.items()
    ]  # fmt: skip
    names = ("variable", "lower bound", "start", "best", "upper bound", "unit", "at a bound")
    yield Table("variables", "Variables", tuple(map(Column, names)), tuple(rows))
    yield _goal_table(design)
    if design.compared:
        yield _comparison_table(design)
    if len(design.front) > 1:
        yield _front_table(design)


def _goal_table(design: Design) -> Table:
    units = measure_units(design)
    rows: list[tuple[Cell, ...]] = []
    for scenario, measures in design.best.measures.items():
        for name, value in measures.items():
            limit = design.spec.subject_to.get(name)
            rows.append(
                (scenario, name, units[scenario, name], design.start.measures[scenario][name], value,
                 None if limit is None else limit.min, None if limit is None else limit.max)
            )  # fmt: skip
    names = ["scenario", "goal or limit", "unit", "start", "best", "smallest", "largest"]
    if not design.spec.scenarios:
        names, rows = names[1:], [row[1:] for row in rows]
    text = "; ".join(f"{measure.name}: {measure.expression}" for measure in design.spec.defined_measures())
    return Table("goals", "Goals and limits", tuple(map(Column, names)), tuple(rows), text)


def _comparison_table(design: Design) -> Table:
    """Return the table of the best points that searches with other settings of the runs find."""
    (goal,) = design.best.goals
    best = design.best
    rows: list[tuple[Cell, ...]] = [("this design", *best.variables.values(), best.goals[goal], best.goals[goal],
                                     "yes" if design.is_feasible else "no")]  # fmt: skip
    for one in design.compared:
        if one.believed is None or one.actual is None:
            rows.append((one.name, *(None for _ in best.variables), None, None, "no best point"))
        else:
            actual = None if one.fails else one.actual.goals[goal]
            limits = "a run fails" if one.fails else "yes" if one.is_feasible else "no"
            rows.append((one.name, *one.believed.variables.values(), one.believed.goals[goal], actual, limits))
    unit = goal_units(design)[goal]
    columns = (
        Column("best point with"),
        *(Column(key_words(name), variable_unit(design, name)) for name in best.variables),
        Column("goal with it", unit),
        Column("goal in fact", unit),
        Column("satisfies limits"),
    )
    text = "; ".join(
        f"{name}: {write_yaml(settings).strip().replace(chr(10), ', ')}"
        for name, settings in design.spec.compare.items()
    )
    note = f"The goal in fact, and whether limits are satisfied, are computed with the settings of the design. {text}."
    return Table("compared", "Results with other settings", columns, tuple(rows), note)


def _front_table(design: Design) -> Table:
    units = goal_units(design)
    columns = (
        *(Column(name, units[name]) for name in design.best.goals),
        *(Column(key_words(name), variable_unit(design, name)) for name in design.best.variables),
    )
    rows = tuple((*one.goals.values(), *one.variables.values()) for one in design.front)
    return Table("front-points", "Points of the Pareto front", columns, rows)
