"""The sections on the answer of a run: the largest forces in joints, force elements and beams with their times, and
derivatives of measures. The forces in joints and the derivatives have estimated errors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mbdkit.archive.headlines import ROUND_OFF, answers
from mbdkit.archive.run import Run
from mbdkit.archive.run_summary import derivative_texts
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_report.figures.beam_curves import bending_moments, distributed_loads, has_beams
from mbdkit_report.figures.curves import bands, take
from mbdkit_report.figures.mechanism_drawing import NamedPose, illustration
from mbdkit_report.figures.page_model import (
    Cell,
    Column,
    Illustration,
    Section,
    Stated,
    Table,
    bar_cells,
    bar_columns,
    columns_of,
)
from mbdkit_report.plot.beams_plot import beam_peak
from mbdkit_report.plot.element_quantity import ElementQuantity, reaction_force, reaction_torque
from mbdkit_report.seams import report_sections

#: Largest number of rows in a table. Of more joints or force elements, those with the largest values are listed; of
#: more beams, the first ones.
ROWS = 50


#: Note of tables of values without errors.
OF_ROWS = (
    "Values are those of the recorded rows, and have no error estimates; checked runs estimate errors of measures."
)
_WORDS = {"N": "force", "N m": "torque"}


@report_sections
def standard_sections(run: Run, mechanism: Mechanism | None) -> list[Section]:
    """Return the sections that every run may have: on the largest forces, on beams and on gradients."""
    sections = (answer_section(run), beam_section(run, mechanism), gradient_section(run))
    return [section for section in sections if section is not None]


def answer_section(run: Run) -> Section | None:
    """Return the section on the forces and torques of a run that has rows; None if there are none to show."""
    tables: list[Table] = []
    if run.joint_names and run.records("joints/reaction_force"):
        tables = _of_joints(run)
    if run.records("forces/value"):
        tables.append(_of_forces(run))
    shown = tuple(table for table in tables if table.rows)
    return Section("answer", "Largest forces and torques", (), None, shown) if shown else None


def gradient_section(run: Run) -> Section | None:
    """Return the section on the derivatives of measures; None if there are none."""
    rows: list[tuple[Cell, ...]] = [
        (name, one["unit"], parameter, _derivative(one, f"d({name})/d({parameter})", parameter, text))
        for name, one in run.gradients.items()
        for parameter, text in derivative_texts(one, "\u00b1")
    ]
    if not rows:
        return None
    doubts = dict.fromkeys(doubt for gradient in run.gradients.values() for doubt in gradient.get("doubts", ()))
    sentences = tuple(f"{doubt[:1].upper()}{doubt[1:].rstrip('.')}." for doubt in doubts)
    note = "In the unit of the measure for each SI unit of the parameter."
    columns = columns_of("measure; unit; with respect to; derivative")
    table = Table("gradients", "Derivatives", columns, tuple(rows), note)
    return Section("gradients", "Derivatives of measures", sentences, None, (table,))


def _derivative(gradient: Mapping[str, Any], key: str, parameter: str, text: str) -> Cell:
    value = gradient["derivatives"][parameter]
    return text if value is None else Stated.of(value, text, key)


def _of_joints(run: Run) -> list[Table]:
    drivers = [run.joint_names.index(name) for name in run.drivers]
    quantities = [reaction_force(run)]
    if run.records("joints/reaction_torque"):
        quantities.append(reaction_torque(run))
    floor = ROUND_OFF * max(float(np.nanmax(quantity.data.peaks, initial=0.0)) for quantity in quantities)
    passive = [column for column in range(len(run.joint_names)) if column not in drivers]
    return [
        _table(run, "drivers", "Motors and drivers", drivers, quantities, floor),
        _table(run, "joints", "Joints", passive, quantities, floor),
    ]


def _columns(run: Run, quantity: ElementQuantity) -> list[tuple[list[Column], list[list[Cell]]]]:
    """Return the groups of columns of a table for a quantity: headings, and the cells of each joint."""
    word, unit, names = _WORDS[quantity.unit], quantity.unit, run.joint_names
    groups: list[tuple[list[Column], list[list[Cell]]]] = []
    loads: dict[float, dict[str, Any]] = {}
    for one in answers(run):
        if one.quantity == f"joints.{word}":
            loads.setdefault(one.until, {})[one.element] = one
    for when, found in loads.items():
        name = run.errors.force_in.removesuffix(" in") if word == "force" else word
        what = f"{name}{'' if math.isnan(when) else f' until {when:.4g} s'}"
        headings = [] if run.accuracy is None else bar_columns(f"the {what}", unit, [one.bar for one in found.values()])
        none: list[Cell] = [None] * (1 + len(headings))
        shown = {joint: bar_cells(own.value, own.bar, own.id, len(headings)) for joint, own in found.items()}
        groups.append(([Column(f"largest {what}", unit), *headings], [shown.get(joint, none) for joint in names]))
    groups.insert(1, ([Column(f"time of the {word}", "s")], [[time] for time in quantity.data.peak_times.tolist()]))
    return groups


def _table(
    run: Run, name: str, title: str, columns: Sequence[int], quantities: Sequence[ElementQuantity], floor: float
) -> Table:
    """Return the table of the joints with the indices `columns`; of more than `ROWS` joints, those with the largest
    forces or torques. The table of drivers also shows their largest power, if it was recorded. Cells of values that are
    at most `floor`, a rounding error, are empty.
    """
    most = np.nan_to_num(np.max(np.stack([quantity.data.peaks for quantity in quantities]), axis=0), nan=np.inf)
    chosen = sorted(sorted(columns, key=lambda column: -most[column])[:ROWS])
    used = [quantity for quantity in quantities if np.any(quantity.data.peaks[chosen] > floor)]
    headings = [Column("driver" if name == "drivers" else "joint"), Column("between")]
    groups = [(quantity, group) for quantity in used for group in _columns(run, quantity)]
    headings += [heading for _, (own, _) in groups for heading in own]
    power = None
    if name == "drivers" and run.records("joints/driver_power"):
        power = bands(np.asarray(run.time), run.dataset("joints/driver_power"))
        headings += columns_of("largest power [W]; time of the power [s]")
    rows: list[tuple[Cell, ...]] = []
    joints = list(run.joints.values()) if chosen else []
    for column in chosen:
        cells: list[Cell] = [joints[column].name, " - ".join(joints[column].bodies)]
        for quantity, (own, found) in groups:
            cells += [None] * len(own) if quantity.data.peaks[column] <= floor else found[column]
        if power is not None:
            cells += [float(power.peaks[column]), float(power.peak_times[column])]
        rows.append(tuple(cells))
    note = f"The {ROWS} of {len(columns)} joints with the largest forces or torques." if len(columns) > ROWS else ""
    if run.accuracy is not None and used:
        source = "by comparison runs" if run.spec_kind.is_integrated else "from the noise of the data and the cutoff"
        note = f"{note} Errors are estimated {source}{'; powers have none' if power is not None else ''}.".strip()
        note += f" They do not include {excluded}." if (excluded := run.errors.excluded) else ""
    return Table(name, title, tuple(headings), tuple(rows), note)


def _of_forces(run: Run) -> Table:
    time, loads = np.asarray(run.time), distributed_loads(run)
    value, power = (bands(time, run.dataset(f"forces/{name}")) for name in ("value", "power"))
    forces = list(run.forces.values())
    own = [column for column, force in enumerate(forces) if force.name not in loads]
    units = [unit for unit in _WORDS if any(force.units == unit for force in forces)]
    columns = [*columns_of("force element; between")]
    for unit in units:
        columns += [Column(f"largest {_WORDS[unit]}", unit), Column(f"time of the {_WORDS[unit]}", "s")]
    columns += columns_of("largest power [W]; time of the power [s]")
    chosen = sorted(sorted(own, key=lambda column: -np.nan_to_num(value.peaks[column], nan=np.inf))[:ROWS])
    rows: list[tuple[Cell, ...]] = []
    for column in chosen:
        force = forces[column]
        cells: list[Cell] = [force.name, " - ".join(force.bodies)]
        for unit in units:
            has_unit = force.units == unit
            cells += [float(value.peaks[column]), float(value.peak_times[column])] if has_unit else [None, None]
        rows.append((*cells, float(power.peaks[column]), float(power.peak_times[column])))
    note = f"The {ROWS} of {len(own)} force elements with the largest values. " if len(own) > ROWS else ""
    return Table("forces", "Force elements", tuple(columns), tuple(rows), note + OF_ROWS)


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
    if (moments := bending_moments(run, named.drawing.beams)) is None:
        return None
    caption = f"The mechanism at t = {run.time[row]:.6g} s. Beams are coloured by their bending moments."
    return illustration(replace(named, moments=moments[row]), "Drawing of the mechanism with its bent beams", caption)


def _beam_table(run: Run) -> Table:
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
    return Table("beams", "Internal forces of the beams", tuple(columns), tuple(rows), note + OF_ROWS)
