"""A table of measured data, whose cells are converted to numbers when a column is used; measured angles, which may jump
by full turns, become continuous functions of time.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TypeAlias

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.text import did_you_mean, listed, shortened, shown
from mbdkit.base.units import Unit, read_quantity, read_unit

#: Texts, in lower case, of cells without a value.
GAPS = (
    *("", "nan", "-nan", "na", "n/a", "#n/a", "<na>", "n.a.", "null", "none", "-", "--"),
    *("nan(ind)", "-nan(ind)", "1.#qnan", "1.#ind", "-1.#ind"),
)

HEADINGS_SHOWN = 30
Cell: TypeAlias = str | float | None  #: A cell of a table: text of a file, a number, or nothing.


#: If the interval between samples is longer than this [s], messages name a wrong unit of time as a possible cause.
SLOW = 0.1


def unit_of_time_as_cause(interval: float) -> str:
    """Return clauses on the unit of time, for the end of a message, if an interval [s] between samples is long."""
    cause = "; if the times are in milliseconds, write `time: {column: NAME, unit: ms}`" if interval > SLOW else ""
    if round(interval, 9) == 1.0:
        cause += "; if they are numbers of frames, divide them by the frame rate"
    return cause


@dataclass(frozen=True)
class MeasuredTable:
    """A table of numbers, whose cells are converted when a column is used.

    Parameters
    ----------
    file
        Name of the file, for messages; empty for data from Python.
    headings
        Headings of the columns.
    cells
        Rows of cells, each a text or a number; None is a gap.
    lines
        Number of the line of each row in the file; empty if the format has no lines.
    units
        Units that the file states, by heading.
    in_degrees
        Whether the file states that rotations are in degrees, without naming their columns.
    remark
        Contents of the file that could not be read, as a clause for messages; empty if nothing is missing.
    full_headings
        Headings with their units, such as ``hip [deg]``, of columns whose headings are given without units.
    """

    file: str
    headings: Sequence[str]
    cells: Sequence[Sequence[Cell]]
    lines: Sequence[int] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    in_degrees: bool = False
    remark: str = ""
    full_headings: Sequence[str] = ()
    _place: dict[str, int] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        for index, heading in enumerate(self.headings):
            self._place[heading] = index
        for index, heading in enumerate(self.full_headings):
            self._place.setdefault(heading, index)
        for index, heading in enumerate(self.headings):  # some formats, such as .trc, write `Time`
            if heading.lower() == "time":
                self._place.setdefault("time", index)
        without_subject = [heading.rpartition(":")[2] for heading in self.headings]
        for index, heading in enumerate(without_subject):  # Vicon names markers Subject:LKNE
            if heading not in self._place and without_subject.count(heading) == 1:
                self._place[heading] = index

    def __len__(self) -> int:
        return len(self.cells)

    @property
    def name(self) -> str:
        """Name of the table in messages."""
        return Path(self.file).name if self.file else "the data"

    def error(self, message: str, *, row: int | None = None, key: str = "") -> SpecError:
        """Return an error about this table, or about one of its rows."""
        line = self.lines[row] if row is not None and row < len(self.lines) else None
        where = f"row {row + 1}: " if row is not None and line is None else ""
        return SpecError(f"{where}{message}", key=key, file=self.file or None, line=line)

    def resolved(self, headings: Iterable[str]) -> set[str]:
        """Return the headings, as in the table, of the columns to which other headings may refer, such as those without
        a subject; headings without a column are left out.
        """
        return {self.headings[self._place[heading]] for heading in headings if heading in self._place}

    def unit(self, heading: str) -> str | None:
        """Return the unit that the file states for a column; None if it states none."""
        place = self._place.get(heading)
        return None if place is None else self.units.get(self.headings[place])

    @property
    def force_hint(self) -> str:
        """Clause on how to name the columns of a file of forces of OpenSim; empty for other tables."""
        start = next((name[:-2] for name in self.headings if name.endswith("ground_force_vx")), "")
        force, point = (f"[{start}{kind}x, {start}{kind}y]" for kind in "vp")
        keys = f"`force: {force}, point: {point}`"
        return f"; for forces of OpenSim, a load has {keys}; `plates` are of C3D files" if start else ""

    def column(self, heading: str, key: str) -> np.ndarray:
        """Return the numbers of a column, (T,); gaps are nan.

        Parameters
        ----------
        key
            Key of the spec that names the column, for messages.

        Raises
        ------
        SpecError
            If there is no such column, or a cell is not a number.
        """
        if (place := self._place.get(heading)) is None:
            names = [cited(name) for name in self.headings if name]
            some = listed(names[:HEADINGS_SHOWN]) + (", ..." if len(names) > HEADINGS_SHOWN else "")
            hint = did_you_mean(heading, names) or f"; its columns: {some}"
            remark = f" ({self.remark})" if self.remark else ""
            if heading == "time" and names:
                remark += f"; name the column with the times in `{key}`, such as `time: {names[0]}`"
            remark += self.force_hint
            with suppress(SpecError):  # a text that is almost a number with a unit
                if quantity := read_quantity(heading):
                    remark += f"; for a constant, give the number in SI units without its unit: {quantity[0]:.6g}"
            raise SpecError(f"{self.name} has no column '{cited(heading)}'{hint}{remark}", key=key)
        if self.headings.count(self.headings[place]) > 1:
            raise self.error(f"two columns have the heading '{cited(heading)}'")
        with suppress(IndexError, TypeError, ValueError):  # if there are gaps, or cells that are not numbers
            texts = [cells[place] for cells in self.cells]
            values = np.array([float(text) for text in texts])  # type: ignore[arg-type]  # None raises TypeError
            if all(map(_is_plain, texts)) and not np.any(np.isinf(values)):
                return values
        cells = (cells[place] if place < len(cells) else None for cells in self.cells)
        return np.array([self._number(cell, row, heading) for row, cell in enumerate(cells)])

    def _number(self, cell: Cell, row: int, heading: str) -> float:
        if cell is None:
            return math.nan
        if isinstance(cell, str):
            text = cell.strip()
            if text.lower() in GAPS:
                return math.nan
            try:
                if not _is_plain(text):
                    raise ValueError
                cell = float(text)
            except ValueError:
                message = f"column '{cited(heading)}': {cited(text)!r} is not a number{self._hint(text, row)}"
                raise self.error(message, row=row) from None
        if math.isinf(cell):
            raise self.error(f"column '{cited(heading)}': {cell} is not a finite number", row=row)
        return float(cell)

    def _hint(self, text: str, row: int) -> str:
        """Return how to change a file so that this text is not among the numbers."""
        if DECIMAL_COMMA.fullmatch(text):
            return (
                "; decimal commas are read only in tables whose cells are separated by semicolons or tabs and which "
                "have no decimal points, so replace them by points"
            )
        if row == 0 and len(self) > 1 and self.lines and not any(map(begins_like_number, self.cells[0])):
            return (
                "; if this row belongs to the headings, begin it with # (a comment) or delete it; a row of units, such "
                "as s, deg and mm, is read, but this one has none that is known"
            )
        if self.lines and not begins_like_number(text):
            return "; write nan for a missing value, and delete lines below the headings that are not rows of the table"
        return ""

    def times(self, heading: str, key: str, factor: float) -> np.ndarray:
        """Return the times in a column, (T,) [s].

        Parameters
        ----------
        factor
            Factor from the numbers of the column to seconds.

        Raises
        ------
        SpecError
            If there is no such column, a time is missing, or times do not increase.
        """
        place = self._place.get(heading)
        texts = [str(cells[place]).strip() for cells in self.cells if place is not None and place < len(cells)]
        is_clock = len(texts) == len(self.cells) and any(map(CLOCK.fullmatch, texts))
        values = self._clock_times(heading, texts) if is_clock else factor * self.column(heading, key)
        if not len(values):
            raise self.error("this table has no rows")
        if (missing := np.flatnonzero(np.isnan(values))).size:
            raise self.error(f"column '{cited(heading)}': the time is missing", row=int(missing[0]))
        if (back := np.flatnonzero(np.diff(values) <= 0)).size:
            row = int(back[0]) + 1
            raise self.error(
                f"column '{cited(heading)}': times should increase, but {values[row]:.10g} s follows "
                f"{values[row - 1]:.10g} s",
                row=row,
            )
        return values

    def _clock_times(self, heading: str, texts: Sequence[str]) -> np.ndarray:
        """Return the seconds (T,) of clock times since midnight, or since 1970 (UTC, if no other zone is given)."""
        values = np.empty(len(texts))
        for row, text in enumerate(texts):
            match = CLOCK.fullmatch(text)
            try:
                assert match is not None
                date, hour, minute, second, zone = match.groups()
                day = datetime.fromisoformat(f"{(date or '1970-01-01').strip(' T')}T00:00:00{zone or '+00:00'}")
                values[row] = day.timestamp() + 3600 * int(hour) + 60 * int(minute) + float(second.replace(",", "."))
            except (AssertionError, ValueError):
                message = f"column '{cited(heading)}': {cited(text)!r} is not a time such as 12:30:05.25 or "
                raise self.error(f"{message}2025-01-31T12:30:05.25", row=row) from None
        return values

    def continued(self, time: np.ndarray, values: np.ndarray, period: float, heading: str) -> np.ndarray:
        """Return a column (T,) of an angle, continued over full turns; see `continued`."""
        return continued(time, values, period, (self.error, heading, np.arange(len(values))))

    def function(self, x: str, y: str, unit: Unit | None) -> tuple[list[float], list[float]]:
        """Return times [s] and values in two columns, in SI units; `unit` is that of the values, by default as in the
        file.

        Raises
        ------
        SpecError
            If a column is missing, times do not increase, a value is missing, or the unit is not known or contradicts
            the file.
        """
        of_time, stated = (read_unit(self.unit(heading) or default) for heading, default in ((x, "s"), (y, "1")))
        if not of_time.is_like(read_unit("s")):
            raise self.error(f"column '{cited(x)}': {of_time} is not a unit of time (s, ms)")
        times, values = self.times(x, "x", of_time.factor), self.column(y, "y")
        if (missing := np.flatnonzero(np.isnan(values))).size:
            raise self.error(f"column '{cited(y)}': the value is missing; gaps are not bridged", row=int(missing[0]))
        if self.unit(y) is None and unit is None:
            why = f"because {self.name} states no unit of '{cited(y)}'"
            raise SpecError(f"is missing, {why}; give deg, rad, mm, ..., or 1 for a number", key="unit")
        if self.unit(y) is not None and unit is not None and unit.factor != stated.factor:
            raise SpecError(f"{unit} contradicts the unit in {self.name}, {stated}; leave it out", key="unit")
        return times.tolist(), ((unit or stated).factor * values).tolist()


#: Pattern of a clock time: date, hour, minute, second and zone.
CLOCK = re.compile(r"(\d{4}-\d\d-\d\d[ T])?(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)(Z|[+-]\d\d:\d\d)?")

DECIMAL_COMMA = re.compile(r"\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*")  #: Pattern of a number with a decimal comma.


def begins_like_number(cell: Cell) -> bool:
    """Return whether a cell is a number, or a text that begins like one."""
    return not isinstance(cell, str) or bool(re.match(r"\s*[-+.]?\d", cell))


def _is_plain(cell: Cell) -> bool:
    """Return whether `float` reads a cell as other programs do; false for ``1_0``, read as 10, and digits of other
    scripts.
    """
    return not isinstance(cell, str) or (cell.isascii() and "_" not in cell)


def table_of(data: Mapping[str, Sequence[float | None]], key: str) -> MeasuredTable:
    """Return a table with the given columns by heading; raise SpecError if the columns differ in length."""
    lengths = {heading: len(values) for heading, values in data.items()}
    if len(set(lengths.values())) > 1:
        raise SpecError(
            f"columns should be of equal length, not {listed(f'{cited(name)} {n}' for name, n in lengths.items())}",
            key=key,
        )
    return MeasuredTable("", list(data), list(zip(*data.values(), strict=True)))


#: Largest number of intervals next to a gap from which the rate of an angle is computed; with fewer intervals, noise
#: would have a greater effect.
RATE_SAMPLES = 5


def continued(
    time: np.ndarray, values: np.ndarray, period: float, where: tuple[Callable[..., SpecError], str, np.ndarray]
) -> np.ndarray:
    """Return an angle (T,) continued over full turns, from sample to sample and across gaps, which remain nan.

    Between neighbouring samples, the angle changes by at most half a turn. Across a gap, the number of turns is chosen
    that agrees best with the rates on both sides.

    Raises
    ------
    SpecError
        If the number of turns during a gap is uncertain.
    """
    known = np.flatnonzero(~np.isnan(values))
    turned = np.unwrap(values[known], period=period)
    if known.size and np.ptp(values[known]) > period / 2:  # otherwise, the angle does not turn
        gap = np.diff(known) > 1
        change = np.diff(turned)
        for place in np.flatnonzero(gap).tolist():
            lasts = time[known[place + 1]] - time[known[place]]
            sides = [_rate_beside(time[known], change, gap, place, step) for step in (-1, 1)]
            expected = [rate * lasts for rate in sides if rate is not None]
            off = float(np.mean(expected)) - change[place] if expected else 0.0
            turns = np.round(off / period)
            turned[place + 1 :] += period * turns
            if not expected or abs(off - period * turns) > period / 4 or np.ptp(expected) > period / 2:
                error, heading, rows = where
                raise error(
                    f"column '{cited(heading)}': the number of full turns during a gap of {lasts:.4g} s is not "
                    "certain; fill the gap, or cut the motion with `time.start` and `time.end`",
                    row=int(rows[known[place] + 1]),
                )
    found = values.copy()
    found[known] = turned
    return found


def _rate_beside(time: np.ndarray, change: np.ndarray, gap: np.ndarray, place: int, step: int) -> float | None:
    """Return the mean rate of a column before (`step` -1) or after (`step` 1) a gap; None if it is not known.

    At most `RATE_SAMPLES` intervals are used, none of which lies beyond another gap.
    """
    last = place
    while abs(last - place) < RATE_SAMPLES and 0 <= last + step < len(change) and not gap[last + step]:
        last += step
    if last == place:
        return None
    first, end = (last, place) if step < 0 else (place + 1, last + 1)
    return float(np.sum(change[first:end]) / (time[end] - time[first]))


def cited(text: object) -> str:
    """Return text from files for a sentence about it: escaped, see `shown`, and shortened to 300 characters."""
    return shortened(shown(str(text)[:301]))
