"""Charts in the report of a design: loads at the start and at the best point, Pareto fronts, and the goals as functions
of each variable near the best point.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Literal

import numpy as np

from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.measures.measured_quantities import recorded, unit_of
from mbdkit.quantities.quantity import Quantity
from mbdkit.spec.run_spec import RunSpec
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
from mbdkit_design.gains import goal_words, variable_unit
from mbdkit_design.landscape import SHARE, Cut, Sensitivity
from mbdkit_report import (
    Axis,
    Cell,
    Column,
    Figure,
    Line,
    Mark,
    Section,
    Table,
    band_over_time,
    bands,
    errors_at,
    key_words,
)

if TYPE_CHECKING:
    from mbdkit.archive.run import Run
    from mbdkit_design.design import Design

#: Phrases for the two points of a design whose runs are stored in archives.
POINT_WORDS = {"start": "at the start", "best": "at the best point"}
_POINTS = 1_000
_TIME = Axis("time", "s")
#: Attribute of `Accuracy` that contains the estimated errors, by attribute of a joint.
_JOINT_ERRORS = {"torque": "torque_error"} | dict.fromkeys(("force", "force_x", "force_y"), "reaction_error")

Pair = dict[str, "Run"]  #: The runs of one scenario, at the ``start`` and at the ``best`` point.


def table_charts(design: Design) -> Iterator[Figure]:
    """Yield a chart of each table that is a variable, with the values at the start and at the best point."""
    for number, (name, table) in enumerate(design.spec.tables.items(), start=1):
        lines = tuple(
            Line(POINT_WORDS[which], table.at, table.values(point.variables), "both")
            for which, point in (("start", design.start), ("best", design.best))
        )
        argument, value = table.units
        axes = Axis("angle" if argument == "rad" else "length", argument), Axis("value", value)
        yield Figure(f"curve-{number}", f"Values of {key_words(name)}", "Before and after the design.", *axes, lines)


def load_charts(design: Design, pairs: Mapping[str, Pair]) -> Iterator[Figure]:
    """Yield a chart over time for each scenario and each quantity in its goals and limits. Each chart has one curve for
    the start and one for the best point.
    """
    for number, (scenario, pair) in enumerate(pairs.items()):
        spec = design.spec.specs[scenario]
        for index, quantity in enumerate(_quantities(design, spec)):
            unit = str(unit_of(quantity, spec) or "")
            lines = tuple(_line(which, quantity, run) for which, run in pair.items())
            where = f" ({scenario})" if scenario else ""
            shaded = " Shaded: estimated error." if any(line.band is not None for line in lines) else ""
            yield Figure(
                f"load-{number + 1}-{index + 1}", f"{quantity_words(quantity, unit)}{where}",
                f"Before and after the design.{shaded}", _TIME, Axis(_kind(quantity, unit), unit), lines,
            )  # fmt: skip


def quantity_words(quantity: Quantity, unit: str) -> str:
    """Return a phrase for a quantity that begins with a capital letter, such as ``Torque of knee_motor``."""
    kind = _kind(quantity, unit)
    owner = "" if quantity.kind == "energy" else f" of {quantity.name}"
    return f"{kind[:1].upper()}{kind[1:]}{' energy' if quantity.kind == 'energy' else ''}{owner}"


def _kind(quantity: Quantity, unit: str) -> str:
    if quantity.attribute == "value":  # the value of a force element or of an actuator
        return {"N": "force", "N m": "torque"}.get(unit, "value")
    if (quantity.kind, quantity.attribute, unit) == ("forces", "length", "rad"):
        return "angle"
    return quantity.attribute.replace("_", " ")


def _quantities(design: Design, spec: RunSpec | InverseSpec) -> Sequence[Quantity]:
    """Return the quantities over time that the expressions of goals and limits contain."""
    results: dict[Quantity, None] = {}
    for measure in design.spec.defined_measures():
        parsed = MeasureExpression.parse(measure.expression, spec, measure.unit)
        results |= dict.fromkeys(quantity for quantity in parsed.quantities if quantity.is_over_time)
    return list(results)


def _line(which: str, quantity: Quantity, run: Run) -> Line:
    own = recorded(quantity, run)
    values = np.hypot(*own) if quantity.is_vector else own
    curve = bands(np.asarray(run.time), values[:, None], points=_POINTS)
    error = _error(quantity, run, curve.time)
    band = None if error is None else band_over_time(curve.time, curve.low[:, 0], curve.high[:, 0], error)
    return Line(POINT_WORDS[which], *curve.curve(0), band=band)


def _error(quantity: Quantity, run: Run, time: np.ndarray) -> np.ndarray | None:
    """Return the estimated error (K,) of a quantity at the times `time` (K,), nan where it is unknown; None if no error
    is estimated for this quantity.
    """
    if (quantity.kind, quantity.attribute) == ("actuators", "value"):
        rows = np.searchsorted(np.asarray(run.time), time, side="right") - 1
        return np.asarray(run.actuators[quantity.name].value_error)[rows]
    accuracy = run.accuracy
    if accuracy is None or quantity.kind != "joints" or quantity.attribute not in _JOINT_ERRORS:
        return None
    errors = getattr(accuracy, _JOINT_ERRORS[quantity.attribute])
    return errors_at(accuracy, errors[:, run.joint_names.index(quantity.name)], time)


def front_charts(design: Design, units: Mapping[str, str]) -> Iterator[Figure]:
    """Yield a chart of the Pareto front for each pair of goals."""
    points = {"front": design.front, "best": (design.best,), "start": (design.start,)}
    pairs = list(combinations(design.best.goals, 2))
    for number, (first, second) in enumerate(pairs):
        kind: Literal["points", "both"] = "both" if len(pairs) == 1 else "points"
        lines = []
        for label, chosen in points.items():
            x, y = np.array([(point.goals[first], point.goals[second]) for point in chosen]).T
            lines.append(Line(label, x, y, kind if label == "front" else "points"))
        caption = (
            f"Pareto front: no point has less of {'both' if len(pairs) == 1 else 'all'} goals. The best point is "
            f"closest to the smallest values of all goals, each relative to its range on the front."
        )
        name = "front" if len(pairs) == 1 else f"front-{number + 1}"
        axes = Axis(first, units[first]), Axis(second, units[second])
        yield Figure(name, f"{second} against {first}", caption, *axes, tuple(lines))


def landscape_charts(design: Design, around: Mapping[str, Sequence[Cut]], units: Mapping[str, str]) -> Iterator[Figure]:
    """Yield for each variable a chart of the goals as functions of this variable.

    Parameters
    ----------
    around
        Values of the goals along each variable, by name of the settings of the runs. The empty name stands for the
        design's own settings.
    units
        Units of the goals by name.
    """
    limited = " Where a limit is violated, the goal may be smaller than at the best point."
    common = next(iter(units.values())) if len(set(units.values())) == 1 else ""
    for index, cut in enumerate(around[""]):
        words, unit = key_words(cut.variable), variable_unit(design.spec, cut.variable)
        cuts = [(f" with {settings}" if settings else "", found[index]) for settings, found in around.items()]
        lines = [
            Line(f"{goal_words(name)}{beside}", other.values, other.goals[:, k])
            for beside, other in cuts
            for k, name in enumerate(design.spec.totals)
        ]
        yield Figure(
            f"cut-{index + 1}", f"Goal along {words}",
            f"The goal near the best point, which is marked, with all other variables at their best values."
            f"{limited if design.spec.subject_to else ''}",
            Axis(words, unit), Axis("goal", common), tuple(lines),
            marks=(Mark("best", design.best.variables[cut.variable]),),
        )  # fmt: skip


def sensitivity_section(
    found: Sequence[Sensitivity], words: Mapping[str, str], units: Mapping[tuple[str, str], str]
) -> Section:
    """Return the section with the table of sensitivities.

    Parameters
    ----------
    words
        Names of the variables as written in sentences, by name in the spec.
    units
        Units of goals and limits by scenario and name.
    """
    sentence = (
        f"Change of each goal and limit, to first order, if one variable is increased from its best value by "
        f"{100 * SHARE:g} % of the width of its bounds. Where neither bounds nor limits are active, the "
        "changes of a single goal in the scenarios, times their weights, add up to zero for each variable. A goal "
        "whose slope is discontinuous at the best value has two changes, for an increase and for a decrease."
    )
    both = "{1:+.3g} if increased, {0:+.3g} if decreased"  # where the slope of the measure is discontinuous
    rows: list[tuple[Cell, ...]] = [
        (
            f"{one.measure} ({one.scenario})" if one.scenario else one.measure,
            units[one.scenario, one.measure],
            *(both.format(*one.corners[name]) if name in one.corners else x for name, x in one.changes.items()),
        )
        for one in found
    ]
    columns = (Column("goal or limit"), Column("unit"), *(Column(words[name]) for name in found[0].changes))
    table = Table("sensitivities-table", "Changes in numbers", columns, tuple(rows))
    return Section("sensitivities", "Sensitivities", (sentence,), None, (table,))
