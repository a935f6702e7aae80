"""Workload of joints and actuators: peaks, root mean squares, impulses, loading rates, powers and work."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from mbdkit.archive.headlines import ROUND_OFF, answers
from mbdkit.archive.run import Run
from mbdkit.base.errors import SpecError, UnknownNameError
from mbdkit.base.html_view import HtmlView
from mbdkit.base.text import plus_minus, table
from mbdkit_biomech.inverse_dynamics.results.frame_errors import exact_loads
from mbdkit_biomech.inverse_dynamics.signals.cycles import Normalized, contacts, normalized

#: Kinds of elements, in the order in which tables show them.
KINDS = ("joint", "actuator", "reserve", "residual")


@dataclass(frozen=True)
class ElementLoad:
    """Load by a force or torque over an interval of time.

    Attributes
    ----------
    units
        N for forces, N m for torques.
    peak, peak_time
        Largest magnitude and its time [s].
    rms
        Root of the mean square over time.
    impulse
        Integral of the magnitude over time [N s or N m s].
    loading_rate
        Largest rate at which the magnitude rises [N/s or N m/s].
    peak_error
        Lower and upper end of the bar of the peak over a whole run, as in the summary of the run; None if unknown. In
        inverse dynamics, it holds with a probability of 95 %; in a forward run, it is the estimate by the check.
    id
        Identifier of a peak over a whole run; see `mbdkit guide trust`.
    """

    units: str
    peak: float
    peak_time: float
    rms: float
    impulse: float
    loading_rate: float
    peak_error: tuple[float, float] | None = None
    id: str = ""


@dataclass(frozen=True)
class ElementWork:
    """Power over an interval of time.

    Attributes
    ----------
    peak_power, least_power
        Largest and smallest power [W].
    positive, negative
        Integrals of the positive and of the negative part of the power [J].
    """

    peak_power: float
    least_power: float
    positive: float
    negative: float


@dataclass(frozen=True)
class ElementWorkload:
    """Workload of one joint or actuator.

    Attributes
    ----------
    name, kind
        Name of the element, and its kind: ``joint``, ``actuator``, ``reserve`` or ``residual``. Drivers of a forward
        run count as actuators. A residual is an external load on a part of the mechanism that no joint connects to the
        ground.
    load
        Magnitude of the reaction force of a joint; force or torque of an actuator.
    torque
        Reaction torque of a joint that carries one; None otherwise.
    work
        Work of an actuator; None for joints, which do no work.
    """

    name: str
    kind: str
    load: ElementLoad
    torque: ElementLoad | None = None
    work: ElementWork | None = None


@dataclass(frozen=True)
class WorkloadPhase:
    """Workload in a part of the motion.

    Attributes
    ----------
    name
        ``contact 1``, ``swing 1``, ``cycle 1`` and so on.
    start, end
        Start and end time of the phase [s].
    elements
        Workload of each joint and actuator during the phase.
    """

    name: str
    start: float
    end: float
    elements: tuple[ElementWorkload, ...]


@dataclass(frozen=True)
class _Series:
    """Quantities of one joint or actuator over time, each (T,): a force or torque in `units`, the torque of a joint
    that also carries one, the power of an actuator, and the errors of the first two.
    """

    name: str
    kind: str
    units: str
    value: np.ndarray
    torque: np.ndarray | None = None
    power: np.ndarray | None = None
    error: np.ndarray | None = None
    torque_error: np.ndarray | None = None

    def within(self, time: np.ndarray, start: float, end: float) -> ElementWorkload:
        """Return the workload between two times; the values at these times are interpolated."""
        t = np.concatenate([[start], time[(time > start) & (time < end)], [end]])

        def at(values: np.ndarray | None) -> Any:
            return None if values is None else np.interp(t, time, values)

        load = _load(t, at(self.value), self.units, at(self.error))
        torque = None if self.torque is None else _load(t, at(self.torque), "N m", at(self.torque_error))
        work = None if self.power is None else _work(t, at(self.power))
        return ElementWorkload(self.name, self.kind, load, torque, work)


@dataclass(frozen=True)
class Workload(HtmlView):
    """Workload of a run.

    Attributes
    ----------
    start, end
        Time interval that the workload covers [s].
    elements
        Workload of each joint and actuator over this interval.
    phases
        Workload of each cycle, and of its contact and swing; empty without cycles.
    cycles
        Forces of joints and values of actuators over 0 to 100 % of the cycles, by name; empty without cycles. Where a
        joint and an actuator have the same name, the entry is that of the actuator.
    note
        Sentences on numbers that have no errors, and on loads that the error estimates treat as exact.
    """

    start: float
    end: float
    elements: tuple[ElementWorkload, ...]
    phases: tuple[WorkloadPhase, ...] = ()
    cycles: Mapping[str, Normalized] = field(default_factory=dict)
    note: str = ""

    def __getitem__(self, name: str) -> ElementWorkload:
        """Return the workload of a joint or actuator; if a joint and an actuator have this name, of the actuator.

        Raises
        ------
        UnknownNameError
            If there is no joint or actuator with this name.
        """
        if not (found := [element for element in self.elements if element.name == name]):
            raise UnknownNameError("joint or actuator", name, [element.name for element in self.elements])
        return found[-1]

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers for JSON; cycles are given as mean and standard deviation at 0, 1, ... 100 %."""
        return {
            "start": self.start,
            "end": self.end,
            "elements": [asdict(element) for element in self.elements],
            "phases": [asdict(phase) for phase in self.phases],
            "cycles": {name: {"mean": x.mean, "deviation": x.deviation} for name, x in self.cycles.items()},
            "note": self.note,
        }

    def text(self) -> str:
        """Return the workload as tables of plain text."""
        whole = WorkloadPhase("whole motion", self.start, self.end, self.elements)
        return "\n\n".join([*[_phase_text(phase) for phase in (whole, *self.phases)], self.note])


