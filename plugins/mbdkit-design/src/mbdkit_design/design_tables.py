"""Tables of the points of a design, for its summary and its report; see `mbdkit_design.design.Design`."""

from __future__ import annotations

from typing import Any

from mbdkit.spec.yaml_reader import write_yaml
from mbdkit_design.gains import goal_units, variable_unit
from mbdkit_report import Cell, Column, Table, key_words


def comparison_table(design: Any) -> Table:
    """Return the table of the best points of this design and of the searches with other settings of the runs."""
    (goal,) = design.best.goals
    best, names = design.best, [*design.spec.single]
    own, value = (best.variables[name] for name in names), best.goals[goal]
    rows: list[tuple[Cell, ...]] = [("this design", *own, value, value, "yes" if design.is_feasible else "no")]
    for comparison in design.compared:
        if comparison.believed is None or comparison.actual is None:
            rows.append((comparison.name, *(None for _ in names), None, None, "no best point"))
        else:
            actual = None if comparison.fails else comparison.actual.goals[goal]
            limits = "a run fails" if comparison.fails else "yes" if comparison.is_feasible else "no"
            rows.append(
                (
                    comparison.name,
                    *(comparison.believed.variables[name] for name in names),
                    comparison.believed.goals[goal],
                    actual,
                    limits,
                )
            )
    unit = goal_units(design.spec)[goal]
    columns = (
        Column("best point with"),
        *(Column(key_words(name), variable_unit(design.spec, name)) for name in names),
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


def front_table(design: Any) -> Table:
    """Return the table of the points of a Pareto front."""
    units = goal_units(design.spec)
    columns = (
        Column("point"),
        *(Column(name, units[name]) for name in design.best.goals),
        *(Column(key_words(name), variable_unit(design.spec, name)) for name in design.spec.single),
    )
    rows = tuple(
        (
            f"{number}{' (best)' * (point == design.best)}",
            *point.goals.values(),
            *map(point.variables.get, design.spec.single),
        )
        for number, point in enumerate(design.front, 1)
    )
    return Table("front-points", "Points of the Pareto front", columns, rows)
