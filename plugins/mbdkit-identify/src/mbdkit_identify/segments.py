"""Predictions of the measured signals: a run for each window of an experiment, and what its sensors show."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from scipy.interpolate import make_interp_spline

from mbdkit.plugin import RunSpec, SpecError, path_text
from mbdkit.plugin.runs import GivenStart
from mbdkit.plugin.specs import parse_key, variable_path
from mbdkit.plugin.studies import PreparedSensitivities, is_smooth
from mbdkit_identify.identify_spec import IdentifySpec, Sensor
from mbdkit_identify.kinematic import Positions
from mbdkit_identify.loading import base_of, data_of, number_of, sensor_names, spec_of_base
from mbdkit_identify.measured_data import LEAST_SAMPLES, RATES, ExperimentData, SignalData, plain_name

INITIAL = "initial"  #: First part of the names of initial values among the parameters of a run.
UNIFORM = 1e-6  #: Largest deviation of times from a grid, in sampling intervals, for each sample.
FEW = 12  #: Number of samples by which initial values are guessed.
SPLINE = 5  #: Degree of the splines in time by which signals are delayed.

#: Name, first value, and bounds, which are None for values that are exact.
_InitialValue = tuple[str, float, tuple[float, float] | None]


@dataclass
class Unknown:
    """A number to be estimated.

    Attributes
    ----------
    name
        Name of the parameter, or of the initial value, such as ``swing: crank.angle``.
    start, low, high
        First value, and bounds.
    prior
        Mean and standard deviation of what is known of it; None if nothing is.
    size
        Magnitude, to which changes are relative.
    unit
        SI unit.
    is_initial
        Whether it is an initial value of one window.
    """

    name: str
    start: float
    low: float = -np.inf
    high: float = np.inf
    prior: tuple[float, float] | None = None
    size: float = 1.0
    unit: str = ""
    is_initial: bool = False


@dataclass
class Segment:
    """One window of an experiment.

    Attributes
    ----------
    experiment
        Name of the experiment.
    time
        (T,) times [s].
    signals
        The measured quantities in this window.
    spec
        The spec of the run.
    parameters
        Places of the unknowns that are parameters of the run, by name.
    initial
        Initial values: the place of an unknown, or a number, by quantity.
    shared
        What evaluates the quantities; windows of equal runs, which differ in their initial values alone, share it, and
        those of equal mechanisms share a part.
    """

    experiment: str
    time: np.ndarray
    signals: tuple[SignalData, ...]
    spec: RunSpec
    parameters: dict[str, int]
    initial: dict[str, int | float]
    shared: dict[object, PreparedSensitivities] = field(default_factory=dict, repr=False)

    @cached_property
    def prepared(self) -> PreparedSensitivities:
        """Evaluates the quantities of the run."""
        start = {name: 0.0 if isinstance(value, int) else value for name, value in self.initial.items()}
        own = [f"{INITIAL}.{name}" for name, value in self.initial.items() if isinstance(value, int)]
        quantities = [signal.quantity for signal in self.signals]
        names = [*self.parameters, *own]
        key = self.spec.canonical_json(), *quantities, self.time.tobytes(), *names, *start
        with SpecError.locate(path_text(("experiments", self.experiment))):
            if key not in self.shared:
                data = data_of(self.spec)
                content = json.dumps([data[section] for section in ("model", "parameters") if section in data])
                like = self.shared.get(content)
                made = PreparedSensitivities(self.spec, quantities, self.time, names, initial=start, like=like)
                self.shared[key] = made
                self.shared.setdefault(content, made)
            return self.shared[key]

    def given(self, x: np.ndarray) -> tuple[dict[str, float], dict[str, float]]:
        """Return the parameters and the initial values of the run for unknowns x (n,)."""
        start = {name: float(x[v]) if isinstance(v, int) else float(v) for name, v in self.initial.items()}
        return {name: float(x[place]) for name, place in self.parameters.items()}, start

    @property
    def run_places(self) -> list[int]:
        """Places of the unknowns on which the run depends, in the order of the derivatives of `prepared`."""
        return [*self.parameters.values(), *(value for value in self.initial.values() if isinstance(value, int))]

    def shown(
        self, values: np.ndarray, slopes: np.ndarray | None, x: np.ndarray, names: Mapping[str, int]
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Return what the sensors show, (S, T), and its derivatives (S, T, n) with respect to the unknowns x (n,).

        Parameters
        ----------
        values, slopes
            (S, T) quantities, and their derivatives (S, T, K) with respect to `run_places`.
        names
            Places of the unknowns by name of the parameter.
        """
        shown = np.empty_like(values)
        every = None if slopes is None else np.zeros((*values.shape, len(x)))
        for row, signal in enumerate(self.signals):
            sensor = signal.sensor
            gain, offset, delay = sensor_numbers(sensor, {name: float(x[place]) for name, place in names.items()})
            y, own = values[row], None if slopes is None else slopes[row]
            rate = np.zeros_like(y)
            if sensor.delay != 0.0:
                spline = make_interp_spline(self.time, y, k=SPLINE)
                y, rate = spline(self.time - delay), spline.derivative()(self.time - delay)
                own = None if own is None else make_interp_spline(self.time, own, k=SPLINE)(self.time - delay)
            shown[row] = gain * y + offset
            if every is not None and own is not None:
                every[row][:, self.run_places] += gain * own
                for value, slope in ((sensor.gain, y), (sensor.offset, np.ones_like(y)), (sensor.delay, -gain * rate)):
                    if isinstance(value, str):
                        every[row, :, names[value]] += slope
        return shown, every


