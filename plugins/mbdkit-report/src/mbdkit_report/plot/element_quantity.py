"""A quantity of every joint or force element over time, with estimated errors, drawn in a panel or as a chart."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from mbdkit.archive.headlines import Headline, plus_minus
from mbdkit.archive.run_views import Gap, Names
from mbdkit_report.figures.beam_curves import distributed_loads
from mbdkit_report.figures.curves import UNKNOWN, Array, Bands, band_over_time, bands, errors_at
from mbdkit_report.figures.page_model import TIME, Axis, Figure, Line, Mark
from mbdkit_report.figures.palette import FAINT, INK, PALETTE, PAPER
from mbdkit_report.plot.charts import Panel, draw_lines, named
from mbdkit_report.plot.style import legend, powers_of_ten

if TYPE_CHECKING:
    import h5py

    from mbdkit.archive.run import Run

#: Lowest value of a logarithmic axis; the round-off of a length of 1 m is about a hundred times larger.
SMALLEST = 1e-18

MOST = len(PALETTE)  #: Largest number of elements in a chart if no elements are named.


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
    known
        The same in the rows whose errors are known; None if there are none.
    peak_errors
        (J,) errors of the largest values of `known`, with what rows miss between them, nan where unknown; None if the
        run has no error estimates.
    missed
        (J,) by how much the largest values between rows exceed those of `data`, nan where unknown; zero if every step
        is recorded.
    """

    name: str
    unit: str
    elements: Sequence[str]
    data: Bands
    errors: Array | None = None
    known_until: float = math.nan
    known: Bands | None = None
    peak_errors: Array | None = None
    missed: Array | None = None

    @property
    def zero(self) -> bool:
        """Whether every value is zero."""
        return not np.any(np.nan_to_num(self.data.peaks) > 0)

    @property
    def largest(self) -> tuple[int, float]:
        """Index of the element with the largest magnitude, and this magnitude."""
        column = int(np.argmax(np.nan_to_num(self.data.peaks, nan=-1.0)))
        return column, float(self.data.peaks[column])

    @property
    def nonzero_columns(self) -> list[int]:
        """Indices of the elements that have values other than zero; nan counts as such a value."""
        return [int(column) for column in np.flatnonzero(np.nan_to_num(self.data.peaks, nan=1.0))]

    def largest_columns(self, count: int) -> list[int]:
        """Return the indices of at most `count` elements with the largest magnitudes, in the order of the elements."""
        return sorted(np.argsort(-np.nan_to_num(self.data.peaks, nan=np.inf), kind="stable")[:count].tolist())

    def only(self, columns: list[int]) -> ElementQuantity:
        """Return the same quantity for some of the elements."""
        errors, peak_errors, missed = (
            None if values is None else values[..., columns] for values in (self.errors, self.peak_errors, self.missed)
        )
        return replace(
            self, elements=[self.elements[column] for column in columns], data=self.data.only(columns), errors=errors,
            known=self.known and self.known.only(columns), peak_errors=peak_errors, missed=missed,
        )  # fmt: skip

    def text(self, column: int) -> str:
        """Return the largest value of an element with its error and time or, if the value between rows is clearly
        larger, with that value, as text.
        """
        value, time = float(self.data.peaks[column]), float(self.data.peak_times[column])
        missed = 0.0 if self.missed is None else float(self.missed[column])
        error = math.nan if self.peak_errors is None else float(self.peak_errors[column])
        largest = Headline(self.name, value, self.unit, error, missed, is_checked=self.known is not None)
        if largest.misses:
            return largest.text("±")
        if self.known is None or time > self.known_until:
            unknown = "" if self.known is None else ", error unknown"
            return f"{value:.4g} {self.unit} (at {time:.4g} s{unknown})"
        return f"{largest.text('±')} (at {time:.4g} s)"


def has_elements(run: Run) -> bool:
    """Return whether a run recorded force elements, or has actuators."""
    return run.records("forces/value") or run.records("actuators/value")


