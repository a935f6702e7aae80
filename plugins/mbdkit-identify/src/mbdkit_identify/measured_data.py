"""Measured data of an experiment: columns of a file, in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np

from mbdkit.plugin import SpecError, path_text, read_unit
from mbdkit.plugin.measures import MeasureExpression
from mbdkit.plugin.specs import read_columns
from mbdkit_identify.identify_spec import Experiment, IdentifySpec, Sensor

LEAST_SAMPLES = 3  #: Smallest number of values of a signal.
LARGEST = 1e50  #: Largest measured value, and inverse of the smallest one.


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
    """

    name: str
    experiment: Experiment
    time: np.ndarray
    signals: tuple[SignalData, ...]
    inputs: dict[str, tuple[np.ndarray, np.ndarray]]
    input_deviations: dict[str, float]


def read_experiment(spec: IdentifySpec, name: str) -> ExperimentData:
    """Return the data of an experiment of a spec.

    Raises
    ------
    SpecError
        If the file has no such columns, a cell is not a number, times do not increase, a unit does not fit, or a signal
        has fewer than three values in the window.
    """
    one = spec.experiments[name]
    place = ("experiments", name)
    headings: dict[tuple[str, ...], str] = {("time",): one.time}
    headings |= {("observed", key, "column"): signal.column for key, signal in one.observed.items()}
    headings |= {("inputs", key, "column"): given.column for key, given in one.inputs.items()}
    path = (spec._document.folder if spec._document is not None else FilePath()) / one.file
    columns = np.array([_column(path, heading, (*place, *key)) for key, heading in headings.items()])
    time, values = columns[0], columns[1:]
    if not np.all(np.isfinite(time)):
        raise SpecError(f"the column '{one.time}' of '{one.file}' has an empty cell", key=path_text((*place, "time")))
    if np.any(late := np.diff(time) <= 0):
        row = int(np.argmax(late)) + 1
        message = f"times should increase, but {time[row]:.9g} s follows {time[row - 1]:.9g} s in '{one.file}'"
        raise SpecError(message, key=path_text((*place, "time")))
    known = time, values
    if one.window is not None:
        some = (time >= one.window[0] - 1e-9) & (time <= one.window[1] + 1e-9)
        time, values = time[some], values[:, some]
    signals = []
    for number, (quantity, signal) in enumerate(one.observed.items()):
        where = path_text((*place, "observed", quantity))
        sensor = one.sensors.get(quantity) or spec.sensors.get(quantity) or Sensor()
        unit = _unit_of(quantity, spec, where)
        has_gain = sensor.gain != 1.0
        factor = _factor(signal.unit, unit, where) if not has_gain else 1.0
        if has_gain and signal.unit is not None:
            raise SpecError("a sensor with a gain has counts, which need no unit", key=f"{where}.unit")
        found = factor * values[number]
        size = np.max(np.abs(found), where=np.isfinite(found), initial=0.0)
        if size > LARGEST or 0.0 < size < 1.0 / LARGEST:
            message = f"the column '{signal.column}' has values up to {size:.3g}, which no unit makes plausible"
            raise SpecError(message, key=where)

        if np.sum(np.isfinite(found)) < LEAST_SAMPLES:
            raise SpecError(f"the column '{signal.column}' has fewer than {LEAST_SAMPLES} values here", key=where)
        deviation = None if signal.deviation is None else abs(factor) * signal.deviation
        signals.append(
            SignalData(quantity, "" if has_gain else unit, sensor, found, deviation, signal.correlation == "ar")
        )
    inputs, deviations = {}, {}
    first = 1 + len(one.observed)
    for number, (named, given) in enumerate(one.inputs.items(), first):
        where = path_text((*place, "inputs", named))
        factor = _factor(given.unit, spec.run_spec.mechanism().inputs[named].unit, where)
        column = factor * known[1][number - 1]
        is_known = np.isfinite(column) & (known[0] <= time[-1])
        if not is_known.any():
            raise SpecError(f"the column '{given.column}' has no values here", key=where)
        inputs[named] = known[0][is_known], column[is_known]
        if given.deviation is not None:
            deviations[named] = abs(factor) * given.deviation
    return ExperimentData(name, one, time, tuple(signals), inputs, deviations)


def _column(path: FilePath, heading: str, key: tuple[str, ...]) -> list[float]:
    """Return a column; an error has the key of its heading, or that of the file if it cannot be read at all."""
    try:
        return read_columns(path, [heading], has_gaps=True)[0]
    except SpecError as error:
        raise SpecError(str(error), key=path_text((*key[:2], "file") if error.line is None else key)) from None


def _unit_of(quantity: str, spec: IdentifySpec, where: str) -> str:
    try:
        return MeasureExpression.parse(f"final(abs({quantity}))", spec.run_spec).unit.text
    except SpecError as error:
        if "unit of this expression is unknown" in error.message:
            return ""
        raise SpecError(error.message, key=where) from None


def _factor(given: str | None, unit: str, where: str) -> float:
    """Return the factor from a unit to the SI unit of a quantity."""
    if given is None:
        return 1.0
    with SpecError.rekey(f"{where}.unit"):
        found = read_unit(given)
        if unit and not found.fits(read_unit(unit)):
            raise SpecError(f"the unit {given} does not fit the unit {unit} of the quantity")
    return found.factor