class KinematicSegment(Segment):
    """All samples of an experiment."""

    @cached_property
    def prepared(self) -> Positions:  # type: ignore[override]  # it has the methods that are used
        """Evaluates the quantities."""
        return Positions(self.spec, [one.quantity for one in self.signals], len(self.time), [*self.parameters])

    def start_with(self, unknowns: list[Unknown]) -> None:
        """Add the coordinates of all samples to the unknowns."""
        numbers = {one.name: one.start for one in unknowns}
        targets = []
        for signal in self.signals:
            gain, offset, _ = sensor_numbers(signal.sensor, numbers)
            targets.append((signal.values - offset) / gain)
        plain = {name: unknowns[place].start for name, place in self.parameters.items()}
        for row, coordinates in enumerate(self.prepared.tracked(plain, np.array(targets))):
            for name, value in zip(self.prepared.independent, coordinates.tolist(), strict=True):
                self.initial[f"{row}: {name}"] = len(unknowns)
                size = 1.0 if name.endswith("angle") else max(abs(value), 1e-3)
                unknowns.append(
                    Unknown(f"{self.experiment}, sample {row + 1}: {name}", value, size=size, is_initial=True)
                )


def sensor_numbers(sensor: Sensor, numbers: Mapping[str, float]) -> tuple[float, float, float]:
    """Return gain, offset and delay of a sensor with values of parameters by name."""
    given = (sensor.gain, sensor.offset, sensor.delay)
    gain, offset, delay = (numbers[one] if isinstance(one, str) else one for one in given)
    return gain, offset, delay


def segments_of(
    spec: IdentifySpec, data: Sequence[ExperimentData]
) -> tuple[list[Unknown], dict[str, int], list[Segment]]:
    """Return the unknowns of some experiments, the places of the parameters, and the windows.

    Parameters that only sensors of other experiments have are left out.
    """
    of_run = [name for name in spec.parameters if name in spec.run_spec.parameters or name.startswith("model.")]
    sensors = [signal.sensor for one in data for signal in one.signals]
    shown = {value for one in sensors for value in (one.gain, one.offset, one.delay)}
    of_sensors = {one.sensor.offset: one.unit for data_of in data for one in data_of.signals}
    of_sensors |= {one.delay: "s" for one in sensors}
    unknowns = [_parameter(spec, name, of_sensors) for name in spec.parameters if name in of_run or name in shown]
    names = {one.name: place for place, one in enumerate(unknowns)}
    segments: list[Segment] = []
    shared: dict[object, PreparedSensitivities] = {}
    for one in data:
        base, fixed = base_of(spec, one.name, one.experiment), set(map(parse_key, one.experiment.overrides))
        places = {name: names[name] for name in of_run if variable_path(name) not in fixed}
        if spec.kinematic:
            with SpecError.locate(path_text(("experiments", one.name))):
                whole = KinematicSegment(one.name, one.time, one.signals, base, places, {})
                whole.start_with(unknowns)
            segments.append(whole)
            continue
        for number, some in enumerate(_windows(one, spec.shooting.window if spec.shooting else None)):
            segments.append(_segment(spec, base, one, some, number, unknowns, places, shared))
    return unknowns, names, segments