def workload(
    run: Run, *, cycles: Sequence[float] | None = None, load: str | None = None, threshold: float = 20.0
) -> Workload:
    """Compute the workload of the joints and actuators of a run.

    Quantities are interpolated linearly between rows; loading rates are the slopes of these lines.

    Parameters
    ----------
    cycles
        Times at which the cycles begin, and as last value the end of the last cycle [s]. Not used if `load` is given.
    load
        Name of a measured load of inverse dynamics that determines the cycles. A cycle begins when the magnitude of
        the load rises to `threshold`, for example at heel strike. The contact of the cycle ends when the magnitude
        falls below `threshold`; the rest of the cycle is its swing.
    threshold
        Force at which contacts begin and end [N]; only used with `load`.

    Returns
    -------
    Workload
        Numbers of every joint and actuator over the whole run, and in each cycle, contact and swing. In a forward run,
        its drivers count as actuators.

    Raises
    ------
    SpecError
        If the run has fewer than two rows, if the values of `cycles` do not increase or lie outside the run, or if the
        load never rises to the threshold.
    UnknownNameError
        If the run has no load with this name.

    Examples
    --------
    >>> import mbdkit
    >>> run = mbdkit.run("double-pendulum", time={"end": 1.0, "step": 0.001})
    >>> found = mbdkit.workload(run)
    >>> found["J1"].load.units, found["J1"].load.peak > found["J1"].load.rms
    ('N', True)
    """
    time = run.time
    if len(time) < 2:
        raise SpecError("a workload needs a run with at least two recorded times")
    every = _series_of(run)
    start, end = float(time[0]), float(time[-1])

    def between(begin: float, until: float) -> tuple[ElementWorkload, ...]:
        return tuple(one.within(time, begin, until) for one in every)

    starts, parts = _parts(run, cycles, load, threshold)
    phases = tuple(WorkloadPhase(name, begin, until, between(begin, until)) for name, begin, until in parts)
    over = {one.name: normalized(time, one.value, starts) for one in every} if len(starts) > 1 else {}
    elements = between(start, end)
    exact = exact_loads(run)
    note = (
        f"{'Errors are not estimated' if run.accuracy is None else 'Only peaks have errors'}; RMS, impulse, loading "
        f"rate, power and work are those of straight lines between the recorded rows."
        f"{f' In the errors, {exact}.' if exact else ''}"
    )
    return Workload(start, end, _with_errors(run, elements), phases, over, note)


def _with_errors(run: Run, elements: tuple[ElementWorkload, ...]) -> tuple[ElementWorkload, ...]:
    """Return the workload of a whole run with the errors of peaks that the summary of the run shows."""
    if run.accuracy is None or not run.accuracy.is_complete:
        return elements
    found = {(one.element, one.quantity): one for one in answers(run)}

    def known(name: str, load: ElementLoad, what: str) -> ElementLoad:
        if (one := found.get((name, what))) is None or not one.bar.is_known:
            return load
        return replace(load, peak=one.value, peak_error=one.bar, id=one.id)

    def what(one: ElementWorkload) -> str:
        is_actuator = one.name in run.actuators and one.kind != "joint"
        return "actuators.value" if is_actuator else "joints.force" if one.load.units == "N" else "joints.torque"

    loads = [known(one.name, one.load, what(one)) for one in elements]
    torques = [one.torque and known(one.name, one.torque, "joints.torque") for one in elements]
    return tuple(replace(one, load=x, torque=y) for one, x, y in zip(elements, loads, torques, strict=True))


