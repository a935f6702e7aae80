"""The sections on the answer of a run: the largest forces in joints, force elements and beams with their times, and
derivatives of measures. The forces in joints and the derivatives have estimated errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.archive.run_summary import derivative_texts
from mbdkit.plugin import Headline
from mbdkit.plugin.archives import ROUND_OFF, excluded_error, missed_between_rows, peak_errors
from mbdkit_report.figures.beam_curves import bending_moments, distributed_loads, has_beams
from mbdkit_report.figures.curves import BEYOND, Array, blocks, take
from mbdkit_report.figures.mechanism_drawing import NamedPose, illustration
from mbdkit_report.figures.page_model import Cell, Column, Illustration, Section, Table, columns_of
from mbdkit_report.plot.beams_plot import beam_peak
from mbdkit_report.seams import report_sections

if TYPE_CHECKING:
    from mbdkit.plugin import Mechanism, Run

ROWS = 50
"""Largest number of rows in a table. Of more joints or force elements, those with the largest values are listed; of
more beams, the first ones.
"""


OF_ROWS = (
    "Values are those of the recorded rows, and have no error estimates; checked runs estimate errors of measures."
)
"""Note of tables of values without errors."""


@dataclass(frozen=True)
class Peaks:
    """Largest magnitudes of J curves, each at its own time.

    Parameters
    ----------
    value, time
        (J,) largest magnitude and its time [s]; nan if a curve has no finite value.
    """

    value: Array
    time: Array

    @classmethod
    def of(cls, time: Array, data: object, magnitude: Callable[[Array], Array] = np.abs) -> Peaks:
        """Return the largest magnitudes in an array or dataset (T, J, ...) whose rows belong to the times `time`
        (T,).
        """
        array: np.ndarray = data  # type: ignore[assignment] # an HDF5 dataset is read by slicing
        value, when = np.full(array.shape[1], -1.0), np.full(array.shape[1], np.nan)
        for block in blocks(len(time), int(np.prod(array.shape[1:]))):
            part = magnitude(np.asarray(array[block], dtype=np.float64))
            part = np.where(part < BEYOND, part, -1.0)  # a comparison with nan is false
            row = np.argmax(part, axis=0)
            largest = part[row, np.arange(part.shape[1])]
            better = largest > value
            value[better], when[better] = largest[better], time[block][row[better]]
        value[value < 0] = np.nan
        return cls(value, when)


@dataclass(frozen=True)
class _Quantity:
    """Largest forces or torques of the joints, over the whole run and over the rows with known errors.

    Parameters
    ----------
    peaks, known
        Largest values over the run, and over the rows whose errors are known. `known` is None if errors were not
        estimated.
    error
        (J,) estimated errors of `known`.
    known_until
        Time of the last row whose errors are known [s]: inf if all errors are known, -inf if none are, nan if errors
        were not estimated.
    missed
        (J,) by how much the largest values between rows exceed `peaks`, nan where unknown; zero if every step is
        recorded.
    """

    name: str
    unit: str
    peaks: Peaks
    known: Peaks | None
    error: Array
    known_until: float
    missed: Array

    @property
    def columns(self) -> list[tuple[Column, Array]]:
        """The columns for this quantity: headings, and the values of the joints."""
        found = [(Column(f"largest {self.name}", self.unit), self.peaks.value)]
        found.append((Column(f"time of the {self.name}", "s"), self.peaks.time))
        if self.known is not None and not math.isinf(self.known_until):
            found.append((Column(f"largest {self.name} until {self.known_until:.4g} s", self.unit), self.known.value))
        if self.known is not None:
            found.append((Column(f"± error of the {self.name}", self.unit), self.error))
        return found

    def cells(self, joint: int, floor: float) -> list[Cell]:
        """Return the cells of a joint; they are empty if its largest value is at most `floor`, a rounding error."""
        is_rounding = self.peaks.value[joint] <= floor
        return [None if is_rounding else float(values[joint]) for _, values in self.columns]

    def told(self, joint: int) -> str:
        """Return the largest value of a joint with its error and time or, if the value between rows is clearly larger,
        with that value, as text.
        """
        value, time = float(self.peaks.value[joint]), float(self.peaks.time[joint])
        error, missed, is_checked = float(self.error[joint]), float(self.missed[joint]), self.known is not None
        one = Headline(self.name, value, self.unit, error, missed, is_checked=is_checked)
        if one.misses:
            return one.text("±")
        if self.known is None or time > self.known_until:
            unknown = "" if self.known is None else ", error unknown"
            return f"{value:.4g} {self.unit} (at {time:.4g} s{unknown})"
        return f"{one.text('±')} (at {time:.4g} s)"


@report_sections
def standard_sections(run: Run, mechanism: Mechanism | None) -> list[Section]:
    """Return the sections that every run may have: on the largest forces, on beams and on gradients."""
    sections = (answer_section(run), beam_section(run, mechanism), gradient_section(run))
    return [section for section in sections if section is not None]


def answer_section(run: Run) -> Section | None:
    """Return the section on the forces and torques of a run that has rows; None if there are none to show."""
    tables: list[Table] = []
    sentences: list[str] = []
    if run.joint_names and run.records("joints/reaction_force"):
        tables, sentences = _of_joints(run)
    if run.records("forces/value"):
        tables.append(_of_forces(run))
    shown = tuple(table for table in tables if table.rows)
    return Section("answer", "Largest forces and torques", tuple(sentences), None, shown) if shown else None


def gradient_section(run: Run) -> Section | None:
    """Return the section on the derivatives of measures; None if there are none."""
    rows: list[tuple[Cell, ...]] = [
        (name, one["unit"], *texts) for name, one in run.gradients.items() for texts in derivative_texts(one, "\u00b1")
    ]
    if not rows:
        return None
    doubts = dict.fromkeys(doubt for one in run.gradients.values() for doubt in one.get("doubts", ()))
    sentences = tuple(f"{doubt[:1].upper()}{doubt[1:].rstrip('.')}." for doubt in doubts)
    note = "In the unit of the measure for each SI unit of the parameter."
    columns = columns_of("measure; unit; with respect to; derivative")
    table = Table("gradients", "Derivatives", columns, tuple(rows), note)
    return Section("gradients", "Derivatives of measures", sentences, None, (table,))


def _of_joints(run: Run) -> tuple[list[Table], list[str]]:
    drivers = [run.joint_names.index(name) for name in run.drivers]
    force = _quantity(run, "force", "N", "joints/reaction_force", lambda f: np.hypot(f[..., 0], f[..., 1]))
    found = [force]
    if run.records("joints/reaction_torque"):
        found.append(_quantity(run, "torque", "N m", "joints/reaction_torque", np.abs))
    floor = ROUND_OFF * max(float(np.nanmax(one.peaks.value, initial=0.0)) for one in found)
    driven = _table(run, "drivers", "Motors and drivers", drivers, found, floor)
    passive = [column for column in range(len(run.joint_names)) if column not in drivers]
    table = _table(run, "joints", "Joints", passive, found, floor)
    sentences = []
    for columns, who in ((drivers, "driver"), (passive, "joint")):
        for one in found:
            values = [float(np.nan_to_num(one.peaks.value[column])) for column in columns]
            if values and max(values) > floor:
                largest = columns[int(np.argmax(values))]
                name = run.joint_names[largest]
                sentences.append(f"The largest {one.name} of a {who} is {one.told(largest)}, of {name}.")
    return [driven, table], [" ".join(sentences)] if sentences else []


def _quantity(run: Run, name: str, unit: str, path: str, magnitude: Callable[[Array], Array]) -> _Quantity:
    time, data, accuracy = np.asarray(run.time), run.dataset(path), run.accuracy
    peaks = Peaks.of(time, data, magnitude)
    beyond = missed_between_rows(run, f"joints.{name}", run.joint_names, peaks.value[None])
    missed = np.zeros(len(peaks.value)) if beyond is None else beyond
    if accuracy is None:
        return _Quantity(name, unit, peaks, None, np.full(len(peaks.value), np.nan), math.nan, missed)
    count, what = accuracy.rows_known, "reaction_error" if name == "force" else "torque_error"
    error = peak_errors(run, what, magnitude(np.asarray(data[:count])), count) if count else None
    error = np.full(len(peaks.value), np.nan) if error is None else error
    until = math.inf if accuracy.is_complete else accuracy.known_until if count else -math.inf
    known = peaks if accuracy.is_complete else Peaks.of(time[:count], data, magnitude)
    return _Quantity(name, unit, peaks, known if count else None, error, until, missed)


def _table(run: Run, name: str, title: str, columns: Sequence[int], found: Sequence[_Quantity], floor: float) -> Table:
    """Return the table of the joints with the indices `columns`; of more than `ROWS` joints, those with the largest
    forces or torques. The table of drivers also shows their largest power, if it was recorded.
    """
    most = np.nan_to_num(np.max(np.stack([one.peaks.value for one in found]), axis=0), nan=np.inf)
    chosen = sorted(sorted(columns, key=lambda column: -most[column])[:ROWS])
    used = [one for one in found if any(one.peaks.value[column] > floor for column in chosen)]
    headings = [Column("driver" if name == "drivers" else "joint"), Column("between")]
    headings += [column for one in used for column, _ in one.columns]
    power = None
    if name == "drivers" and run.records("joints/driver_power"):
        power = Peaks.of(np.asarray(run.time), run.dataset("joints/driver_power"))
        headings += columns_of("largest power [W]; time of the power [s]")
    rows: list[tuple[Cell, ...]] = []
    joints = list(run.joints.values()) if chosen else []
    for column in chosen:
        cells: list[Cell] = [joints[column].name, " - ".join(joints[column].bodies)]
        for one in used:
            cells += one.cells(column, floor)
        if power is not None:
            cells += [float(power.value[column]), float(power.time[column])]
        rows.append(tuple(cells))
    left = len(columns) - len(chosen)
    note = f"The {ROWS} of {len(columns)} joints with the largest forces or torques." if left else ""
    if run.accuracy is not None and used:
        source = "by comparison runs" if run.kind == "forward" else "from the noise of the data and the cutoff"
        note = f"{note} Errors are estimated {source}{'; powers have none' if power is not None else ''}.".strip()
        note += f" They do not include {excluded}." if (excluded := excluded_error(run)) else ""
    return Table(name, title, tuple(headings), tuple(rows), note)


def _of_forces(run: Run) -> Table:
    """Return the table of the largest force or torque, and of the largest power, of each force element. Distributed
    loads of beams are left out.
    """
    time, loads = np.asarray(run.time), distributed_loads(run)
    value, power = (Peaks.of(time, run.dataset(f"forces/{name}")) for name in ("value", "power"))
    forces = list(run.forces.values())
    own = [column for column, force in enumerate(forces) if force.name not in loads]
    units = [unit for unit in ("N", "N m") if any(force.units == unit for force in forces)]
    columns = [*columns_of("force element; between")]
    for unit in units:
        word = "force" if unit == "N" else "torque"
        columns += [Column(f"largest {word}", unit), Column(f"time of the {word}", "s")]
    columns += columns_of("largest power [W]; time of the power [s]")
    chosen = sorted(sorted(own, key=lambda column: -np.nan_to_num(value.value[column], nan=np.inf))[:ROWS])
    rows: list[tuple[Cell, ...]] = []
    for column in chosen:
        force = forces[column]
        cells: list[Cell] = [force.name, " - ".join(force.bodies)]
        for unit in units:
            has_unit = force.units == unit
            cells += [float(value.value[column]), float(value.time[column])] if has_unit else [None, None]
        rows.append((*cells, float(power.value[column]), float(power.time[column])))
    left = len(own) - len(rows)
    note = f"The {ROWS} of {len(own)} force elements with the largest values. " if left else ""
    note += OF_ROWS
    return Table("forces", "Force elements", tuple(columns), tuple(rows), note)


def beam_section(run: Run, mechanism: Mechanism | None) -> Section | None:
    """Return the section on the beams of a run that has rows; None if the run recorded no internal forces of beams.

    Parameters
    ----------
    mechanism
        The mechanism of the run; None if it is not known.
    """
    if not has_beams(run):
        return None
    peaks = {name: beam_peak(run, name, "moment") for name in run.beams}
    worst = max(peaks, key=lambda name: abs(np.nan_to_num(peaks[name].value)))
    peak = peaks[worst]
    sentence = (
        f"The largest bending moment is {abs(peak.value):.4g} N m, in {worst} at {peak.place:.4g} m from its end a, at "
        f"{peak.time:.4g} s, in the recorded rows."
    )
    drawing = _bent(run, mechanism, peak.row) if np.isfinite(peak.value) else None
    return Section("beams", "Beams", (sentence,), drawing, (_beam_table(run),))


def _bent(run: Run, mechanism: Mechanism | None, row: int) -> Illustration | None:
    """Return the drawing of the mechanism at a recorded row, with beams coloured by their bending moments; None if the
    moments are unknown.
    """
    pose = take(run.dataset("trajectory/position"), np.array([row], dtype=np.intp))[0]
    named = NamedPose.of(mechanism, list(run.bodies), pose, np.asarray(run.time)[row : row + 1])
    moments = bending_moments(run, named.drawing.beams)
    if moments is None:
        return None
    shown = replace(named, moments=moments[row])
    caption = f"The mechanism at t = {run.time[row]:.6g} s. Beams are coloured by their bending moments."
    return illustration(shown, "Drawing of the mechanism with its bent beams", caption)


def _beam_table(run: Run) -> Table:
    """Return the table of the largest internal forces and of the largest strain energy of each beam."""
    columns = [Column("beam")]
    for name, unit in (("bending moment", "N m"), ("shear force", "N"), ("axial force", "N")):
        columns += [Column(f"largest {name}", unit), Column("distance from a", "m"), Column("time", "s")]
    columns.append(Column("largest strain energy", "J"))
    rows: list[tuple[Cell, ...]] = []
    for name, beam in list(run.beams.items())[:ROWS]:
        cells: list[Cell] = [name]
        for component in ("moment", "shear", "axial"):
            peak = beam_peak(run, name, component)
            cells += [peak.value, round(peak.place, 4), peak.time]
        rows.append((*cells, float(np.max(beam.strain_energy))))
    note = f"The first {ROWS} of {len(run.beams)} beams. " if len(run.beams) > ROWS else ""
    note += OF_ROWS
    return Table("beams", "Internal forces of the beams", tuple(columns), tuple(rows), note)