def _parameter(spec: IdentifySpec, name: str, of_sensors: Mapping[float | str, str]) -> Unknown:
    from mbdkit.plugin.reports import key_unit

    given, base = spec.parameters[name], spec.run_spec
    low, high = given.bounds or (-np.inf, np.inf)
    start = base.numbers.get(name) if given.start is None else given.start
    if start is None and name.startswith("model."):
        start = number_of(base, name)
    if start is None:
        start = 0.5 * (low + high)
    prior = None if given.prior is None else (given.prior.mean, given.prior.deviation)
    width = high - low if np.isfinite(high - low) else 0.0
    size = max(abs(start), 1e-3 * width, 1e-12) if start else 0.1 * width or 1.0
    is_of_sensor = name in sensor_names(spec) and name not in base.numbers
    path = ("parameters", name) if name in base.parameters else variable_path(name)
    unit = of_sensors.get(name, "") if is_of_sensor else key_unit(path, [base])
    return Unknown(name, float(np.clip(start, low, high)), low, high, prior, size, unit)


def _windows(data: ExperimentData, duration: float | None) -> list[np.ndarray]:
    """Return the places of the samples of each window; windows with gaps, and the last one, are joined with the one
    before if they have few values.
    """
    time, known = data.time, np.any([np.isfinite(signal.values) for signal in data.signals], axis=0)
    if duration is None:
        return [np.arange(len(time))]
    number = np.floor((time - time[0]) / duration * (1 + 1e-9)).astype(int)
    parts: list[np.ndarray] = []
    for k in np.unique(number):
        some = np.flatnonzero(number == k)
        few = 0.5 * len(parts[0]) if parts and k == number[-1] else LEAST_SAMPLES
        is_joined = parts and (np.sum(known[some]) < few or np.sum(known[parts[-1]]) < LEAST_SAMPLES)
        parts.append(np.concatenate([parts.pop(), some]) if is_joined else some)
    return parts


def _segment(
    spec: IdentifySpec, base: RunSpec, data: ExperimentData, some: np.ndarray, number: int, unknowns: list[Unknown],
    parameters: dict[str, int], shared: dict[object, PreparedSensitivities],
) -> Segment:  # fmt: skip
    """Return a window of an experiment; its unknown initial values are added to the unknowns."""
    time = data.time[some]
    signals = tuple(_in_window(signal, time, some, spec) for signal in data.signals)
    run = run_of_window(base, time, data.inputs)
    choice = data.experiment.initial if number == 0 else "estimated"
    initial: dict[str, int | float] = {}
    if choice is not None:
        label = data.name if number == 0 else f"{data.name}, window {number + 1}"
        with SpecError.rekey(path_text(("experiments", data.name, "initial"))):
            given = GivenStart(run.mechanism(), run)
            numbers = {one.name: one.start for one in unknowns}
            guess = partial(_guess, given=given, numbers=numbers, signals=signals, time=time)
            values = _initial_values(given, choice, run.mechanism().bodies, signals, guess)
            if not isinstance(choice, str):  # raises errors of names and values with the key
                given.state({name: value for name, value, _ in values})
            for name, value, bounds in values:
                if bounds is None:
                    initial[name] = value
                    continue
                initial[name] = len(unknowns)
                size = max(abs(value), 1.0 if "angle" in name or "angular" in name else given.length)
                unknowns.append(Unknown(f"{label}: {name}", value, *bounds, size=size, is_initial=True))
    return Segment(data.name, time, signals, run, parameters, initial, shared)


