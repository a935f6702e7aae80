"""Tables of the points of a design, for its summary and its report."""

from __future__ import annotations

from collections.abc import Sequence

from mbdkit.spec.yaml_reader import write_yaml
from mbdkit_design.compared_settings import Comparison
from mbdkit_design.design_spec import DesignSpec
from mbdkit_design.gains import goal_units, variable_unit
from mbdkit_design.known_points import DesignPoint
from mbdkit_report import Cell, Column, Table, key_words


def comparison_table(
    spec: DesignSpec, best: DesignPoint, compared: Sequence[Comparison], *, is_feasible: bool
) -> Table:
    """Return the table of the best points of this design and of the searches with other settings of the runs."""
    (goal,) = best.goals
    names = [*spec.single]
    own, value = (best.variables[name] for name in names), best.goals[goal]
    rows: list[tuple[Cell, ...]] = [("this design", *own, value, value, "yes" if is_feasible else "no")]
    for comparison in compared:
        if comparison.believed is None or comparison.actual is None:
            rows.append((comparison.name, *(None for _ in names), None, None, "no best point"))
        else:
            actual = None if comparison.fails else comparison.actual.goals[goal]
            limits = "a run fails" if comparison.fails else "yes" if comparison.is_feasible else "no"
            values = [comparison.believed.variables[name] for name in names]
            rows.append((comparison.name, *values, comparison.believed.goals[goal], actual, limits))
    unit = goal_units(spec)[goal]
    columns = (
        Column("best point with"),
        *(Column(key_words(name), variable_unit(spec, name)) for name in names),
        Column("goal with it", unit),
        Column("goal in fact", unit),
        Column("satisfies limits"),
    )
    changes = {name: write_yaml(settings).strip().replace("\n", ", ") for name, settings in spec.compare.items()}
    text = "; ".join(f"{name}: {changed}" for name, changed in changes.items())
    note = f"The goal in fact, and whether limits are satisfied, are computed with the settings of the design. {text}."
    return Table("compared", "Results with other settings", columns, tuple(rows), note)


def front_table(spec: DesignSpec, front: Sequence[DesignPoint], best: DesignPoint) -> Table:
    """Return the table of the points of a Pareto front."""
    units = goal_units(spec)
    columns = (
        Column("point"),
        *(Column(name, units[name]) for name in best.goals),
        *(Column(key_words(name), variable_unit(spec, name)) for name in spec.single),
    )
    rows = tuple(
        (f"{number}{' (best)' * (point == best)}", *point.goals.values(), *map(point.variables.get, spec.single))
        for number, point in enumerate(front, 1)
    )
    return Table("front-points", "Points of the Pareto front", columns, rows)
