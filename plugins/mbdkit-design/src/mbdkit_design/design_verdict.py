"""The verdict on a design: its gain, whether the gain exceeds the errors, and the tables of its points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.text import counted
from mbdkit_design.design_tables import comparison_table, front_table
from mbdkit_design.gains import Cost, goal_units, goal_words, measure_units, variable_unit
from mbdkit_design.robustness import Deviation
from mbdkit_design.trust import QUESTIONED
from mbdkit_report import Answer, Cell, Claim, Column, Table, Verdict, key_words, with_unit

if TYPE_CHECKING:
    from mbdkit_design.compared_settings import Comparison
    from mbdkit_design.design import Design
    from mbdkit_design.design_spec import DesignSpec
    from mbdkit_design.known_points import DesignPoint

#: Largest difference at which two optima count as equal. Differences of variables are relative to the distance between
#: their bounds; differences of goals are relative to the goal at the start or at the best point, whichever is larger.
SAME = 1e-3


def design_verdict(design: Design) -> Verdict:
    """Return the verdict on a design, without charts."""
    claims = [
        _certified(design),
        *_gains(design),
        *_limits(design),
        *(_compared(design, comparison) for comparison in design.compared),
    ]
    at_best, every = design.searches
    note = f"{at_best} of {every} searches ended at this point to 0.1 % of the goal."
    return Verdict(
        name="design",
        title="Verdict",
        sentence=" ".join([*(claim.sentence for claim in claims if claim.sentence), *design.warnings]),
        claims=tuple(claims),
        tables=tuple(_tables(design)),
        notes=(" ".join(filter(None, (note, design.single, design.derivatives))),),
    )


def _gains(design: Design) -> Iterator[Claim]:
    """Yield for each goal the claim that its gain exceeds the estimated errors."""
    for gain in design.gains:
        unit = f" {gain.unit}" if gain.unit else ""
        known = "of unknown error" if np.isnan(gain.error) else f"with an estimated error of {gain.error:.1g}{unit}"
        answer = Answer.OPEN if gain.is_real is None else Answer.YES if gain.is_real else Answer.NO
        statement = f"The gain of the {goal_words(gain.name)} exceeds the errors of both points."
        sentence = f"The {goal_words(gain.name)} changes {gain.text()}."
        text = f"{gain.start:.6g} to {gain.best:.6g}{unit}, {known}"
        yield Claim(f"gain-{gain.name}", statement, "", text, answer, sentence)


def _certified(design: Design) -> Claim:
    level = design.trust.level
    answer = {"good": Answer.YES, "unknown": Answer.OPEN, "doubtful": Answer.PARTLY}.get(level, Answer.NO)
    sentence = design.trust.judgement if level in QUESTIONED else ""
    return Claim("runs", "The runs at the start and at the best point can be trusted.", "", level, answer, sentence)


def _limits(design: Design) -> Iterator[Claim]:
    count = len(design.spec.subject_to) + sum(len([*table.rows]) for table in design.spec.tables.values())
    if count:
        answer = Answer.YES if design.is_feasible else Answer.NO
        text = f"{counted(count, 'limit')} in {counted(len(design.spec.specs), 'scenario')}"
        yield Claim("limits", "The best point satisfies all limits.", "", text, answer, "")


def _compared(design: Design, comparison: Comparison) -> Claim:
    """Return the claim that the search with other settings of the runs finds the same best point."""
    name = f"compared-{[*design.spec.compare].index(comparison.name) + 1}"
    statement = f"With {comparison.name}, the best point is the same."
    if comparison.believed is None or comparison.actual is None:
        return Claim(name, statement, "", comparison.reason, Answer.NO, comparison.reason)
    (goal,) = design.best.goals
    unit = f" {units}" if (units := goal_units(design.spec)[goal]) else ""
    believed, actual, best = (point.goals[goal] for point in (comparison.believed, comparison.actual, design.best))
    moved = max(
        abs(comparison.believed.variables[key] - design.best.variables[key]) / variable.width
        for key, variable in design.spec.chosen.items()
    )
    size = max(abs(best), abs(design.start.goals[goal]))
    same = moved <= SAME and abs(believed - best) <= SAME * size and comparison.is_feasible
    in_fact = "a run fails there" if comparison.fails else f"it is {actual:.6g}{unit}"
    text = f"goal there {believed:.6g}{unit}, in fact {in_fact}; best {best:.6g}{unit}"
    sentence = f"{comparison.confirmation(goal_units(design.spec)[goal])} {comparison.reason}".strip()
    if not same:
        beyond = "" if comparison.is_feasible or comparison.fails else ", and limits are violated there"
        sentence = (
            f"With {comparison.name}, the optimum seems to have a {goal_words(goal)} of {believed:.6g}{unit}; in fact "
            f"{in_fact}{beyond}. {sentence}"
        )
    return Claim(name, statement, "", text, Answer.YES if same else Answer.NO, sentence.rstrip())


def _tables(design: Design) -> Iterator[Table]:
    """Yield the tables of variables, of goals and limits in each scenario and, if there are any, of searches with other
    settings of the runs and of points of the Pareto front.
    """
    start, best = design.start.variables, design.best.variables
    rows: list[tuple[Cell, ...]] = [
        (key_words(name), variable.bounds[0], start[name], best[name], variable.bounds[1],
         variable_unit(design.spec, name), design.side(name))
        for name, variable in design.spec.single.items()
    ]  # fmt: skip
    names = ("variable", "lower bound", "start", "best", "upper bound", "unit", "at a bound")
    if rows:
        yield Table("variables", "Variables", tuple(map(Column, names)), tuple(rows))
    for number, (name, table) in enumerate(design.spec.tables.items(), start=1):
        of_table = zip(table.at.tolist(), table.values(start).tolist(), table.values(best).tolist(), strict=True)
        argument, value = table.units
        heads = Column("at", argument), Column("start", value), Column("best", value)
        yield Table(f"table-{number}", f"Values of {key_words(name)}", heads, tuple(of_table), table.remark(best))
    yield _goal_table(design)
    if design.compared:
        yield comparison_table(design.spec, design.best, design.compared, is_feasible=design.is_feasible)
    if len(design.front) > 1:
        yield front_table(design.spec, design.front, design.best)


def _goal_table(design: Design) -> Table:
    units, start = measure_units(design.spec), design.start.measures
    limits = {name: (limit.min, limit.max) for name, limit in design.spec.subject_to.items()}
    rows: list[tuple[Cell, ...]] = [
        (scenario, name, units[scenario, name], start[scenario][name], value, *limits.get(name, (None, None)))
        for scenario, measures in design.best.measures.items()
        for name, value in measures.items()
    ]
    names = ["scenario", "goal or limit", "unit", "start", "best", "smallest", "largest"]
    if not design.spec.scenarios:
        names, rows = names[1:], [row[1:] for row in rows]
    text = "; ".join(f"{measure.name}: {measure.expression}" for measure in design.spec.defined_measures())
    return Table("goals", "Goals and limits", tuple(map(Column, names)), tuple(rows), text)


def costs_table(costs: Sequence[Cost]) -> Table:
    """Return the table of the loads that differ between the start and the best point."""
    rows: list[tuple[Cell, ...]] = [
        (one.scenario, one.label, one.unit, one.start, one.best, None if np.isinf(one.share) else 100 * one.share)
        for one in costs
    ]
    columns = tuple(map(Column, ("scenario", "load", "unit", "start", "best", "change in %")))
    if not any(cost.scenario for cost in costs):
        rows, columns = [row[1:] for row in rows], columns[1:]
    note = "Largest forces and torques that change by 1 % or more."
    return Table("costs", "Loads elsewhere", columns, tuple(rows), note)


def robustness_table(spec: DesignSpec, point: DesignPoint, deviations: Sequence[Deviation]) -> Table:
    """Return the table of the goals at the best point if one number of the model differs from its given value."""
    units = goal_units(spec)
    columns = [Column("number"), Column("off by")]
    for name in point.goals:
        columns += [Column(f"{goal_words(name)} if {word}", units[name]) for word in ("smaller", "larger")]
    limits = bool(spec.subject_to)
    rows: list[tuple[Cell, ...]] = [
        (deviation.words, deviation.size, *(float(value) for value in deviation.goals.T.ravel()),
         *((", ".join(deviation.exceeds),) if limits else ()))
        for deviation in deviations
    ]  # fmt: skip
    best = ", ".join(f"{goal_words(name)} {with_unit(value, units[name], 4)}" for name, value in point.goals.items())
    note = f"At the best point: {best}. Bounds of the variables do not apply here."
    columns += [Column("limits exceeded")] if limits else []
    return Table("robustness", "If a number is not met exactly", tuple(columns), tuple(rows), note)
