"""Headlines, the main numbers of a run: its measures or, if it has none, its largest forces, torques and
activations.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from mbdkit.archive.peak_errors import measures_of_largest
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.feature_items import HeadlineItem
from mbdkit.registry.manager import registry, use
from mbdkit.registry.seam import Seam

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

MOST = 5  #: Number of headlines of a run.

MOST_DIGITS = 10  #: Largest number of significant digits of a number with an error.

DIGITS_ALONE = 6  #: Number of significant digits of a number whose error was not estimated.

#: The value between recorded rows is printed if the number misses more than this share of it: with a known error, and
#: without one.
MISSED, NEGLIGIBLE = 0.01, 1e-5

#: Numbers are printed without an exponent if the power of ten of their first digit is in this range.
SMALLEST_PLACE, LARGEST_PLACE = -3, 8

#: Values up to this share of the largest value of their kind count as zero. Torques of drivers [N m] also count as zero
#: up to this share of the largest force in a joint [N].
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


class Headline(NamedTuple):
    """A number of a run with its unit and its estimated error, which is nan if unknown.

    `missed` is by how much the value between recorded rows exceeds the number; nan if rows skip steps and the value
    between them is unknown. It is a part of the error.
    """

    label: str
    value: float
    unit: str
    error: float = math.nan
    missed: float = 0.0
    element: str = ""
    time: float = math.nan
    """Time of the recorded row with the number [s]."""
    is_checked: bool = False
    """Whether the errors of the run were estimated, so that an unknown error is stated."""
    is_at_end: bool = False
    """Whether the number is that at the end of the run, so that a longer run may exceed it."""
    is_unique: bool = True
    """Whether the motion determines the number; otherwise it is one of the possible reactions of redundant joints."""

    @property
    def largest(self) -> float:
        """The number, or the larger value between rows if it is known."""
        return self.value if math.isnan(self.missed) else self.value + self.missed

    @property
    def misses(self) -> bool:
        """Whether the value between rows is known, and clearly larger than the number."""
        return self.missed > (NEGLIGIBLE if math.isnan(self.error) else MISSED) * abs(self.largest)

    def text(self, sign: str = "+-") -> str:
        """Return the number with the digits that its error justifies, its error and its unit.

        The number is the largest value between recorded rows if that is known; if it is clearly larger than the value
        in the rows, the text has both. If it is unknown, the text says that the number is that of the rows.
        """
        if not self.is_unique:
            return f"{self.largest:.4g} {self._unit}".rstrip() + NOT_UNIQUE
        if math.isnan(self.missed):
            return self._with_error(self.value, self.error, sign) + " in the recorded rows"
        between = self._with_error(self.largest, self.error - self.missed, sign)
        if self.misses:
            return f"{self.value:.4g} {self._unit}".rstrip() + f" in the recorded rows, {between} between them"
        return between

    def answer(self, sign: str = "+-") -> str:
        """Return `text`, and say if the number is that at the end of the run."""
        return self.text(sign) + (" at the end of the run" if self.is_at_end else "")

    @property
    def _unit(self) -> str:
        return self.unit.removesuffix("1")

    def _with_error(self, value: float, error: float, sign: str) -> str:
        if not math.isnan(error):
            return f"{plus_minus(value, error, sign)} {self._unit}".rstrip()
        if self.is_checked:
            return f"{value:.4g} {self._unit}".rstrip() + " (error unknown)"
        return f"{value:.{DIGITS_ALONE}g} {self._unit}".rstrip()


@Seam
def run_headlines(run: Run, /) -> Iterable[Headline]:
    """Return headlines of a run, the most important first."""
    raise NotImplementedError


@Seam
def excluded_words(run: Run, /) -> str:
    """Return what the error bars of a run do not include, as words that follow "without"; empty if they include all."""
    raise NotImplementedError


def plus_minus(value: float, error: float, sign: str = "+-", digits: int = MOST_DIGITS) -> str:
    """Return a value and its error as text, such as ``368.2 +- 0.3``.

    The value is rounded to the place of the error's first digit. If the error is 10 or more and the value is printed
    without an exponent, it is rounded to the place of the error's second digit, as in ``3600 +- 210``. A value that is
    smaller than its error keeps as many digits of its own, as in ``430 +- 1800``, so that it is not rounded to zero.
    If the value has too few digits for its error, the error is half a unit of its last digit, which is what rounding
    may change. A value without an error is exact. A value that is not finite has no known error.

    `value`, `error`: the value and its error, in the same unit; an error that is nan is unknown. `sign`: sign between
    the value and the error. `digits`: largest number of significant digits of the value.
    """
    if not (math.isfinite(value) and math.isfinite(error)):
        return f"{value:.4g} (error unknown)"
    if error <= 0:
        return f"{value:.{digits}g}"
    of_error = math.floor(math.log10(error))
    own = math.floor(math.log10(abs(value))) if value else of_error
    first = max(own, of_error)
    error = max(error, 0.5 * 10.0 ** (first - digits + 1)) if of_error < first - digits + 1 else error
    if has_exponent(first):
        return f"{value:.{min(first - of_error, digits - 1)}e} {sign} {error:.2g}"
    last = max(min(own, of_error), first - digits + 1)
    last -= of_error > 0 or last > 0
    error_text = f"{round(error, 1 - of_error):.0f}" if of_error > 0 else f"{error:.2g}"
    return f"{round(value, -last):.{max(0, -last)}f} {sign} {error_text}"


def has_exponent(place: int) -> bool:
    """Return whether numbers whose first digit has this power of ten are printed with an exponent."""
    return not SMALLEST_PLACE <= place <= LARGEST_PLACE


def headlines(run: Run, most: int = MOST) -> list[Headline]:
    """Return up to `most` headlines of a run that has rows, the most important first."""
    if not len(run.time):
        return []
    measured = [
        Headline(name, value, run.measures.units[name], run.measure_errors[name])
        for name, value in run.measures.items()
        if math.isfinite(value)
    ]
    return (measured or [*_added(run), *largest_loads(run)])[:most]


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
    return list(run_headlines.of(cast(HeadlineItem, item.plugin).take)(run))


def headline_texts(run: Run, sign: str = "+-", *, all_measures: bool = False) -> list[tuple[str, str]]:
    """Return label and text of up to `MOST` headlines, or of all measures. If any has an error bar, and the error bars
    do not include an error such as that of the mesh of beams, a last pair says so.

    `sign`: sign between a number and its error.
    """
    every = headlines(run, max(MOST, len(run.measures)) if all_measures else MOST)
    pairs = [(headline.label, headline.answer(sign)) for headline in every]
    if (excluded := run.errors.excluded) and any(math.isfinite(headline.error) for headline in every):
        pairs.append(("error bars", f"without {excluded}"))
    return pairs


def is_at_end(values: np.ndarray) -> bool:
    """Return whether the largest of the values (T,) of a run is that at its end, so that a longer run may exceed it."""
    rise, most = values[-1] - values[0], np.max(np.abs(values))
    is_clear = rise > max(AT_END * np.ptp(values), LEAST_RISE * most)
    return bool(is_clear and np.argmax(values) == len(values) - 1)


def largest_loads(run: Run) -> list[Headline]:
    """Return the largest torque of each driver and then the largest force of each joint, both in descending order.

    Values that count as zero are left out.
    """
    forces = largest_forces(run)
    floor = ROUND_OFF * max((headline.largest for headline in forces), default=0.0)
    of_drivers = [torque for torque in largest_torques(run) if torque.element in run.drivers] if run.drivers else []
    return [*(headline for headline in of_drivers if headline.largest > floor), *forces]


def largest_forces(run: Run) -> list[Headline]:
    """Return the largest force of each joint in descending order, without those that count as zero."""
    if not run.joint_names or not run.records("joints/reaction_force"):
        return []
    vectors = run.array("joints/reaction_force")
    force = np.hypot(vectors[..., 0], vectors[..., 1])  # does not overflow after a motion that flew apart
    errors = _errors(run, "reaction_error", force)
    missed = run.errors.missed("joints.force", run.joint_names, force)
    return _as_measured(
        run, "joints.force", largest_of(run.errors.force_in, run, run.joint_names, force, "N", errors, missed)
    )


def largest_torques(run: Run) -> list[Headline]:
    """Return the largest torque of each joint in descending order, without those that count as zero."""
    if not run.joint_names or not run.records("joints/reaction_torque"):
        return []
    torque = np.abs(run.array("joints/reaction_torque"))
    errors = _errors(run, "torque_error", torque)
    missed = run.errors.missed("joints.torque", run.joint_names, torque)
    torques = largest_of("torque of", run, run.joint_names, torque, "N m", errors, missed)
    return _as_measured(run, "joints.torque", torques)


def _as_measured(run: Run, quantity: str, found: list[Headline]) -> list[Headline]:
    """Return headlines in which a number that is also a measure does not depend on rows."""
    known = measures_of_largest(run.spec.get("measures") or {}, quantity, run.joint_names).keys() & {
        headline.element for headline in found if math.isfinite(headline.error) and math.isfinite(headline.missed)
    }
    return [
        headline._replace(value=headline.largest, error=headline.error - headline.missed, missed=0.0)
        if headline.element in known
        else headline
        for headline in found
    ]


def _errors(run: Run, name: str, size: np.ndarray) -> np.ndarray | None:
    is_known = run.accuracy is not None and run.accuracy.is_complete
    return run.errors.of_reactions(name, size) if is_known else None


def largest_of(
    words: str,
    run: Run,
    names: list[str] | tuple[str, ...],
    size: np.ndarray,
    unit: str,
    errors: np.ndarray | None,
    missed: np.ndarray | None = None,
) -> list[Headline]:
    """Return the largest value of each element, from values `size` (T, J), with its error, in descending order.

    `missed` (J,) is by how much the values between rows exceed them, nan where unknown; None if every step is recorded.

    Values that count as zero are left out.
    """
    rows, is_integrated = _peak_rows(size), run.spec_kind.is_integrated
    shared = not_unique(run) if names is run.joint_names else frozenset()
    beyond = np.zeros(len(rows)) if missed is None else missed
    headlines = []
    for column, row in enumerate(rows):
        error = math.nan if errors is None else float(errors[column])
        label = f"largest {words} {names[column]}" if words else names[column]
        value, at, is_checked = float(size[row, column]), float(run.time[row]), run.accuracy is not None
        ends = is_integrated and row == len(size) - 1 and is_at_end(size[:, column])
        name = names[column]
        error, extra = (error, float(beyond[column])) if name not in shared else (math.nan, 0.0)
        headlines.append(Headline(label, value, unit, error, extra, name, at, is_checked, ends, name not in shared))
    most = max((headline.largest for headline in headlines), default=0.0)
    return sorted(
        (headline for headline in headlines if headline.largest > ROUND_OFF * most), key=lambda one: -one.largest
    )


def _peak_rows(size: np.ndarray) -> np.ndarray:
    return np.argmax(np.nan_to_num(size), axis=0) if size.size else np.zeros(0, int)
