"""The measured motion of a spec: reading of the table, conversion of units, and checks of times, gaps and columns."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from mbdkit.archive.reader import load
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import counted, listed
from mbdkit.base.units import Unit, read_unit
from mbdkit.engine.linear_systems import products
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.inverse_dynamics.files.measured_table import (
    MeasuredTable,
    cited,
    continued,
    table_of,
    unit_of_time_as_cause,
)
from mbdkit_biomech.inverse_dynamics.files.table_files import read_table
from mbdkit_biomech.inverse_dynamics.motion.fit import FitTarget
from mbdkit_biomech.inverse_dynamics.motion.manifold import Quantities
from mbdkit_biomech.inverse_dynamics.signals.interpolating_splines import interpolating_spline
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import (
    ColumnOfTable,
    Gaps,
    Load,
    MeasuredMotion,
    ObservedColumn,
    TimeColumn,
)
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec

LARGEST = 1e30  #: Largest value of a column in SI units; squares and products of larger values may overflow.

SHORTEST, LONGEST = 1e-9, 1e9  #: Shortest and longest interval between two rows [s].

#: Share by which an angle may exceed one turn, and a gap its greatest length, because values are rounded.
ROUNDED = 1e-6

#: Key of a column in the spec, its heading, its unit in the spec or None, and its SI unit.
GivenUnit: TypeAlias = tuple[str, str, str | None, str]


@dataclass(frozen=True)
class Measured:
    """A measured motion in SI units.

    Attributes
    ----------
    time
        (T,) [s].
    names
        Names of the K observed quantities.
    quantities
        The quantities.
    raw
        (T, K) values as measured, with angles unwrapped over full turns; gaps are nan.
    values
        (T, K) values of `raw`, with gaps bridged.
    weight
        (K,) weights of the squared residuals.
    derivatives
        (2, T, K) measured rates and accelerations; None if the columns have none.
    deviation
        (K,) stated standard deviations of the noise; nan where none is stated.
    given
        (T, K) values as in the table, before angles are continued over full turns.
    has_unit
        (K,) whether the spec or the file states the unit of the column.
    is_declared_in_degrees
        (K,) whether the spec states that the column is in degrees.
    may_turn
        (K,) whether the column is an angle whose number of full turns is not known: all its values in the table are
        within one turn.
    contradictions
        Sentences, without full stops, on units in the spec that differ from those in the file.
    """

    time: np.ndarray
    names: tuple[str, ...]
    quantities: Quantities
    raw: np.ndarray
    values: np.ndarray
    weight: np.ndarray
    derivatives: np.ndarray | None
    deviation: np.ndarray
    given: np.ndarray
    has_unit: np.ndarray
    is_declared_in_degrees: np.ndarray
    may_turn: np.ndarray
    contradictions: tuple[str, ...] = ()

    @property
    def target(self) -> FitTarget:
        """The values as a target of a fit."""
        return FitTarget(self.time, self.quantities, self.values, np.sqrt(self.weight))

    def near(self, pose: np.ndarray) -> Measured:
        """Return the motion with the columns `may_turn` shifted by full turns, so that they begin as near as
        possible to the values in a pose (n,).
        """
        turn = 2 * np.pi * self.quantities.scale
        turns = np.round((self.quantities.values(pose[None])[0] - self.values[0]) / turn)
        return self.turned(self.values[0] + turn * np.where(self.may_turn, turns, 0.0))

    def turned(self, first: np.ndarray) -> Measured:
        """Return the motion shifted by constants, so that it begins with the values `first` (K,), which differ from
        those of this motion by full turns of angles.
        """
        by = first - self.values[0]
        return replace(self, raw=self.raw + by, values=self.values + by)


def read_motion(spec: InverseSpec, names: QuantityNames) -> tuple[Measured, MeasuredTable | None]:
    """Return the measured motion of a spec and, if it was read from a table, that table.

    Raises
    ------
    SpecError
        If the table lacks a column, contains anything but numbers, has gaps that may not be bridged, or has no rows.
    """
    motion = spec.motion
    if motion.is_run:
        assert motion.file is not None
        return _of_run(spec, names, spec.folder / motion.file), None
    table = source_table(motion, spec.folder, "motion")
    assert table is not None
    columns = _columns(motion, table, names)
    times = times_of(table, motion.time, "motion.time")
    time = times[kept := rows_within(spec, times)]
    quantities = Quantities([names.find(name, f"motion.columns.{quoted(name)}") for name in columns])
    raw = np.empty((len(time), len(columns)))
    values = raw.copy()
    as_given, has_unit, may_turn = raw.copy(), *np.zeros((2, len(columns)), dtype=bool)
    derivatives, deviation = np.empty((2, *raw.shape)), np.full(len(columns), np.nan)
    has_derivatives = [column.rate is not None for column in columns.values()]
    _require_all_or_none(motion, columns, has_derivatives)
    for index, (name, column) in enumerate(columns.items()):
        key, unit = f"motion.columns.{quoted(name)}", quantities.quantities[index].unit
        factor, where = unit_factor(column, table, unit, key), (table, column.column, kept)
        every = si_values(column, table, unit, key)
        period, given = 2 * np.pi * quantities.scale[index], every[kept]
        as_given[:, index], may_turn[index] = given, unit == "rad" and _range(every) <= period * (1 + ROUNDED)
        has_unit[index] = (column.unit or table.unit(column.column)) is not None or (unit == "rad" and table.in_degrees)
        raw[:, index] = given if unit == "m" else continued(time, given, period, (table.error, *where[1:]))
        values[:, index] = with_gaps_bridged(time, raw[:, index], motion.gaps_of(name), where)
        if column.deviation is not None:
            deviation[index] = abs(factor) * column.deviation
        for order, heading in enumerate((column.rate, column.acceleration)):
            if heading is not None:
                given = factor * table.column(heading, f"{key}.{('rate', 'acceleration')[order]}")[kept]
                derivatives[order, :, index] = with_gaps_bridged(time, given, None, (table, heading, kept))
    weight = np.array([column.weight for column in columns.values()])
    units: list[GivenUnit] = [
        (f"motion.columns.{quoted(name)}", column.column, column.unit, quantity.unit)
        for (name, column), quantity in zip(columns.items(), quantities.quantities, strict=True)
    ]
    if "unit" in motion.time.model_fields_set:
        units.insert(0, ("motion.time", motion.time.column, motion.time.unit, "s"))
    in_degrees = np.array([column.unit == "deg" for column in columns.values()])
    numbers = raw, values, weight, derivatives if all(has_derivatives) else None, deviation
    about = as_given, has_unit, in_degrees, may_turn, tuple(contradicted_units(table, units))
    return Measured(time, tuple(columns), quantities, *numbers, *about), table


def source_table(section: MeasuredMotion | Load, folder: Path, key: str) -> MeasuredTable | None:
    """Return the table of a section; None if the section has none."""
    if section.data is not None:
        return table_of(section.data, f"{key}.data")
    return None if section.file is None else read_table(folder / section.file, f"{key}.file")


def _range(values: np.ndarray) -> float:
    """Return the range of values with gaps; 0 if there are none."""
    known = values[~np.isnan(values)]
    return float(np.ptp(known)) if known.size else 0.0


def _columns(motion: MeasuredMotion, table: MeasuredTable, names: QuantityNames) -> Mapping[str, ObservedColumn]:
    if motion.columns is not None:
        return motion.columns
    found = {heading: ObservedColumn(column=heading) for heading in table.headings if names.knows(heading)}
    if not found:
        raise SpecError(
            f"is missing: no heading of {table.name} is a quantity of the mechanism, such as {names.examples}"
            f"{table.force_hint}",
            key="motion.columns",
        )
    return found


def _require_all_or_none(
    motion: MeasuredMotion, columns: Mapping[str, ObservedColumn], has_derivatives: list[bool]
) -> None:
    if not any(has_derivatives):
        return
    if motion.smooth.name != "none":
        raise SpecError(
            f"is `{motion.smooth.name}`, but the columns have measured derivatives, which are used only without "
            "smoothing",
            key="motion.smooth",
        )
    if lacking := [name for name, has in zip(columns, has_derivatives, strict=True) if not has]:
        raise SpecError(
            "is missing: either all columns have `rate` and `acceleration`, or none",
            key=f"motion.columns.{quoted(lacking[0])}.rate",
        )


def unit_factor(column: ColumnOfTable, table: MeasuredTable, unit: str, key: str) -> float:
    """Return the factor from the numbers of a column to values in the SI `unit`."""
    wanted, in_file = read_unit(unit), table.unit(column.column)
    if column.unit is not None:
        given = read_unit(column.unit)
    elif in_file is not None:
        given = _unit_in_file(table, column.column, in_file, key)
    else:
        given = read_unit("deg" if unit == "rad" and table.in_degrees else unit)
    if not given.is_like(wanted) or (unit == "rad") != (given.text in ("rad", "deg")):
        what = {"rad": "an angle (rad, deg)", "m": "a length (m, mm)", "N": "a force (N)", "N m": "a torque (N m)"}
        raise SpecError(f"'{given.text}' is not a unit of {what[unit]}", key=f"{key}.unit")
    return given.factor * column.scale


def contradicted_units(table: MeasuredTable, columns: Iterable[GivenUnit]) -> Iterator[str]:
    """Yield a sentence without a full stop for each unit of a column in the spec that differs from that in the file."""
    for key, heading, unit, wanted in columns:
        in_file = table.unit(heading) or ("deg" if wanted == "rad" and table.in_degrees else None)
        if unit is None or in_file is None:
            continue
        with suppress(SpecError):  # the file has a unit that is not known, which may be the reason for `unit`
            if read_unit(unit).factor != read_unit(in_file).factor:
                yield (
                    f"the unit {cited(unit)} at {key}.unit contradicts the unit of column '{cited(heading)}' in the "
                    f"file, {cited(in_file)}; leave out `unit` if the file is right"
                )


def _unit_in_file(table: MeasuredTable, heading: str, text: str, key: str) -> Unit:
    """Return the unit that a file states for a column; raise SpecError if it is not known."""
    try:
        return read_unit(text)
    except SpecError as error:
        message = f"column '{cited(heading)}': its unit in the file, {error}; give `unit` in the spec"
        raise table.error(message, key=key) from None


def si_values(column: ColumnOfTable, table: MeasuredTable, unit: str, key: str) -> np.ndarray:
    """Return the values of a column in the SI `unit`, (T,); gaps are nan. Raise SpecError if one is too large."""
    values = unit_factor(column, table, unit, key) * table.column(column.column, f"{key}.column")
    if (large := np.flatnonzero(np.abs(values) > LARGEST)).size:
        row = int(large[0])
        raise table.error(
            f"column '{cited(column.column)}': {values[row]:.6g} {unit} is not possible: its magnitude exceeds "
            f"{LARGEST:g}",
            row=row,
        )
    return values


def times_of(table: MeasuredTable, column: TimeColumn, key: str) -> np.ndarray:
    """Return the times of a table (T,) [s]; raise SpecError if their intervals are too short or long to be times."""
    in_file = None if "unit" in column.model_fields_set else table.unit(column.column)
    factor = column.factor if in_file is None else _unit_in_file(table, column.column, in_file, key).factor
    if in_file is not None and not read_unit(in_file).is_like(read_unit("s")):
        raise table.error(f"column '{cited(column.column)}': '{cited(in_file)}' is not a unit of time (s, ms)", key=key)
    times = table.times(column.column, key, factor)
    if (wrong := np.flatnonzero((np.diff(times) < SHORTEST) | (np.diff(times) > LONGEST))).size:
        row = int(wrong[0]) + 1
        raise table.error(
            f"column '{cited(column.column)}': the interval of {times[row] - times[row - 1]:.6g} s from the row before "
            f"is not possible; it should be from {SHORTEST:g} to {LONGEST:g} s",
            row=row,
        )
    return times


def rows_within(spec: InverseSpec, times: np.ndarray) -> np.ndarray:
    """Return the rows whose times are within the span of the spec; raise SpecError if there are none."""
    start = -math.inf if spec.time.start is None else spec.time.start
    end = math.inf if spec.time.end is None else spec.time.end
    if not (kept := np.flatnonzero((times >= start) & (times <= end))).size:
        raise SpecError(
            f"leaves no row of the motion, which lasts from {times[0]:.6g} to {times[-1]:.6g} s", key="time"
        )
    return kept


def with_gaps_bridged(
    time: np.ndarray, values: np.ndarray, gaps: Gaps | None, where: tuple[MeasuredTable, str, np.ndarray]
) -> np.ndarray:
    """Return the values of a column with its gaps bridged; raise SpecError if one may not be bridged."""
    missing = np.isnan(values)
    if not np.any(missing):
        return values
    table, heading, rows = where
    known = np.flatnonzero(~missing)
    first = int(np.flatnonzero(missing)[0])
    column = f"column '{cited(heading)}'"
    if gaps is None:
        raise table.error(
            f"{column}: the value is missing ({counted(int(missing.sum()), 'row')} without a value); give "
            "`motion.gaps: {longest: SECONDS}` to bridge gaps",
            row=int(rows[first]),
        )
    if not known.size or missing[0] or missing[-1]:
        at = first if missing[0] else int(known[-1]) + 1
        raise table.error(f"{column}: a gap at an end of the motion cannot be bridged", row=int(rows[at]))
    widths = np.diff(time[known])
    worst = int(np.argmax(np.where(np.diff(known) > 1, widths, 0.0)))
    if widths[worst] > gaps.longest * (1 + ROUNDED):
        raise table.error(
            f"{column}: a gap of {widths[worst]:.4g} s is longer than `gaps.longest` allows ({gaps.longest:.4g} s)"
            f"{unit_of_time_as_cause(float(np.median(np.diff(time))))}",
            row=int(rows[known[worst] + 1]),
        )
    return bridged(time, values, missing, gaps)


def bridged(time: np.ndarray, values: np.ndarray, missing: np.ndarray, gaps: Gaps) -> np.ndarray:
    """Return series (T, ...) whose values in the rows `missing` (T,) are interpolated; the first and the last row are
    not missing.
    """
    filled, known = values.copy(), ~missing
    degree = 1 if gaps.interpolation == "linear" or np.sum(known) < 4 else 3
    filled[missing] = interpolating_spline(time[known], values[known], degree)(time[missing])
    return filled


def _of_run(spec: InverseSpec, names: QuantityNames, path: Path) -> Measured:
    """Return the motion in the archive of a run: the coordinates of all bodies or, if given, the columns of the spec.

    Rates and accelerations are those of the run; they are left out if the motion is to be smoothed.
    """
    motion = spec.motion
    if not path.is_file():
        raise SpecError(f"there is no such file: {cited(str(path))}", key="motion.file")
    with load(path) as run:
        kept = rows_within(spec, run.time)
        time, archived = run.time[kept], list(run.bodies)
        arrays = [run.array(f"trajectory/{name}")[kept] for name in ("position", "velocity", "acceleration")]
    bodies = list(names.mechanism.bodies)
    if missing := [name for name in bodies if name not in archived]:
        raise SpecError(f"{cited(path.name)} has no body {listed(missing)} of the model", key="motion.file")
    places = [archived.index(name) for name in bodies]
    q, v, a = (array[:, places].reshape(len(time), -1) for array in arrays)
    if motion.columns is None:
        axes = ("x", "y", "angle")
        wanted = {f"{name}.{axis}": ObservedColumn(column=f"{name}.{axis}") for name in bodies for axis in axes}
    else:
        wanted = dict(motion.columns)
    found = {name: names.find(name, f"motion.columns.{quoted(name)}") for name in wanted}
    quantities = Quantities(list(found.values()))
    values = quantities.values(q)
    jacobian = quantities.jacobian(q)
    acceleration = products(jacobian, a) + quantities.curvature(q, v)
    derivatives = np.stack([products(jacobian, v), acceleration]) if motion.smooth.name == "none" else None
    weight = np.array([column.weight for column in wanted.values()])
    deviation = np.array([column.deviation or np.nan for column in wanted.values()])
    yes = np.ones(len(wanted), dtype=bool)
    return Measured(
        time, tuple(found), quantities, values, values, weight, derivatives, deviation, values, yes, ~yes, ~yes
    )
