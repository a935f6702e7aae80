"""The tables of a run's report: joints, force elements, events and cost."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.analysis.verdict import Cell, Column, Table
from mbdkit.archive.layout import COUNTERS, TIMINGS
from mbdkit.archive.run_summary import plus_minus
from mbdkit.plot.downsampling import bands
from mbdkit.plot.joint_quantity import joint_quantity

if TYPE_CHECKING:
    from mbdkit.archive.accuracy import Accuracy
    from mbdkit.archive.run import Run

BODIES = 50
"""Largest number of bodies in the table of errors."""
JOINTS = 50
"""Largest number of joints in the table."""
FORCES = 50
"""Largest number of force elements in the table."""
EVENTS = 50
"""Largest number of event crossings in the table."""
FORCE = "joints/reaction_force"
_QUANTITIES = (
    ("velocity misalignment", "joints/velocity_misalignment", "m/s"),
    ("reaction force", FORCE, "N"),
)
_DRIVER_POWER = ("driver power", "joints/driver_power", "W")


def run_tables(run: Run) -> tuple[Table, ...]:
    """Return the tables of a run."""
    tables = [_joints(run)] if run.joint_names else []
    if run.accuracy is not None and run.accuracy.rows_known:
        tables.append(_errors(run, run.accuracy))
    if run.records("forces/value"):
        tables.append(_forces(run))
    if run.spec.get("events"):
        tables.append(_events(run))
    return (*tables, _cost(run))


def _events(run: Run) -> Table:
    """Return the table of event crossings, limited to the first."""
    specs = run.spec["events"]
    columns = (Column("event"), Column("zero crossing of"), Column("direction"), Column("time", "s"))
    rows: list[tuple[Cell, ...]] = [
        (
            event.name,
            str(specs[event.name]["when"]),
            "upwards" if event.direction > 0 else "downwards",
            f"{event.time:.10g}",
        )
        for event in run.events[:EVENTS]
    ]
    found = set(run.events.names)
    rows += [(name, str(event["when"]), "never", None) for name, event in specs.items() if name not in found]
    note = f"The first {EVENTS} of {len(run.events)} crossings." if len(run.events) > EVENTS else ""
    return Table("events", "Events", columns, tuple(rows), note)


def _joints(run: Run) -> Table:
    columns = [Column("joint"), Column("between"), Column("largest misalignment", "m")]
    found = []
    driven = run.records(_DRIVER_POWER[1]) and bool(np.any(run.array(_DRIVER_POWER[1])))
    for name, path, unit in (*_QUANTITIES, *([_DRIVER_POWER] if driven else [])):
        if run.records(path):
            columns.append(Column(f"largest {name}", unit))
            cells: list[Cell] = joint_quantity(run, name, path, unit, _magnitude).data.peaks.tolist()
            found.append(_known_forces(run) if path == FORCE and run.accuracy is not None else cells)
    order = sorted(
        enumerate(run.joints.values()), key=lambda item: -np.nan_to_num(item[1].misalignment_max, nan=np.inf)
    )[:JOINTS]
    rows: list[tuple[Cell, ...]] = [
        (joint.name, " - ".join(joint.bodies), joint.misalignment_max, *(cells[column] for cells in found))
        for column, joint in sorted(order)
    ]
    left = len(run.joint_names) - len(rows)
    note = f"The {JOINTS} of {len(run.joint_names)} joints with the largest misalignment." if left else ""
    return Table("joints", "Joints", tuple(columns), tuple(rows), note)


def _known_forces(run: Run) -> list[Cell]:
    """Return the largest force of each joint with its estimated error, such as ``368 ± 0.3 until 4.2 s``."""
    accuracy = run.accuracy
    assert accuracy is not None
    until = "" if accuracy.is_complete else f" until {accuracy.known_until:.4g} s"
    found: list[Cell] = []
    for joint in accuracy.of_joints(run.joint_names, run.array(FORCE)):
        if not math.isfinite(joint.error):
            found.append(f"{joint.peak:.4g} (error unknown)")
            continue
        later = f"; later {joint.peak:.4g} (error unknown)" if joint.peak > joint.peak_known else ""
        found.append(f"{plus_minus(joint.peak_known, joint.error, '±')}{until}{later}")
    return found


def _errors(run: Run, accuracy: Accuracy) -> Table:
    """Return the table of the estimated errors of the bodies."""
    columns = (
        Column("body"),
        Column("position", "m"),
        Column("angle", "rad"),
        Column("velocity", "m/s"),
        Column("angular velocity", "rad/s"),
    )
    count = accuracy.rows_known
    largest = np.stack([accuracy.position_error[count - 1], accuracy.velocity_error[count - 1]], axis=1)  # (B, 2, 3)
    names = list(run.bodies)
    size = np.linalg.norm(largest[..., :2], axis=-1)
    order = np.sort(np.argsort(-size[:, 0], kind="stable")[:BODIES])
    rows: list[tuple[Cell, ...]] = [
        (names[k], *(float(x) for x in (size[k, 0], largest[k, 0, 2], size[k, 1], largest[k, 1, 2])))
        for k in order.tolist()
    ]
    until = "over the whole run" if accuracy.is_complete else f"until {accuracy.known_until:.4g} s, unknown afterwards"
    few = f" The {BODIES} of {len(size)} bodies with the largest errors." if len(size) > BODIES else ""
    note = f"Largest errors {until}.{few} {accuracy.method}"
    return Table("errors", "Estimated errors", columns, tuple(rows), note)


def _forces(run: Run) -> Table:
    """Return the table of the largest force, torque and power of each force element, limited to the first."""
    time = np.asarray(run.time)
    value, power = (bands(time, run.dataset(f"forces/{name}")).peaks for name in ("value", "power"))
    rows: list[tuple[Cell, ...]] = [
        (
            force.name,
            " - ".join(force.bodies),
            float(value[column]) if force.units == "N" else None,
            float(value[column]) if force.units == "N m" else None,
            float(power[column]),
        )
        for column, force in enumerate(run.forces.values())
    ]
    columns = (
        Column("force element"),
        Column("between"),
        Column("largest force", "N"),
        Column("largest torque", "N m"),
        Column("largest power", "W"),
    )
    note = f"The first {FORCES} of {len(rows)} force elements." if len(rows) > FORCES else ""
    return Table("forces", "Forces", columns, tuple(rows[:FORCES]), note)


def _magnitude(part: np.ndarray) -> np.ndarray:
    """Return the magnitudes of vectors (R, J, 2); scalars (R, J) are unchanged."""
    return part if part.ndim == 2 else np.hypot(part[..., 0], part[..., 1])


def _cost(run: Run) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (name.replace("_", " ").replace("rhs", "right-side"), int(run.stats[name]))
        for name in COUNTERS
        if name in run.stats
    ]
    rows += [(f"{name.removesuffix('_s')} time [s]", float(run.stats[name])) for name in TIMINGS if name in run.stats]
    return Table("cost", "Cost", (Column("item"), Column("value")), tuple(rows))