def _in_window(signal: SignalData, time: np.ndarray, some: np.ndarray, spec: IdentifySpec) -> SignalData:
    """Return a signal in a window, without the values that a delay moves out of it."""
    values, delay = signal.values[some].copy(), signal.sensor.delay
    low, high = (delay, delay) if not isinstance(delay, str) else spec.parameters[delay].bounds or (np.nan, np.nan)
    if np.isnan(low):
        raise SpecError("the delay of a sensor needs bounds", key=path_text(("parameters", str(delay), "bounds")))
    values[(time < time[0] + max(high, 0.0)) | (time > time[-1] + min(low, 0.0))] = np.nan
    return replace(signal, values=values)


def run_of_window(base: RunSpec, time: np.ndarray, inputs: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> RunSpec:
    """Return the base for the times (T,) of a window.

    Equidistant samples are at ends of steps, which are shortened for that, except samples within steps over which the
    motion is smooth.
    """
    data = data_of(base)
    step, end = base.time.step, float(time[-1])
    section = {"stops": [stop for stop in base.time.stops if time[0] < stop < end]} if base.time.stops else {}
    places = (time - time[0]) / np.median(np.diff(time))
    interval = (end - float(time[0])) / max(round(places[-1]), 1)  # between samples, of which gaps may lack some
    is_uniform = bool(np.all(np.abs(places - np.round(places)) < UNIFORM * len(time)))
    if step is not None and is_uniform and (step <= interval or inputs or not is_smooth(base)):
        step = interval / np.ceil(interval / step * (1 - 1e-9))
        end = float(time[0]) + step * round((end - time[0]) / step)
    data["time"] = section | {"start": float(time[0]), "end": end} | ({} if step is None else {"step": step})
    data["output"] = {"every": 1}
    if inputs:
        tables = {}
        for name, (times, values) in inputs.items():
            first = max(0, int(np.searchsorted(times, time[0], side="right")) - 1)
            some = slice(first, int(np.searchsorted(times, end, side="right")) + 1)
            tables[name] = {"table": [times[some].tolist(), values[some].tolist()]}
        data["inputs"] = data.get("inputs", {}) | tables
    return spec_of_base(data, base._document)


def _initial_values(
    given: GivenStart,
    choice: str | Mapping[str, float | tuple[float, float]],
    bodies: Iterable[str],
    signals: Sequence[SignalData],
    guess: Callable[[str], float],
) -> list[_InitialValue]:
    """Return initial values; `guess` returns first values by name."""
    if not isinstance(choice, str):
        return [
            (name, float(np.clip(guess(name), *value)), value)
            if isinstance(value, tuple)
            else (name, float(value), None)
            for name, value in choice.items()
        ]
    coordinates = [f"{body}.{axis}" for axis in ("angle", "x", "y") for body in bodies]
    names = given.independent(dict.fromkeys([*(plain_name(signal.quantity) for signal in signals), *coordinates]))
    rates = [f"{element}.{RATES[axis]}" for element, _, axis in (name.rpartition(".") for name in names)]
    free = (-np.inf, np.inf)
    of_rates = [(name, 0.0, None) if choice == "rest" else (name, guess(name), free) for name in rates]
    return [*((name, guess(name), free) for name in names), *of_rates]


def _guess(
    name: str, *, given: GivenStart, numbers: Mapping[str, float], signals: Sequence[SignalData], time: np.ndarray
) -> float:
    """Return a first value of an initial value: by the first samples if it is measured, or else that of the base."""
    element, _, axis = name.rpartition(".")
    is_rate = axis in RATES.values()
    coordinate = next((f"{element}.{own}" for own, rate in RATES.items() if rate == axis), name)
    for signal in signals:
        known = np.flatnonzero(np.isfinite(signal.values))[:FEW]
        gain, offset, _ = sensor_numbers(signal.sensor, numbers)
        if plain_name(signal.quantity) == coordinate and gain and len(known) >= 4:
            y = (signal.values[known] - offset) / gain
            slope, value = np.polyfit(time[known] - time[0], y, 1 if len(known) < 6 else 2)[-2:]
            return float(slope if is_rate else value)
    return given.value(name)
