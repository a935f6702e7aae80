"""Measured data of an experiment: columns of a file, in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from mbdkit.plugin import SpecError, path_text, read_unit
from mbdkit.plugin.measures import MeasureExpression
from mbdkit.plugin.specs import read_table
from mbdkit_identify.identify_spec import Experiment, IdentifySpec, Measured, Sensor, TimeColumn

LEAST_SAMPLES = 3  #: Smallest number of values of a signal.
SINCE_1970 = 1e8  #: Times from which on they are seconds since 1970 [s].
ROUNDED = 0.01  #: Share of a turn by which the values of a column that wraps may exceed it, by noise or rounding.
LARGEST = 1e50  #: Largest measured value, and inverse of the smallest one.


#: Velocities of the coordinates of bodies and markers.
RATES = {"angle": "angular_velocity", "x": "vx", "y": "vy"}


@dataclass(frozen=True)
class SignalData:
    """A measured signal.

    Attributes
    ----------
    quantity, unit
        The expression that is measured, and the unit of `values`: that of the quantity, or "" if the sensor has a gain.
    sensor
        The sensor.
    values
        (T,) measured values; nan in gaps.
    deviation
        Standard deviation of the noise; None if it is estimated.
    may_correlate
        Whether the noise may be correlated.
    """

    quantity: str
    unit: str
    sensor: Sensor
    values: np.ndarray
    deviation: float | None
    may_correlate: bool


@dataclass(frozen=True)
class ExperimentData:
    """The data of one experiment.

    Attributes
    ----------
    name, experiment
        Name and spec.
    time
        (T,) times [s].
    signals
        The measured quantities.
    inputs
        Times and values of the measured inputs, by name, in the units of the inputs.
    input_deviations
        Standard deviations of their noise, by name, where they are given.
    notes
        Sentences on how the data were changed.
    """

    name: str
    experiment: Experiment
    time: np.ndarray
    signals: tuple[SignalData, ...]
    inputs: dict[str, tuple[np.ndarray, np.ndarray]]
    input_deviations: dict[str, float]
    notes: tuple[str, ...] = ()


def read_experiment(spec: IdentifySpec, name: str) -> ExperimentData:
    """Return the data of an experiment of a spec.

    Raises
    ------
    SpecError
        If a file has no such columns, a cell is not a number, times do not increase, a unit does not fit, or a signal
        has fewer than three values in the window.
    """
    one = spec.experiments[name]
    place, files = ("experiments", name), _Files(spec, name)
    signals, inputs, deviations, notes = [], {}, {}, []
    clocks = [files.clock(given) for given in one.observed.values()]
    time = clocks[0] if all(clock is clocks[0] for clock in clocks) else np.unique(np.concatenate(clocks))
    if one.window is not None:
        time = time[(time >= one.window[0] - 1e-9) & (time <= one.window[1] + 1e-9)]
    for (quantity, signal), clock in zip(one.observed.items(), clocks, strict=True):
        where = path_text((*place, "observed", quantity))
        sensor = one.sensors.get(quantity) or spec.sensors.get(quantity) or Sensor()
        unit = _unit_of(quantity, spec, where)
        if has_gain := sensor.gain != 1.0:
            if signal.unit is not None:
                raise SpecError("a sensor with a gain has counts, which need no unit", key=f"{where}.unit")
            turn = 2.0 * np.pi * abs(sensor.gain) if isinstance(sensor.gain, float) else np.nan
            factor = 1.0
        else:
            factor = files.factor(signal, unit, where)
            turn = 2.0 * np.pi / factor
        turn = turn if signal.unwrap is True and unit == "rad" else float(signal.unwrap) if signal.unwrap else np.nan
        column, is_wrapped = files.unwrapped(signal, clock, turn, where, is_stated=signal.unwrap is not True)
        if is_wrapped:
            notes.append(f"the column '{signal.column}' of '{name}' wraps in a range of {turn:.6g} and was unwrapped")
        found = np.full(len(time), np.nan)
        some = np.isin(clock, time)
        found[np.searchsorted(time, clock[some])] = factor * column[some]
        size = np.max(np.abs(found), where=np.isfinite(found), initial=0.0)
        if size > LARGEST or 0.0 < size < 1.0 / LARGEST:
            message = f"the column '{signal.column}' has values up to {size:.3g}, which no unit makes plausible"
            raise SpecError(message, key=where)
        if np.sum(np.isfinite(found)) < LEAST_SAMPLES:
            raise SpecError(f"the column '{signal.column}' has fewer than {LEAST_SAMPLES} values here", key=where)
        deviation = None if signal.deviation is None else abs(factor) * signal.deviation
        may_correlate = signal.correlation == "ar" and not spec.kinematic
        signals.append(SignalData(quantity, "" if has_gain else unit, sensor, found, deviation, may_correlate))
    unstated = [signal for signal in signals if signal.deviation is None]
    if spec.kinematic and unstated and len({signal.unit for signal in signals}) > 1:
        where = path_text((*place, "observed", unstated[0].quantity))
        raise SpecError("with `kinematic: true` and several units, all signals need their `deviation`", key=where)
    for key, given in one.inputs.items():
        where = path_text((*place, "inputs", key))
        factor = files.factor(given, spec.run_spec.mechanism().inputs[key].unit, where)
        clock, column = files.clock(given), factor * files.column(given, where)
        is_known = np.isfinite(column) & (clock <= time[-1])
        if not is_known.any():
            raise SpecError(f"the column '{given.column}' has no values here", key=where)
        inputs[key] = clock[is_known], column[is_known]
        if given.deviation is not None:
            deviations[key] = abs(factor) * given.deviation
    return ExperimentData(name, one, time, tuple(signals), inputs, deviations, tuple(notes))


class _Files:
    """The tables of an experiment, and their times."""

    def __init__(self, spec: IdentifySpec, name: str):
        self.experiment, self.key = spec.experiments[name], ("experiments", name)
        self._folder = spec._document.folder if spec._document is not None else FilePath()
        self._tables: dict[str, Any] = {}
        self._clocks: dict[tuple[str, str], np.ndarray] = {}
        self._origin = 0.0
        first, table = float(self.clock(None)[0]), self.table(None)
        texts = dict(zip(table.headings, table.cells[0], strict=False))
        if first >= SINCE_1970 or any(":" in str(texts[one]) for one in table.resolved([self.experiment.time.column])):
            self._origin, self._clocks = first, {}

    def table(self, of: Measured | None) -> Any:
        """Return the table of a column; that of the experiment if none is given."""
        one = self.experiment
        file = one.file if of is None or of.file is None else of.file
        if file not in self._tables:
            separator = {"tab": "\t", "blank": " "}.get(one.separator or "", one.separator)
            with SpecError.rekey(path_text((*self.key, "file"))):
                self._tables[file] = read_table(self._folder / file, "file", separator, one.decimal)
        return self._tables[file]

    def clock(self, of: Measured | None) -> np.ndarray:
        """Return the times (T,) of a column [s]."""
        table, column = self.table(of), self.experiment.time if of is None or of.time is None else of.time
        key = table.file, column.column
        if key not in self._clocks:
            with SpecError.rekey(path_text((*self.key, "time"))):
                factor = self._factor(column, table.unit(column.column), "s")
                found = table.times(column.column, "time", factor)
            self._clocks[key] = np.round(found - self._origin, 6) if self._origin else found
        return self._clocks[key]

    def column(self, of: Measured, where: str) -> np.ndarray:
        """Return the numbers (T,) in a column, as in the file."""
        with SpecError.rekey(f"{where}.column"):
            return np.asarray(self.table(of).column(of.column, "column"))

    def factor(self, of: Measured, unit: str, where: str) -> float:
        """Return the factor from the numbers in a column to the SI unit of a quantity."""
        table = self.table(of)
        stated = table.unit(of.column) or ("deg" if table.in_degrees and unit == "rad" else None)
        with SpecError.rekey(f"{where}.unit"):
            return self._factor(of, stated, unit)

    @staticmethod
    def _factor(of: Measured | TimeColumn, stated: str | None, unit: str) -> float:
        given = read_unit(of.unit or stated or unit or "1")
        if unit and not given.fits(read_unit(unit)):
            raise SpecError(f"the unit {given.text} of the column '{of.column}' does not fit the unit {unit}")
        if of.unit and stated and given.factor != read_unit(stated).factor:
            raise SpecError(f"the unit {of.unit} contradicts the unit {stated} of the column '{of.column}' in the file")
        return given.factor

    def unwrapped(
        self, of: Measured, clock: np.ndarray, turn: float, where: str, *, is_stated: bool
    ) -> tuple[np.ndarray, bool]:
        """Return a column (T,) continued over full turns if it wraps, and whether it does.

        `is_stated`: whether the spec says that it wraps in the range `turn`.
        """
        values = self.column(of, where)
        known = values[np.isfinite(values)]
        is_within = is_stated or (len(known) > 0 and np.ptp(known) <= turn * (1.0 + ROUNDED))
        if not (is_within and np.any(np.abs(np.diff(known)) > 0.5 * turn)):
            return np.asarray(values), False
        with SpecError.rekey(where):
            return self.table(of).continued(clock, values, turn, of.column), True


def _unit_of(quantity: str, spec: IdentifySpec, where: str) -> str:
    try:
        return MeasureExpression.parse(f"final(abs({quantity}))", spec.run_spec).unit.text
    except SpecError as error:
        if "unit of this expression is unknown" in error.message:
            return ""
        raise SpecError(error.message, key=where) from None


def plain_name(quantity: str) -> str:
    """Return the name of a measured coordinate without its kind, such as ``crank.angle`` for ``bodies.crank.angle``."""
    kind, _, rest = quantity.partition(".")
    return rest if kind in ("bodies", "joints", "markers") and rest else quantity