def element_values(run: Run, unit: str, name: str) -> ElementQuantity:
    """Return the values of the force elements and actuators whose `unit` is ``N`` or ``N m``; the result may have no
    elements.

    Force elements that represent the distributed loads of beams are left out.

    Raises
    ------
    NotRecordedError
        If the run did not record force elements, and has no actuators.
    """
    time, acting = np.asarray(run.time), list(run.actuators.values())
    forces = [] if acting and not run.records("forces/value") else list(run.forces.values())
    units = [force.units for force in forces] + [one.units for one in acting]
    loads = distributed_loads(run) if forces else ()
    columns = [column for column, given in enumerate(units) if given == unit]
    columns = [column for column in columns if column >= len(forces) or forces[column].name not in loads]
    data: h5py.Dataset | np.ndarray = run.dataset("forces/value") if forces else np.zeros((len(time), 0))
    if acting:
        data = np.column_stack([data[:], run.array("actuators/value")])
    taken = [force.name for force in forces]
    names = taken + [f"{one.name} (actuator)" if one.name in taken else one.name for one in acting]
    quantity = ElementQuantity(name, unit, tuple(names), bands(time, data))
    if run.accuracy is not None:
        errors, own = None, np.zeros(0)
        if acting:
            bars, largest = run.array("actuators/value_error"), np.abs(run.array("actuators/value"))
            own = run.errors.of_largest("actuators.value", list(run.actuators), largest, bars)
            every = np.column_stack([np.full((len(time), len(forces)), np.nan), bars])
            errors = errors_at(run.accuracy, every, quantity.data.time)
        peaks = np.concatenate([np.full(len(forces), np.nan), own])
        quantity = replace(quantity, errors=errors, peak_errors=peaks)
    return quantity.only(columns)


def _reaction(run: Run, word: str, unit: str, error: str, values: Callable[[Array], Array]) -> ElementQuantity:
    """Return a reaction of all joints, a ``force`` or ``torque``.

    Parameters
    ----------
    error
        Attribute of `Accuracy` with its estimated errors.
    values
        Function that maps a block of rows to one value for each row and joint.
    """
    data, time, accuracy = run.dataset(f"joints/reaction_{word}"), np.asarray(run.time), run.accuracy
    curves = bands(time, data, values)
    missed = run.errors.missed(f"joints.{word}", run.joint_names, curves.peaks[None])
    quantity = ElementQuantity(f"reaction {word}", unit, run.joint_names, curves, missed=missed)
    if accuracy is None:
        return quantity
    count = accuracy.rows_known
    if not count:
        return replace(with_errors(run, quantity, error), peak_errors=np.full(len(curves.peaks), np.nan))
    rows = np.asarray(data[:count], dtype=np.float64)
    known = curves if accuracy.is_complete else bands(time[:count], rows, values)
    peaks = run.errors.of_reactions(error, np.abs(values(rows)))
    return replace(with_errors(run, quantity, error), known=known, peak_errors=peaks)


#: Name and unit of each kind of misalignment.
GAPS: dict[Gap, tuple[str, str]] = {
    "position": ("misalignment", "m"),
    "velocity": ("velocity misalignment", "m/s"),
    "angle": ("angle misalignment", "rad"),
}


def misalignment(run: Run, gap: Gap = "position") -> ElementQuantity:
    """Return a kind of misalignment of every joint; an angle is zero for joints that do not constrain an angle."""
    name, unit = GAPS[gap]
    data = run.dataset(f"joints/{name.replace(' ', '_')}")
    return ElementQuantity(name, unit, run.joint_names, bands(np.asarray(run.time), data))


def reaction_force(run: Run) -> ElementQuantity:
    """Return the magnitude of the reaction force of every joint [N], with its estimated error."""
    return _reaction(run, "force", "N", "reaction_error", lambda f: np.hypot(f[..., 0], f[..., 1]))


def reaction_torque(run: Run) -> ElementQuantity:
    """Return the reaction torque of every joint [N m], with its estimated error."""
    return _reaction(run, "torque", "N m", "torque_error", np.asarray)


def with_errors(
    run: Run, quantity: ElementQuantity, name: str, joints: Sequence[int] | slice = slice(None)
) -> ElementQuantity:
    """Add the estimated errors of joints to a quantity, if they were estimated: the attribute `name` of `Accuracy`.

    Parameters
    ----------
    joints
        Index of the joint of each element; by default the elements are all joints.
    """
    accuracy = run.accuracy
    if accuracy is None:
        return quantity
    errors = errors_at(accuracy, getattr(accuracy, name)[:, joints], quantity.data.time)
    until = math.nan if accuracy.is_complete else accuracy.known_until
    return replace(quantity, errors=errors, known_until=until)


def picked(quantity: ElementQuantity, wanted: Names, what: str, most: int = MOST) -> list[int]:
    """Return the indices of the wanted elements or, if None, of at most `most` elements with the largest values.
    Elements whose values are all zero are then left out, except a single one if there are no others.
    Raises UnknownNameError if there is no such element, of the kind `what`.
    """
    if wanted is None:
        columns = quantity.nonzero_columns
        return [columns[k] for k in quantity.only(columns).largest_columns(most)] or quantity.largest_columns(1)
    return [quantity.elements.index(name) for name in named(wanted, quantity.elements, what)]


