"""Headlines, the main numbers of a run: its measures or, if it has none, its largest forces, torques and
activations. `answers` returns all numbers with error bars, from which every summary, report, plot and archive takes
them, so that a number has one value and one bar.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple, cast

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.hdf5 import set_text
from mbdkit.archive.peak_errors import NEGLIGIBLE, expression_of_largest
from mbdkit.archive.run import Run
from mbdkit.base.errors import PluginError
from mbdkit.base.logs import logger_of
from mbdkit.base.plain_data import json_text
from mbdkit.base.text import Bar, plus_minus
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.feature_items import HeadlineItem
from mbdkit.registry.manager import registry, use
from mbdkit.registry.seam import Seam

MOST = 5  #: Number of headlines of a run.

DIGITS_ALONE = 6  #: Number of significant digits of a number whose error was not estimated.

#: The largest recorded value is printed too if it is smaller by this share; without a known error, by `NEGLIGIBLE`.
MISSED = 0.01

#: Values up to this share of the largest value of their kind count as zero. Torques of drivers [N m] also count as zero
#: up to this share of the largest force in a joint [N], and forces up to this share of torques by the characteristic
#: length.
ROUND_OFF = 1e-10

#: Largest number of joints or other elements that one line lists; the rest are only counted.
JOINTS_NAMED = 4

#: A text says that a largest value is that at the end of a run if it exceeds the value at the start by more than the
#: first share of the range of the quantity, and the second one of its largest magnitude.
#:
#: At the end of a period, the values at start and end are equal, and in equilibrium almost so.
AT_END, LEAST_RISE = 0.01, 1e-3

NOT_UNIQUE = " (not unique, of least norm)"

MESH_ERROR = "the error of the mesh of beams"  #: What error bars of runs with beams do not include.

#: Residuals [m or rad], overlaps [m] and creep [m/s] up to this value are rounding errors.
EXACT = 1e-12

#: Unit of the loads of joints, and the attribute of `Accuracy` with their errors.
LOADS = {"force": ("N", "reaction_error"), "torque": ("N m", "torque_error")}


class Headline(NamedTuple):
    """A number of a run with its unit and its bar.

    A largest value is that between recorded rows, too, if it is known.
    """

    label: str
    value: float
    unit: str
    bar: Bar = Bar()
    id: str = ""  #: Identifier, the same in every output: the expression of a largest value, or the name of a measure.
    recorded: float = math.nan  #: Largest value in the recorded rows; nan if the number is not a largest value.
    #: Whether the largest value between recorded rows is unknown, so that the number is that of the rows.
    is_of_rows: bool = False
    quantity: str = ""
    element: str = ""  #: Quantity and element of a largest value, such as ``joints.force``.
    time: float = math.nan  #: Time of the recorded row with the largest value [s].
    is_checked: bool = False  #: Whether the errors of the run were estimated, so that an unknown error is stated.
    is_at_end: bool = False  #: Whether the number is that at the end of the run, so that a longer run may exceed it.
    #: Whether the motion determines the number; otherwise it is one of the possible reactions of redundant joints.
    is_unique: bool = True
    by_parameters: float = math.nan  #: A further bar, by the estimates of parameters; nan without.
    until: float = math.nan  #: Time until which the number is the largest value [s]; nan if that is the end of the run.
    is_main: bool = True  #: Whether the number is one of the headlines if the run has no measures.

    @property
    def misses(self) -> bool:
        """Whether the number is clearly larger than the largest recorded value."""
        return self.value - self.recorded > (MISSED if self.bar.is_known else NEGLIGIBLE) * abs(self.value)

    def text(self, sign: str = "+-") -> str:
        """Return the number with the digits that its bar justifies, its bar and its unit.

        If the largest recorded value is clearly smaller, the text has both. If the value between rows is unknown, the
        text says that the number is that of the rows.
        """
        if not self.is_unique:
            return self._with_unit(f"{self.value:.4g}") + NOT_UNIQUE
        text = self._with_unit(self.number(sign))
        if self.is_checked and not self.bar.is_known:
            text = self._with_unit(f"{self.value:.4g}") + " (error unknown)"
        if self.is_of_rows:
            text += " in the recorded rows"
        elif self.misses:
            text = f"{self._with_unit(f'{self.recorded:.4g}')} in the recorded rows, {text} between them"
        if not math.isnan(self.by_parameters):
            text += self._with_unit(f", and {sign} {self.by_parameters:.2g}") + " by parameters"
        return text

    def number(self, sign: str = "+-") -> str:
        """Return the number and its bar, without unit."""
        return plus_minus(self.value, self.bar, sign) if self.bar.is_known else f"{self.value:.{DIGITS_ALONE}g}"

    def answer(self, sign: str = "+-") -> str:
        """Return `text`, and say if the number is that at the end of the run."""
        return self.text(sign) + (" at the end of the run" if self.is_at_end else "")

    def to_dict(self) -> dict[str, Any]:
        """Return the number, its bar and its text; numbers that are unknown are nan, or left out."""
        found = {"id": self.id, "label": self.label, "value": self.value, "unit": self.unit}
        found |= {"lower": self.bar.lower, "upper": self.bar.upper, "text": self.text()}
        return found if math.isnan(self.by_parameters) else {**found, "by_parameters": self.by_parameters}

    def _with_unit(self, number: str) -> str:
        return f"{number} {self.unit.removesuffix('1')}".rstrip()


@Seam
def run_headlines(run: Run, /) -> Iterable[Any]:
    """Return numbers of a run with their bars, the most important first: headlines, or mappings with their attributes
    ``label``, ``value``, ``unit``, ``bar`` (lower and upper end, nan where unknown) and ``id``, and others. Those with
    ``is_main: False`` are no headlines, but have an id.
    """
    raise NotImplementedError


@Seam
def excluded_words(run: Run, /) -> str:
    """Return what the error bars of a run do not include, as words that follow "without"; empty if they include all."""
    raise NotImplementedError


def answers(run: Run) -> list[Headline]:
    """Return all numbers of a run that has rows which may have bars: measures and their derivatives, numbers of
    plugins, and the largest loads of joints; each once.
    """
    if not len(run.time):
        return []
    every = [*measured(run), *_derivatives(run), *_added(run)]
    every += [*largest_loads(run), *joint_loads(run, "torque"), *known_loads(run, "force"), *known_loads(run, "torque")]
    return list({one.id: one for one in reversed(every)}.values())[::-1]


def write_answers(file: h5py.File) -> None:
    """Write the root attribute ``answers`` of an archive that is otherwise complete."""
    try:
        found = [answer.to_dict() for answer in answers(Run(file))]
    except PluginError as error:  # the results are not affected
        logger_of(__name__).warning("answers are not stored: %s", error)
    else:
        set_text(file, layout.ANSWERS, json_text(found))


def headlines(run: Run, most: int = MOST) -> list[Headline]:
    """Return up to `most` headlines of a run that has rows, the most important first."""
    if not len(run.time):
        return []
    known = [one for one in measured(run) if math.isfinite(one.value)]
    return (known or [*(one for one in _added(run) if one.is_main), *largest_loads(run)])[:most]


def measured(run: Run) -> list[Headline]:
    """Return the measures of a run; the value of a measure that could not be computed is nan."""
    units, own = run.measures.units, run.measures.parameter_errors
    return [
        Headline(
            name, value, units[name], Bar.even(run.measure_errors[name]), f"measures.{name}", by_parameters=own[name]
        )
        for name, value in run.measures.items()
    ]


def _derivatives(run: Run) -> list[Headline]:
    made = []
    for measure, gradient in run.gradients.items():
        known = {name: error for name, error in gradient.get("errors", {}).items() if error is not None}
        for parameter, value in gradient.get("derivatives", {}).items():
            if value is not None:
                bar = Bar.even(known.get(parameter, math.nan))
                made.append(Headline(parameter, value, "", bar, f"d({measure})/d({parameter})", is_checked=True))
    return made


def not_unique(run: Run) -> frozenset[str]:
    """Return the joints whose reactions the motion does not determine, because joints are redundant."""
    if not run.redundancy or not run.records("joints/reaction_force"):
        return frozenset()
    listed = f", {run.file['joints/reaction_force'].attrs.get('not_unique', '')}, "
    return frozenset(name for name in run.joint_names if f", {name}, " in listed)


def _added(run: Run) -> list[Headline]:
    return [headline for item in headline_items(run) for headline in use(item, partial(_taken, item, run))]


def headline_items(run: Run) -> list[Registered]:
    """Return the items of headlines whose groups a run has."""
    return [item for item in registry().of_kind("headline") if cast(HeadlineItem, item.plugin).group in run.kinds]


def _taken(item: Registered, run: Run) -> list[Headline]:
    taken = run_headlines.of(cast(HeadlineItem, item.plugin).take)(run)
    made = [one if isinstance(one, Headline) else Headline(**one) for one in taken]
    return [one._replace(bar=Bar(*one.bar)) for one in made]


def headline_texts(run: Run, sign: str = "+-", *, all_measures: bool = False) -> list[tuple[str, str, str]]:
    """Return label, text and id of up to `MOST` headlines, or of all measures. If any has an error bar, and the error
    bars do not include an error such as that of the mesh of beams, a last entry says so.

    `sign`: sign between a number and its error.
    """
    every = headlines(run, max(MOST, len(run.measures)) if all_measures else MOST)
    texts = [(headline.label, headline.answer(sign), headline.id) for headline in every]
    if (excluded := run.errors.excluded) and any(headline.bar.is_known for headline in every):
        texts.append(("error bars", f"without {excluded}", ""))
    return texts


def is_at_end(values: np.ndarray) -> bool:
    """Return whether the largest of the values (T,) of a run is that at its end, so that a longer run may exceed it."""
    rise, most = values[-1] - values[0], np.max(np.abs(values))
    is_clear = rise > max(AT_END * np.ptp(values), LEAST_RISE * most)
    return bool(is_clear and np.argmax(values) == len(values) - 1)


def largest_loads(run: Run) -> list[Headline]:
    """Return the largest torque of each driver and then the largest force of each joint, both in descending order.

    Values that count as zero are left out.
    """
    forces = joint_loads(run, "force")
    floor = ROUND_OFF * max((headline.value for headline in forces), default=0.0)
    torques = joint_loads(run, "torque") if run.drivers else []
    return [*(one for one in torques if one.element in run.drivers and one.value > floor), *forces]


def joint_loads(run: Run, kind: str) -> list[Headline]:
    """Return the largest load of each joint, a ``force`` or ``torque``, in descending order, without those that count
    as zero; none if these were not recorded.
    """
    size, accuracy, (unit, errors) = _sizes(run, kind), run.accuracy, LOADS[kind]
    if size is None:
        return []
    known = getattr(accuracy, errors) if accuracy is not None and accuracy.is_complete else None
    return largest_of(_words(run, kind), run, f"joints.{kind}", run.joint_names, size, unit, known)


def known_loads(run: Run, kind: str) -> list[Headline]:
    """Return the largest loads of joints until the time until which errors are known, as `joint_loads` does; none if
    all errors are known, or none.
    """
    size, accuracy, (unit, errors) = _sizes(run, kind), run.accuracy, LOADS[kind]
    if size is None or accuracy is None or accuracy.is_complete or (count := accuracy.rows_known) < 2:
        return []
    known, until = getattr(accuracy, errors)[:count], accuracy.known_until
    found = largest_of(_words(run, kind), run, f"joints.{kind}", run.joint_names, size[:count], unit, known)
    return [one._replace(id=f"{one.id} until {until:.4g} s", is_at_end=False, until=until) for one in found]


def _words(run: Run, kind: str) -> str:
    return f"largest {run.errors.force_in}" if kind == "force" else "largest torque of"


def _sizes(run: Run, kind: str) -> np.ndarray | None:
    """Return the magnitudes (T, J) of the loads of joints; None if they were not recorded."""
    path = f"joints/reaction_{kind}"
    if not run.joint_names or not run.records(path):
        return None
    values = run.array(path)
    # unlike a norm, `hypot` does not overflow after a motion that flew apart
    return np.asarray(np.abs(values) if kind == "torque" else np.hypot(values[..., 0], values[..., 1]))


def largest_of(
    words: str, run: Run, quantity: str, names: Sequence[str], size: np.ndarray, unit: str, errors: np.ndarray | None
) -> list[Headline]:
    """Return the largest value of each element with its bar, in descending order, without those that count as zero.

    `words`: words before the name of the element in the label. `quantity`: quantity of the elements, such as
    ``joints.force``. `size`, `errors`: (T, E) values in the rows, and their errors; see `RunErrors.of_largest`.
    """
    rows = np.argmax(np.nan_to_num(size), axis=0) if size.size else np.zeros(0, int)
    largest = run.errors.of_largest(quantity, names, size, errors)
    shared = not_unique(run) if names is run.joint_names else frozenset()
    headlines = []
    for column, (name, row) in enumerate(zip(names, rows.tolist(), strict=True)):
        ends = run.spec_kind.is_integrated and row == len(size) - 1 and is_at_end(size[:, column])
        is_unique = name not in shared
        values = largest.recorded[column], largest.value[column]
        made = Headline(
            f"{words} {name}", float(values[int(is_unique)]), unit,
            Bar(*largest.bars[column].tolist()) if is_unique else Bar(), expression_of_largest(quantity, name),
            float(values[0]), bool(largest.is_of_rows[column]), quantity, name, float(run.time[row]),
            run.accuracy is not None, is_unique=is_unique,
        )  # fmt: skip
        headlines.append(made._replace(is_at_end=ends and not made.misses))
    floor = ROUND_OFF * max((headline.value for headline in headlines), default=0.0)
    return sorted((headline for headline in headlines if headline.value > floor), key=lambda one: -one.value)
