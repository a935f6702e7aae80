"""Tables in the report of a run, except those of the model and of the largest forces: misalignment, contacts, impulses
of the joints at impacts, errors, events and cost.
"""

from __future__ import annotations

import numpy as np

from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.layout import COUNTERS, SOME_COUNTERS, SOME_TIMINGS, TIMINGS
from mbdkit.archive.run import Run
from mbdkit.quantities.registered_kinds import added_kinds
from mbdkit_contact.modes import STICK
from mbdkit_report.figures.beam_curves import has_beams
from mbdkit_report.figures.page_model import Cell, Column, Table, columns_of
from mbdkit_report.plot.element_quantity import GAPS, misalignment

BODIES = 50  #: Largest number of bodies in the table of errors.
JOINTS = 50  #: Largest number of rows in a table of joints or contacts.
EVENTS = 50  #: Largest number of event crossings, and of changes of contacts, in their table.


def run_tables(run: Run) -> tuple[Table, ...]:
    """Return the tables of a run. The tables of events and of the cost come last."""
    tables = [_joints(run)] if run.joint_names else []
    if "contacts" in run.kinds.keys() & added_kinds().keys():  # their part is installed
        tables += [_contacts(run), *_transitions(run)]
    if run.joint_names and len(run.impacts) and np.any(np.isfinite(run.impacts.reaction_impulse)):
        tables.append(_impulses(run))
    if run.accuracy is not None and run.accuracy.rows_known:
        tables.append(_errors(run, run.accuracy))
    if run.spec.get("events"):
        tables.append(_events(run))
    return (*tables, _cost(run))


def _events(run: Run) -> Table:
    specs = run.spec["events"]
    columns = columns_of("event; zero crossing of; direction; time [s]")
    ways = {True: "upwards", False: "downwards"}
    rows: list[tuple[Cell, ...]] = [
        (event.name, str(specs[event.name]["when"]), ways[event.direction > 0], f"{event.time:.10g}")
        for event in run.events[:EVENTS]
    ]
    found = set(run.events.names)
    rows += [(name, str(event["when"]), "never", None) for name, event in specs.items() if name not in found]
    note = f"The first {EVENTS} of {len(run.events)} crossings." if len(run.events) > EVENTS else ""
    return Table("events", "Events", columns, tuple(rows), note)


def _joints(run: Run) -> Table:
    columns = [*columns_of("joint; between; largest misalignment [m]")]
    found = []
    for gap in GAPS:
        if gap != "position" and run.records(f"joints/{gap}_misalignment"):
            quantity = misalignment(run, gap)
            if gap == "velocity" or quantity.nonzero_columns:
                columns.append(Column(f"largest {quantity.name}", quantity.unit))
                found.append(quantity.data.peaks.tolist())
    joints = list(enumerate(run.joints.values()))
    order = sorted(joints, key=lambda item: -np.nan_to_num(item[1].misalignment_max, nan=np.inf))[:JOINTS]
    rows: list[tuple[Cell, ...]] = [
        (joint.name, " - ".join(joint.bodies), joint.misalignment_max, *(cells[column] for cells in found))
        for column, joint in sorted(order)
    ]
    note = f"The {JOINTS} of {len(joints)} joints with the largest misalignment." if len(joints) > JOINTS else ""
    return Table("misalignment", "Misalignment of the joints", tuple(columns), tuple(rows), note)


def _contacts(run: Run) -> Table:
    """Return the table of the contacts: their largest overlap and creep (slip while they stick), which would be zero in
    exact contacts, and their largest forces and impulses.
    """
    columns = columns_of(
        "contact; between; largest overlap [m]; largest creep [m/s]; largest normal force [N]; impacts; "
        "largest impulse [N s]"
    )
    struck, impulses = run.impacts.contact, run.impacts.normal_impulse
    rows: list[tuple[Cell, ...]] = []
    for name, contact in run.contacts.items():
        own = impulses[(struck == name) & (impulses > 0.0)]
        creep = float(np.max(np.abs(contact.slip[contact.mode == STICK]), initial=0.0))
        overlap, force = -min(float(np.min(contact.gap)), 0.0), float(np.max(contact.normal_force))
        cells = overlap, creep, force, len(own), float(np.max(own)) if len(own) else None
        rows.append((name, " - ".join(contact.bodies), *cells))
    rows.sort(key=lambda row: -float(row[2] or 0.0))
    note = "Overlap, creep (the slip of a contact that sticks) and normal force are those at the recorded times."
    if len(rows) > JOINTS:
        note += f" The {JOINTS} of {len(rows)} contacts with the largest overlap."
    return Table("contacts", "Overlap and creep of the contacts", columns, tuple(rows[:JOINTS]), note)