def element_chart(
    name: str, title: str, caption: str, axis: Axis, quantity: ElementQuantity, groups: Sequence[str] = ()
) -> Figure:
    """Return a chart of a quantity of some elements over time, with a mark at the time until which errors are known.

    A long run is divided into bands of consecutive rows. The lines show the largest value of each band or, if any value
    is negative, the smallest and the largest value.

    Parameters
    ----------
    groups
        Group of the line of each element; by default the element.
    """
    data, errors = quantity.data, quantity.errors
    signed = bool(np.nanmin(data.low, initial=0.0) < 0.0)
    lines = []
    for k, (label, group) in enumerate(zip(quantity.elements, groups or quantity.elements, strict=True)):
        time, values = data.curve(k) if signed else (data.time, data.high[:, k])
        band = None if errors is None else band_over_time(data.time, data.low[:, k], data.high[:, k], errors[:, k])
        lines.append(Line(label, time, values, group=group, band=band))
    if errors is not None:
        caption += " Bands show estimated errors; those narrower than a line are hidden by it."
    marks = (Mark(UNKNOWN, quantity.known_until),) if math.isfinite(quantity.known_until) else ()
    return Figure(name, title, caption, TIME, axis, tuple(lines), marks=marks)


def element_panel(
    quantity: ElementQuantity, what: str, height: float = Panel.height, *, log: bool = False, title: str = ""
) -> Panel:
    """Return the panel of a quantity of the elements over time.

    If there are not more elements than colours, each is drawn. Otherwise, the maximum over all elements and the five
    elements with the largest values are drawn.

    Parameters
    ----------
    what
        Kind of the elements in the plural, such as ``joints``.
    title
        Title of the panel; by default it states the largest value.
    """

    def draw(axes: Axes) -> None:
        elements, data = quantity.elements, quantity.data
        few, handles, labels, floor = quantity, [], [], _floor(data.high) if log else -np.inf
        if len(elements) > MOST:
            few = quantity.only(quantity.largest_columns(MOST - 1))
            top = np.max(np.nan_to_num(np.maximum(np.abs(data.low), np.abs(data.high))), axis=1)
            handles = axes.plot(data.time, np.maximum(top, floor), color=INK, linewidth=2.2, alpha=0.45)
            labels = [f"largest of {len(elements)}"]
        chart = element_chart("", "", "", Axis(quantity.name, quantity.unit, log), few)
        if log:
            chart = replace(chart, lines=tuple(replace(line, y=np.maximum(line.y, floor)) for line in chart.lines))
        heading = title
        if not elements:
            heading = f"{quantity.name}: there are no {what}"
        elif not title:
            column, most = quantity.largest
            heading = f"{quantity.name}: largest {_with_error(quantity, column, most)} ({elements[column]})"
        handles += draw_lines(axes, chart, heading)
        axes.margins(x=0.01)
        axes.set_ylabel(f"{quantity.name}\n[{quantity.unit}]")
        legend(axes, handles, [*labels, *few.elements])
        if log:
            _show_floor(axes, floor, data.high, quantity.unit)
        elif elements:
            powers_of_ten(axes)
            if np.nanmin(data.low, initial=0.0) >= 0.0:
                axes.set_ylim(bottom=0.0)

    return Panel(draw, height)


def _with_error(quantity: ElementQuantity, column: int, largest: float) -> str:
    """Return the largest value of an element with its estimated error, such as ``368.2 ± 0.3 N``; without an error if
    no errors were estimated.
    """
    if quantity.peak_errors is None or not np.isfinite(largest):
        return value_text(largest, quantity.unit)
    error = float(quantity.peak_errors[column])
    if not np.isfinite(error) or np.isfinite(quantity.known_until):
        return f"{value_text(largest, quantity.unit)}, error unknown"
    return f"{plus_minus(largest, error, '±')} {quantity.unit}"


def value_text(value: float, unit: str) -> str:
    """Return a value with its unit, or ``not finite``."""
    return f"{value:.3g} {unit}" if np.isfinite(value) else "not finite"


def _floor(values: Array) -> float:
    """Return the largest power of ten below 99.5 % of the positive values, but at least `SMALLEST`."""
    positive = values[values > 0]
    if not positive.size:
        return SMALLEST
    return float(max(SMALLEST, 10.0 ** np.floor(np.log10(np.quantile(positive, 0.005)))))


def _show_floor(axes: Axes, floor: float, values: Array, unit: str) -> None:
    """Set the limits of a logarithmic axis. If values below `floor` are drawn at `floor`, add a note that says so."""
    top = float(np.nanmax(values, initial=0.0))
    axes.set_ylim(floor * 0.8, max(top * 2.0, floor * 10.0))
    if np.any(values < floor):
        axes.text(
            0.995, 0.02, f"values below {floor:.0e} {unit} are drawn there", transform=axes.transAxes,
            size=7.5, color=FAINT, ha="right", va="bottom",
            bbox={"facecolor": PAPER, "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
        )  # fmt: skip
