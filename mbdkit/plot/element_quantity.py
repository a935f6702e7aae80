"""A quantity of every joint or force element over time, drawn in a panel or returned as lines of a chart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from mbdkit.archive.history import UnknownNameError
from mbdkit.archive.run_views import Names
from mbdkit.figures.beam_curves import distributed_loads
from mbdkit.figures.curves import UNKNOWN, Array, Bands, band_over_time, bands, errors_at
from mbdkit.figures.page_model import Axis, Figure, Line, Mark
from mbdkit.figures.palette import FAINT, INK, PALETTE, PAPER
from mbdkit.plot.panel import dress_over_time, panel_title, single_row_marker
from mbdkit.plot.style import legend, powers_of_ten

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

SMALLEST = 1e-18
"""Lowest floor of a logarithmic axis; the round-off of a length of 1 m is a hundred times larger."""

MOST = len(PALETTE)
"""Number of elements in a chart for which none are named."""


@dataclass(frozen=True)
class ElementQuantity:
    """A quantity of several elements, which are joints or force elements, over time.

    Parameters
    ----------
    name, unit
        Name and unit for labels.
    elements
        Names of the J elements.
    data
        One curve for each element.
    errors
        (K, J) estimated errors at the times of `data`, nan where unknown; None if they were not estimated.
    known_until
        Time until which the errors are known [s]; nan if they are known to the end, or were not estimated.
    """

    name: str
    unit: str
    elements: Sequence[str]
    data: Bands
    errors: Array | None = None
    known_until: float = math.nan

    @property
    def zero(self) -> bool:
        """Whether every value is zero."""
        return not np.any(np.nan_to_num(self.data.peaks) > 0)

    @property
    def largest(self) -> tuple[int, float]:
        """Column of the element with the largest magnitude, and that magnitude."""
        column = int(np.argmax(np.nan_to_num(self.data.peaks, nan=-1.0)))
        return column, float(self.data.peaks[column])

    @property
    def nonzero_columns(self) -> list[int]:
        """Columns of the elements with values other than zero; nan counts as such a value."""
        return [int(column) for column in np.flatnonzero(np.nan_to_num(self.data.peaks, nan=1.0))]

    def largest_columns(self, count: int) -> list[int]:
        """Return the columns of at most `count` elements, those with the largest magnitudes, in their order."""
        size = np.nan_to_num(self.data.peaks, nan=np.inf)
        return sorted(np.argsort(-size, kind="stable")[:count].tolist())

    def only(self, columns: list[int]) -> ElementQuantity:
        """Return the same quantity of some of the elements."""
        data = self.data
        part = Bands(data.time, data.low[:, columns], data.high[:, columns], data.peaks[columns], data.exact)
        errors = None if self.errors is None else self.errors[:, columns]
        elements = [self.elements[column] for column in columns]
        return replace(self, elements=elements, data=part, errors=errors)


def has_elements(run: Run) -> bool:
    """Return whether a run recorded force elements, or has actuators."""
    return run.records("forces/value") or bool(run.actuators)


def element_values(run: Run, unit: str, name: str) -> ElementQuantity:
    """Return the values of the force elements and actuators with a unit, ``N`` or ``N m``; of none if there are none.

    The forces on nodes that the distributed loads of beams consist of are left out.

    Raises
    ------
    NotRecordedError
        The run did not record force elements, and has no actuators.
    """
    time, acting = np.asarray(run.time), list(run.actuators.values())
    forces = [] if acting and not run.records("forces/value") else list(run.forces.values())
    units = [one.units for one in forces] + [one.units for one in acting]
    loads = distributed_loads(run) if forces else ()
    columns = [column for column, given in enumerate(units) if given == unit]
    columns = [column for column in columns if column >= len(forces) or forces[column].name not in loads]
    data: Any = run.dataset("forces/value") if forces else np.zeros((len(time), 0))
    if acting:
        data = np.column_stack([data[:], run.array("actuators/value")])
    taken = [force.name for force in forces]
    names = taken + [f"{one.name} (actuator)" if one.name in taken else one.name for one in acting]
    quantity = ElementQuantity(name, unit, tuple(names), bands(time, data))
    if acting and run.accuracy is not None:
        errors = np.column_stack([np.full((len(time), len(forces)), np.nan), run.array("actuators/value_error")])
        quantity = replace(quantity, errors=errors_at(run.accuracy, errors, quantity.data.time))
    return quantity.only(columns)


def picked(quantity: ElementQuantity, wanted: Names, what: str, most: int = MOST) -> list[int]:
    """Return the columns of the wanted elements or, if None, of at most `most` non-zero ones with the largest values.

    Parameters
    ----------
    what
        Kind of the elements, such as ``joint``.

    Raises
    ------
    UnknownNameError
        There is no such element.
    """
    if wanted is None:
        columns = quantity.nonzero_columns
        return [columns[k] for k in quantity.only(columns).largest_columns(most)] or quantity.largest_columns(1)
    names = [wanted] if isinstance(wanted, str) else list(dict.fromkeys(wanted))
    for name in names:
        if name not in quantity.elements:
            raise UnknownNameError(what, name, list(quantity.elements))
    return [quantity.elements.index(name) for name in names]


def element_lines(quantity: ElementQuantity, groups: Sequence[str] = ()) -> tuple[Line, ...]:
    """Return a line of a chart for each element; of long runs the largest values, or both extremes where signs differ.

    Parameters
    ----------
    groups
        Group of each line; by default its element.
    """
    data = quantity.data
    signed = bool(np.nanmin(data.low, initial=0.0) < 0.0)
    found = []
    for k, (label, group) in enumerate(zip(quantity.elements, groups or quantity.elements, strict=True)):
        time, values = data.curve(k) if signed else (data.time, data.high[:, k])
        found.append(Line(label, time, values, group=group, band=_band(quantity, k)))
    return tuple(found)


def element_chart(name: str, title: str, caption: str, axis: Axis, quantity: ElementQuantity, **look: Any) -> Figure:
    """Return a chart of a quantity of some elements over time, with the time until which its errors are known.

    Parameters
    ----------
    **look
        Further arguments of `element_lines`.
    """
    marks: tuple[Mark, ...] = ()
    if quantity.errors is not None:
        caption += " Bands show estimated errors; those narrower than a line are hidden by it."
    if math.isfinite(quantity.known_until):
        marks = (Mark(UNKNOWN, quantity.known_until),)
    return Figure(name, title, caption, Axis("time", "s"), axis, element_lines(quantity, **look), marks=marks)


def _band(quantity: ElementQuantity, column: int) -> Array | None:
    """Return the outline of the estimated error of one element; None if it is unknown or was not estimated."""
    if quantity.errors is None:
        return None
    data = quantity.data
    return band_over_time(data.time, data.low[:, column], data.high[:, column], quantity.errors[:, column])


def draw_elements(axes: Axes, quantity: ElementQuantity, what: str, *, log: bool = False, title: str = "") -> None:
    """Draw a quantity of the elements over time.

    Up to as many elements as there are colours are drawn individually. Of more, the largest value of all and the five
    elements with the largest values are drawn.

    Parameters
    ----------
    what
        Kind of the elements in the plural, such as ``joints``.
    title
        Title of the panel; by default it states the largest value.
    """
    elements, data = quantity.elements, quantity.data
    dress_over_time(axes, f"{quantity.name}\n[{quantity.unit}]")
    if not elements:
        panel_title(axes, f"{quantity.name}: there are no {what}")
        return
    column, most = quantity.largest
    told = f"{value_text(most, quantity.unit)}{_known_to(quantity, column)}"
    panel_title(axes, title or f"{quantity.name}: largest {told} ({elements[column]})")
    columns = list(range(len(elements)))
    handles, labels = [], []
    floor = _floor(data.high) if log else -np.inf
    if len(elements) > len(PALETTE):
        columns = quantity.largest_columns(len(PALETTE) - 1)
        top = np.max(np.nan_to_num(np.maximum(np.abs(data.low), np.abs(data.high))), axis=1)
        (line,) = axes.plot(data.time, np.maximum(top, floor), color=INK, linewidth=2.2, alpha=0.45)
        handles.append(line)
        labels.append(f"largest of {len(elements)}")
    for color, chosen in zip(PALETTE, columns, strict=False):
        time, values = (data.time, np.maximum(data.high[:, chosen], floor)) if log else data.curve(chosen)
        (line,) = axes.plot(time, values, color=color, linewidth=1.1, marker=single_row_marker(time))
        handles.append(line)
        labels.append(elements[chosen])
        if (band := _band(quantity, chosen)) is not None:
            axes.fill(*band.T, color=color, alpha=0.25, linewidth=0)
    if np.isfinite(quantity.known_until):
        axes.axvline(quantity.known_until, color=FAINT, linewidth=1.0, linestyle=":")
        late = quantity.known_until > (data.time[0] + data.time[-1]) / 2
        axes.annotate(
            UNKNOWN,
            (quantity.known_until, 0.98),
            xycoords=("data", "axes fraction"),
            xytext=(-3 if late else 3, 0),
            textcoords="offset points",
            size=7.5,
            color=FAINT,
            ha="right" if late else "left",
            va="top",
        )
    legend(axes, handles, labels)
    if log:
        axes.set_yscale("log")
        _show_floor(axes, floor, data.high, quantity.unit)
    else:
        powers_of_ten(axes)
        if np.nanmin(data.low, initial=0.0) >= 0.0:
            axes.set_ylim(bottom=0.0)


def _known_to(quantity: ElementQuantity, column: int) -> str:
    """Return the estimated error of the largest value of an element, such as `` ± 0.3 N``; empty if not estimated."""
    if quantity.errors is None:
        return ""
    data, errors = quantity.data, quantity.errors[:, column]
    largest = np.nan_to_num(np.maximum(np.abs(data.low[:, column]), np.abs(data.high[:, column])))
    error = float(errors[int(np.argmax(largest))])
    return f" ± {error:.2g} {quantity.unit}" if np.isfinite(error) else ", error unknown"


def value_text(value: float, unit: str) -> str:
    """Return a value with its unit, or ``not finite``."""
    return f"{value:.3g} {unit}" if np.isfinite(value) else "not finite"


def _floor(values: Array) -> float:
    """Return a power of ten below 99.5 % of the non-zero values."""
    positive = values[values > 0]
    if not positive.size:
        return SMALLEST
    return float(max(SMALLEST, 10.0 ** np.floor(np.log10(np.quantile(positive, 0.005)))))


def _show_floor(axes: Axes, floor: float, values: Array, unit: str) -> None:
    """Set the lower limit of a logarithmic axis, with a note if smaller values are drawn at it."""
    top = float(np.nanmax(values, initial=0.0))
    axes.set_ylim(floor * 0.8, max(top * 2.0, floor * 10.0))
    if np.any(values < floor):
        axes.text(
            0.995, 0.02, f"values below {floor:.0e} {unit} are drawn there", transform=axes.transAxes,
            size=7.5, color=FAINT, ha="right", va="bottom",
            bbox={"facecolor": PAPER, "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
        )  # fmt: skip