def _parts(
    run: Run, cycles: Sequence[float] | None, load: str | None, threshold: float
) -> tuple[np.ndarray, list[tuple[str, float, float]]]:
    """Return the times at which cycles start, and the name, start and end of each contact, swing and cycle."""
    off = np.zeros(0)
    if load is not None:
        starts, off = contacts(run, load, threshold)
    else:
        starts = np.array([] if cycles is None else cycles, dtype=float)
        if np.any(np.diff(starts) <= 0) or np.any((starts < run.time[0]) | (starts > run.time[-1])):
            raise SpecError("cycles should begin at increasing times within the run", key="cycles")
    parts = []
    for number, begin in enumerate(starts.tolist(), 1):
        if (ends := off[off > begin]).size:
            parts.append((f"contact {number}", begin, float(ends[0])))
        if number < len(starts):
            following = float(starts[number])
            if ends.size and ends[0] < following:
                parts.append((f"swing {number}", float(ends[0]), following))
            parts.append((f"cycle {number}", begin, following))
    return starts, parts


def _series_of(run: Run) -> list[_Series]:
    """Return the force or torque of every joint, driver and actuator of a run over time, in the order of `KINDS`.

    Drivers of a forward run count as actuators; in inverse dynamics, they are joints.
    """
    drivers = () if run.kind == "inverse" else run.drivers
    found = []
    bars = run.accuracy if run.kind == "inverse" else None
    for column, (name, joint) in enumerate(run.joints.items()):
        errors: dict[str, np.ndarray] = {}
        if bars is not None:
            errors = {"error": bars.reaction_error[:, column], "torque_error": bars.torque_error[:, column]}
        force, torque = np.linalg.norm(joint.reaction_force, axis=1), joint.reaction_torque
        if name in drivers:
            value, units = (torque, "N m") if joint.angle_units == "rad" else (force, "N")
            found.append(_Series(name, "actuator", units, value, power=joint.driver_power))
        else:
            carries = np.max(np.abs(torque)) > ROUND_OFF * np.max(force)
            found.append(_Series(name, "joint", "N", force, torque if carries else None, **errors))
    for name, actuator in run.actuators.items():
        error = None if bars is None else actuator.value_error
        found.append(_Series(name, actuator.kind, actuator.units, actuator.value, power=actuator.power, error=error))
    return sorted(found, key=lambda one: KINDS.index(one.kind))


def _load(time: np.ndarray, values: np.ndarray, units: str, error: np.ndarray | None) -> ElementLoad:
    size = np.abs(values)
    row, length = int(np.argmax(size)), float(time[-1] - time[0])
    step = np.diff(time)
    # Exact for straight lines between the rows, because the square of a line is a parabola.
    squares = step * (size[:-1] ** 2 + size[:-1] * size[1:] + size[1:] ** 2) / 3
    return ElementLoad(
        units,
        float(size[row]),
        float(time[row]),
        math.sqrt(float(np.sum(squares)) / length),
        float(np.trapezoid(size, time)),
        float(max(0.0, np.max(np.diff(size)[step > 0] / step[step > 0]))),
        None if error is None else (float(error[row]), float(error[row])),
    )


def _work(time: np.ndarray, power: np.ndarray) -> ElementWork:
    positive, negative = (float(np.trapezoid(part, time)) for part in (np.maximum(power, 0), np.minimum(power, 0)))
    return ElementWork(float(np.max(power)), float(np.min(power)), positive, negative)


_HEADS = ("", "PEAK", "AT [s]", "RMS", "IMPULSE", "LOADING RATE", "PEAK POWER", "WORK DONE", "WORK ABSORBED")


def _phase_text(phase: WorkloadPhase) -> str:
    rows = [row for element in phase.elements for row in _rows(element)]
    return f"{phase.name}, {phase.start:.6g} to {phase.end:.6g} s\n{table([_HEADS, *rows], indent='  ')}"


def _rows(one: ElementWorkload) -> list[tuple[str, ...]]:
    """Return the table rows of one element: one of its load, and one of its torque if it has one."""
    work = one.work
    powers = ("", "", "")
    if work is not None:
        most = max(work.peak_power, work.least_power, key=abs)
        powers = (f"{most:.4g} W", f"{work.positive:.4g} J", f"{-work.negative:.4g} J")
    kind = "" if one.kind == "joint" else f" ({one.kind})"
    rows = [(f"{one.name}{kind}", *_numbers(one.load), *powers)]
    if one.torque is not None:
        rows.append((f"{one.name} (torque)", *_numbers(one.torque), "", "", ""))
    return rows


def _numbers(load: ElementLoad) -> tuple[str, ...]:
    unit = load.units
    peak = f"{load.peak:.4g}" if load.peak_error is None else plus_minus(load.peak, load.peak_error)
    return (
        f"{peak} {unit}",
        f"{load.peak_time:.4g}",
        f"{load.rms:.4g} {unit}",
        f"{load.impulse:.4g} {unit} s",
        f"{load.loading_rate:.4g} {unit}/s",
    )
