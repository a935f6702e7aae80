"""A quantity of every joint or force element over time, with estimated errors, as a chart."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import h5py
import numpy as np

from mbdkit.archive.headlines import answers
from mbdkit.archive.run import Run
from mbdkit.archive.run_views import Gap, Names
from mbdkit_report.figures.beam_curves import distributed_loads
from mbdkit_report.figures.curves import UNKNOWN, Array, Bands, band_over_time, bands, errors_at
from mbdkit_report.figures.page_model import TIME, Axis, Line, Mark
from mbdkit_report.figures.palette import PALETTE
from mbdkit_report.plot.charts import HeadedChart, named

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
    largest_texts
        Largest value of each element with its bar as text, and its id; None for elements without, and empty if there
        are none.
    """

    name: str
    unit: str
    elements: Sequence[str]
    data: Bands
    errors: Array | None = None
    known_until: float = math.nan
    largest_texts: Sequence[tuple[str, str] | None] = ()

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
        elements, errors = [self.elements[column] for column in columns], self.errors
        texts = [self.largest_texts[column] for column in columns] if self.largest_texts else ()
        errors = None if errors is None else errors[..., columns]
        return replace(self, elements=elements, data=self.data.only(columns), errors=errors, largest_texts=texts)

    @property
    def heading(self) -> tuple[str, str]:
        """The largest value of all elements with its bar, as text for a title, and its id; the id is empty if the value
        has no bar.
        """
        column, size = self.largest
        stated = self.largest_texts[column] if self.largest_texts and np.isfinite(size) else None
        text, key = stated or (value_text(size, self.unit), "")
        return f"{self.name}: largest {text} ({self.elements[column]})", key


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
    if run.accuracy is not None and acting:
        every = np.column_stack([np.full((len(time), len(forces)), np.nan), run.array("actuators/value_error")])
        texts = [*[None] * len(forces), *_largest_texts(run, "actuators.value", [one.name for one in acting])]
        quantity = replace(quantity, errors=errors_at(run.accuracy, every, quantity.data.time), largest_texts=texts)
    return quantity.only(columns)


def _largest_texts(run: Run, quantity: str, names: Sequence[str]) -> list[tuple[str, str] | None]:
    """Return the largest values of elements with their bars as texts, and their ids; None for those that are zero."""
    known = {one.element: one for one in answers(run) if one.quantity == quantity and np.isnan(one.until)}
    return [(known[name].text("±"), known[name].id) if name in known else None for name in names]


def _reaction(run: Run, word: str, unit: str, error: str, values: Callable[[Array], Array]) -> ElementQuantity:
    """Return a reaction of all joints, a ``force`` or ``torque``.

    Parameters
    ----------
    error
        Attribute of `Accuracy` with its estimated errors.
    values
        Function that maps a block of rows to one value for each row and joint.
    """
    curves = bands(np.asarray(run.time), run.dataset(f"joints/reaction_{word}"), values)
    texts = _largest_texts(run, f"joints.{word}", run.joint_names)
    name = "reaction force" if run.errors.force_in == "force in" else run.errors.force_in.removesuffix(" in")
    name = name if word == "force" else f"reaction {word}"
    return with_errors(run, ElementQuantity(name, unit, run.joint_names, curves, largest_texts=texts), error)


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
    if (accuracy := run.accuracy) is None:
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
) -> HeadedChart:
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
    headline = quantity.heading if quantity.elements else ("", "")
    return HeadedChart(name, title, caption, TIME, axis, tuple(lines), marks=marks, headline=headline)


def value_text(value: float, unit: str) -> str:
    """Return a value with its unit, or ``not finite``."""
    return f"{value:.3g} {unit}" if np.isfinite(value) else "not finite"