def _transitions(run: Run) -> list[Table]:
    every = sorted((one.time, name, one) for name, contact in run.contacts.items() for one in contact.transitions)
    rows = [(name, one.time, one.before, one.after) for _, name, one in every[:EVENTS]]
    more = f" The first {EVENTS} of {len(every)} changes." if len(every) > EVENTS else ""
    note = f"The time is that of the first recorded row with the new mode.{more}"
    columns = columns_of("contact; time [s]; before; after")
    return [Table("transitions", "Changes of the contacts", columns, tuple(rows), note)] if rows else []


def _impulses(run: Run) -> Table:
    impacts, bodies = run.impacts, [joint.bodies for joint in run.joints.values()]
    size, torque = np.linalg.norm(impacts.reaction_impulse, axis=2), np.abs(impacts.reaction_torque_impulse)
    order = np.sort(np.argsort(-np.max(size, axis=0), kind="stable")[:JOINTS])
    rows: list[tuple[Cell, ...]] = []
    for i in order.tolist():
        first = int(np.argmax(size[:, i]))
        largest = float(size[first, i]), float(impacts.time[first]), float(np.max(torque[:, i]))
        rows.append((str(impacts.joint[i]), " - ".join(bodies[i]), *largest))
    columns = columns_of("joint; between; largest impulse [N s]; at [s]; largest impulse of the torque [N m s]")
    note = f"The {JOINTS} of {len(bodies)} joints with the largest impulses." if len(bodies) > JOINTS else ""
    return Table("impulses", "Impulses of the joints at impacts", columns, tuple(rows), note)


def _errors(run: Run, accuracy: Accuracy) -> Table:
    columns = columns_of("body; position [m]; angle [rad]; velocity [m/s]; angular velocity [rad/s]")
    count = accuracy.rows_known
    errors = (accuracy.position_error, accuracy.velocity_error)
    largest = np.stack([np.fmax.reduce(error[:count], axis=0) for error in errors], axis=1)  # (B, 2, 3), without nan
    names = list(run.bodies)
    size = np.linalg.norm(largest[..., :2], axis=-1)
    shown = _one_node_of_each_beam(run, size[:, 0])
    order = np.sort(shown[np.argsort(-size[shown, 0], kind="stable")[:BODIES]])
    rows: list[tuple[Cell, ...]] = [
        (names[k], *(float(x) for x in (size[k, 0], largest[k, 0, 2], size[k, 1], largest[k, 1, 2])))
        for k in order.tolist()
    ]
    until = "over the whole run" if accuracy.is_complete else f"until {accuracy.known_until:.4g} s, unknown afterwards"
    few = f" The {BODIES} of {len(shown)} bodies with the largest errors." if len(shown) > BODIES else ""
    few += " Of the nodes of a beam, that with the largest error." if len(shown) < len(size) else ""
    known = ", in the rows where they are known" if any(np.any(np.isnan(error[:count])) for error in errors) else ""
    note = f"Largest errors {until}{known}.{few} {accuracy.method}"
    return Table("errors", "Estimated errors", columns, tuple(rows), note)


def _one_node_of_each_beam(run: Run, size: np.ndarray) -> np.ndarray:
    """Return the indices of the bodies. Of the nodes of each beam, only the node with the largest `size` (B,) is
    included.
    """
    names, shown = list(run.bodies), np.ones(len(size), dtype=bool)
    for beam in run.beams.values() if has_beams(run) else ():
        nodes = [names.index(node) for node in beam.nodes]
        shown[nodes] = False
        shown[nodes[int(np.argmax(size[nodes]))]] = True
    return np.flatnonzero(shown)


def _cost(run: Run) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (name.replace("_", " ").replace("rhs", "right-side"), int(run.stats[name]))
        for name in (*COUNTERS, *SOME_COUNTERS)
        if name in run.stats and run.spec_kind.is_integrated
    ]
    times = (name for name in (*TIMINGS, *SOME_TIMINGS) if name in run.stats)
    rows += [(f"{name.removesuffix('_s')} time [s]", float(run.stats[name])) for name in times]
    return Table("cost", "Cost", columns_of("item; value"), tuple(rows))
