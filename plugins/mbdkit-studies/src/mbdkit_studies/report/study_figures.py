"""General charts of a study: misalignment, error and cost against the axes of the study and against each other, with
guide lines for orders of convergence.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbdkit_report import Axis, Column, Figure, Guide, Line, key_words, observed_order
from mbdkit_studies.results.cost_at_error import TIMED, TIMED_ONCE, is_timed
from mbdkit_studies.results.point_selection import IN_TOLERANCES, METHOD, OPERATIONS, STEP, value
from mbdkit_studies.store.study_point import StudyPoint, axis_unit, others_than, value_words
from mbdkit_studies.study import Study

_DECADE = 8.0  #: Ratio of largest to smallest value from which an axis is logarithmic.
_SPREAD = f"{TIMED} Bands reach to the upper quartile."


@dataclass(frozen=True)
class Quantity:
    """A number of each run that charts show.

    Parameters
    ----------
    columns
        Columns of the study's index; their sum is the value of the quantity.
    title
        Words for the titles of charts.
    axis
        Axis of the quantity.
    spread
        Columns of the index with lower and upper bounds of the values; None if there are none.
    caption
        Explanation below charts.
    """

    columns: tuple[str, ...]
    title: str
    axis: Axis
    spread: tuple[str, str] | None = None
    caption: str = ""

    @property
    def is_error(self) -> bool:
        """Whether the quantity is an error: smaller values cost more computing time."""
        return any(word in self.columns[0] for word in _ERRORS)

    def of(self, points: Sequence[StudyPoint]) -> np.ndarray:
        """Return the value of the quantity for each point: the sum of its columns."""
        return np.array([sum(value(point, column) for column in self.columns) for point in points])

    def bounds(self, points: Sequence[StudyPoint]) -> tuple[np.ndarray, np.ndarray] | None:
        """Return lower and upper bounds of the values; None if the quantity has no spread."""
        if self.spread is None:
            return None
        low, high = (np.array([value(point, column) for point in points]) for column in self.spread)
        return low, high


_WORK = Quantity(
    OPERATIONS,
    "Operations",
    Axis("evaluations, Jacobians and factorizations", log=True),
    caption="Operations are evaluations of the right-hand side, evaluations of Jacobians and factorizations.",
)
#: A measure is shown against the cost if its name contains one of these words.
_ERRORS = ("error", "misalignment", "balance", "defect", "trend")
_USUAL = ("misalignment_max", "end_error")


def study_figures(study: Study) -> tuple[Figure, ...]:
    """Return the charts of every family of a study: each requested measure and the cost against the numeric axes, and
    each measure of an error against the cost, there with added methods that have tolerances in place of steps.
    """
    figures: list[Figure] = []
    for name, title in study.families.items():
        points = study.family(name)
        costs = (_wall_time(points), _WORK)
        beside = [study.family(name + IN_TOLERANCES)] if name + IN_TOLERANCES in study.families else []
        is_beside = name.endswith(IN_TOLERANCES) and name.removesuffix(IN_TOLERANCES) in study.families
        for measure in asked_measures(study):
            if not np.any(np.nan_to_num(measure.of(points))):
                continue
            measure = replace(measure, axis=replace(measure.axis, log=is_wide(measure.of(points))))
            for key in study.axes(name):
                figures += _against_axis(measure, key, points, name, title)
            for cost in costs if measure.is_error and not is_beside else ():
                figures += _against_cost(measure, cost, [points, *beside], name, title)
        for key in study.axes(name):
            for cost in costs:
                figures += _against_axis(cost, key, points, name, title)
    return tuple(with_slope_guides(figure) for figure in figures)


def measure_columns(study: Study) -> list[tuple[Column, str]]:
    """Return heading and name of the columns of the index that contain the requested measures."""
    return [(Column(measure.axis.label, measure.axis.unit), measure.columns[0]) for measure in asked_measures(study)]


def asked_measures(study: Study) -> Iterator[Quantity]:
    """Yield the measures that the study defines, then the others that it requests. If it neither names nor defines
    measures, yield the most relevant ones.
    """
    asked: object = study.spec.measures
    usual = [name for name in _USUAL if name in study.units]  # without a reference run, there is no error
    defined = [measure.name for measure in study.spec.defined_measures()]
    entries = asked if isinstance(asked, list | tuple) else defined or usual
    named = [name for entry in entries for name in ([entry] if isinstance(entry, str) else entry)]
    for name in dict.fromkeys([*defined, *named]):
        units, long_name = study.described(name)
        words = name if name in defined else _measure_words(name)
        title = words.removeprefix("largest ")
        if name not in defined:  # names that users define keep their capital letters
            title = title.capitalize()
        unit = "" if units == "1" else units
        caption = f"{name}: {long_name}." if name in defined else f"{long_name[:1].upper()}{long_name[1:]}."
        yield Quantity((name,), title, Axis(words, unit), caption=caption)


def _measure_words(name: str) -> str:
    words = name.replace("_", " ")
    if words.endswith(" max"):
        return f"largest {words.removesuffix(' max')}"
    if words.endswith(" end"):
        return f"{words.removesuffix(' end')} at the end"
    return f"{words.removeprefix('end ')} at the end" if words.startswith("end ") else words


def _wall_time(points: Sequence[StudyPoint]) -> Quantity:
    if is_timed(points):
        axis = Axis("wall time, shortest", "s", log=True)
        return Quantity(("wall_min_s",), "Wall time", axis, ("wall_min_s", "wall_q3_s"), _SPREAD)
    return Quantity(("wall_s",), "Wall time", Axis("wall time, timed once", "s", log=True), caption=TIMED_ONCE)


def is_wide(values: np.ndarray) -> bool:
    """Return whether values are shown on a logarithmic axis: none is negative, and the nonzero ones span at least the
    ratio `_DECADE`.
    """
    known = values[np.isfinite(values) & (values != 0)]
    return bool(len(known)) and bool(np.all(known > 0)) and float(known.max() / known.min()) >= _DECADE


def _against_axis(quantity: Quantity, key: str, points: Sequence[StudyPoint], family: str, title: str) -> list[Figure]:
    """Return the chart of a quantity over an axis of the study; empty if the labels of the axis are not numbers, or are
    all equal.
    """
    labels = [point.axes[key] for point in points]
    if not all(isinstance(label, int | float) for label in labels) or len(set(labels)) < 2:
        return []
    values = np.array(labels, dtype=float)
    log = bool(np.all(values > 0) and values.max() / values.min() >= (2.0 if key == STEP else _DECADE))
    axis = Axis(key_words(key), axis_unit(key, points), log)
    lines = []
    for label, group, chosen in _lines(points, key):
        x, bounds = np.array([float(point.axes[key]) for point in chosen]), quantity.bounds(chosen)
        band = None if bounds is None else _band((x, bounds[0]), (x, bounds[1]))
        lines.append(Line(label, x, quantity.of(chosen), "both", group, band))
    of = f" Runs of: {title or family}." if family else ""
    name, heading = slug(family, quantity.title, "over", key), f"{quantity.title} against {axis.label}"
    return [Figure(name, heading, f"{quantity.caption}{of}", axis, quantity.axis, tuple(lines))]


def _against_cost(
    measure: Quantity, cost: Quantity, parts: Sequence[Sequence[StudyPoint]], family: str, title: str
) -> list[Figure]:
    """Return the chart of a measure over the cost; empty if all runs of the first part have the same cost."""
    costs = cost.of(parts[0])
    if len(np.unique(costs[np.isfinite(costs)])) < 2:
        return []
    lines = []
    for points in parts:
        numbers = [
            key
            for key in points[0].axes
            if key != METHOD and all(isinstance(point.axes[key], int | float) for point in points)
        ]
        for label, group, chosen in _lines(points, numbers[-1] if numbers else ""):
            x, y, bounds = cost.of(chosen), measure.of(chosen), cost.bounds(chosen)
            band = None if bounds is None else _band((bounds[0], y), (bounds[1], y))
            lines.append(Line(label, x, y, "both", group, band))
    caption = f"{measure.caption} {cost.caption}" + (f" Runs of: {title or family}." if family else "")
    name, heading = slug(family, measure.title, "over", cost.title), f"{measure.title} against {cost.title.lower()}"
    return [Figure(name, heading, caption, cost.axis, measure.axis, tuple(lines))]


def _band(one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> np.ndarray | None:
    """Return the outline of the area between two curves, each x and y (K,); None if no point of both is known."""
    first, second = np.stack(one, axis=-1), np.stack(other, axis=-1)
    known = np.all(np.isfinite(first) & np.isfinite(second), axis=1)
    return np.concatenate([first[known], second[known][::-1]]) if np.any(known) else None


def _lines(points: Sequence[StudyPoint], along: str) -> list[tuple[str, str, list[StudyPoint]]]:
    """Divide runs into groups whose runs differ along the axis `along` only. Return label, method and points of each
    group; the points are in the order of the axis.
    """
    results: dict[tuple[str, str], list[StudyPoint]] = {}
    for point in points:
        label = ", ".join(value_words(key, point) for key in others_than(along, point))
        results.setdefault((label, str(point.axes.get(METHOD, label))), []).append(point)
    return [
        (label, group, sorted(chosen, key=lambda point: float(point.axes[along])) if along else chosen)
        for (label, group), chosen in results.items()
    ]


def slug(*words: str) -> str:
    """Return a name for a chart, for use in file names."""
    return re.sub(r"[^a-z0-9]+", "-", "-".join(filter(None, words)).lower()).strip("-")


_NEAR = 0.3  #: A guide is drawn if the observed order differs from a whole number by at most this.
_BELOW = 2.5  #: Factor by which a guide lies below the curve.


def with_slope_guides(figure: Figure) -> Figure:
    """Return a chart with a guide line for each whole order of convergence that one of its curves has.

    Parameters
    ----------
    figure
        object chart. Guides are added only if both axes are logarithmic and the label of the x axis is ``step``.
    """
    if not (figure.x.log and figure.y.log and figure.x.label == "step"):
        return figure
    guides: dict[int, Guide] = {}
    for line in figure.lines:
        order = observed_order(line.x, line.y)
        whole = round(order.order) if order.found else 0
        if whole < 1 or abs(order.order - whole) > _NEAR:
            continue
        ends = np.array([min(order.steps), max(order.steps)])
        top = float(line.y[int(np.argmin(np.abs(line.x - ends[1])))]) / _BELOW
        guide = Guide(f"order {whole}", ends, top * (ends / ends[1]) ** whole)
        if whole not in guides or guide.y[1] < guides[whole].y[1]:
            guides[whole] = guide
    return replace(figure, guides=(*figure.guides, *(guides[order] for order in sorted(guides))))
