"""The section on the model: a drawing with names, and tables of bodies, beams, joints, force elements, markers and
parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.archive.stored_mechanism import built_mechanism
from mbdkit.base.strict_model import description
from mbdkit.base.text import listed
from mbdkit.mechanism.parameters import parameter_values
from mbdkit.mechanism.pathways import JointAngles, path_ends
from mbdkit.mechanism.values import Table as TimeTable
from mbdkit_report.figures.curves import take
from mbdkit_report.figures.mechanism_drawing import NamedPose, illustration, names_shown, own_forces
from mbdkit_report.figures.page_model import Cell, Illustration, Section, Table, columns_of
from mbdkit_report.figures.quantity_text import count
from mbdkit_report.spec_words import described_unit

if TYPE_CHECKING:
    from mbdkit.archive.run import Run
    from mbdkit.mechanism.mechanism import Mechanism

_MEASURES = 4  # largest number of measures that are listed at the start of a report
ROWS = 200  #: Largest number of rows in a table.
_TIMES = 400  # number of recorded times at which the drawing evaluates loads; up to twice as many may be used
_PLACE = {"type", "bodies", "body", "reaction_body", "points", "point", "at", "from_", "to", "pathway", "law", "value"}
_PLACE |= {"motion", "frame"}
"""Keys of elements that are not listed as options, because they give positions or are described elsewhere."""


def model_sections(run: Run, mechanism: Mechanism | None) -> tuple[Section, Section]:
    """Return the first section of the report of a run that has rows, and the section on its model.

    The first one says what was asked and what is doubted most, and has the drawing of the mechanism.

    Parameters
    ----------
    mechanism
        The mechanism of the run; None if it is not known.
    """
    pose = take(run.dataset("trajectory/position"), np.array([0], dtype=np.intp))[0]
    times = np.asarray(run.time)[:: max(1, len(run.time) // _TIMES)]
    shown = NamedPose.of(mechanism, list(run.bodies), pose, times)
    tables = element_tables(shown)
    sentence = ""
    if shown.mechanism is not None:
        sentence = f"{composition(shown.mechanism)} Positions in the tables are global, at the start."
        tables += [table for table in [_parameters(run.spec)] if table.rows]
    lacks = f"{run.not_drawn[:1].upper()}{run.not_drawn[1:]}." if run.not_drawn else ""
    sentences = tuple(filter(None, (sentence, lacks)))
    reasons = run.verdict_reasons or [run.errors.without_suspicion]
    more = "" if run.accuracy is not None else "How large the errors are in newtons is unknown; `--check` estimates it."
    first = glance(_asked(run), run.verdict, reasons, drawing(shown), more)
    return first, Section("model", "What was modelled", sentences, None, tuple(tables), is_input=True)


def _asked(run: Run) -> str:
    given = run.spec.get("measures", {})
    texts = {name: one.get("value", one.get("name")) if isinstance(one, dict) else one for name, one in given.items()}
    measures = [f"{name} = {text}" for name, text in texts.items()]
    few = measures[:_MEASURES] + [f"{len(measures) - _MEASURES} more"] * (len(measures) > _MEASURES)
    what = listed(few, "and") if few else "the largest forces and torques in joints and drivers"
    start, end = float(run.time[0]), float(run.time[-1])
    return f"{what}, from t = {start:.4g} s to {end:.4g} s"


def glance(
    asked: str, verdict: str, reasons: Sequence[str], shown: Illustration | Mapping[str, Any] | None, more: str = ""
) -> Section:
    """Return the first section of a report: what was asked, the verdict with its first reason, and a drawing.

    In place of the drawing, it takes a run spec, unless its model is that of a plugin, which may read files.
    """
    if isinstance(shown, Mapping):
        built = built_mechanism(shown).mechanism
        bodies = {} if built is None else built.bodies
        pose = np.array([(*body.position, body.angle) for body in bodies.values()])
        shown = drawing(NamedPose.of(built, list(bodies), pose, np.zeros(1))) if bodies else None
    text = f"Verdict: {verdict}."
    if reasons:
        text += f" {reasons[0][:1].upper()}{reasons[0][1:].rstrip('.')}."
    if others := len(reasons[1:]):
        text += f" {count(others, 'more reason')}: section Verdict."
    return Section("glance", "At a glance", (f"Asked: {asked}.", f"{text} {more}".rstrip()), shown)


def element_tables(shown: NamedPose) -> list[Table]:
    """Return tables of the bodies, beams, joints, force elements and markers of a mechanism; only of the bodies if its
    model is not available. Empty tables are left out.
    """
    tables = [_bodies(shown)]
    if shown.mechanism is not None:
        mechanism = shown.mechanism
        tables += [_beams(mechanism), _joints(shown, mechanism), _forces(shown, mechanism), _markers(shown, mechanism)]
    return [table for table in tables if table.rows]


def composition(mechanism: Mechanism) -> str:
    """Return sentences on the elements of a mechanism, its mass, and gravity."""
    drivers = sum(joint.is_driver for joint in mechanism.joints.values())
    nodes = sum(beam.node_count for beam in mechanism.beams.values())
    parts = [count(len(mechanism.bodies) - nodes, "body", "bodies")]
    parts += [f"{count(len(mechanism.beams), 'beam')} ({nodes} nodes)"] * bool(mechanism.beams)
    parts += [count(len(mechanism.joints) - drivers, "joint")]
    parts += [count(drivers, "driver")] * bool(drivers)
    forces = own_forces(mechanism)
    parts += [count(len(forces), "force element")] * bool(forces)
    x, y = mechanism.gravity
    gravity = f"Gravity is ({x:g}, {y:g}) m/s²." if x or y else "There is no gravity."
    mass = sum(body.mass for body in mechanism.bodies.values())
    return f"A planar mechanism of {listed(parts, 'and')}, with a mass of {mass:.4g} kg. {gravity}"


def drawing(shown: NamedPose) -> Illustration:
    """Return the drawing of a mechanism. The names of its elements are shown unless there are too many."""
    description = "Drawing of the mechanism"
    caption = f"The mechanism at t = {shown.times[0]:.6g} s."
    if names_shown(shown):
        description += f" with the names {listed([name.text for name in shown.drawing.names], 'and')}"
        caption += " Bodies have the same colours in animations."
    else:
        caption += " It has too many elements to name them all here; the tables list them."
    return illustration(shown, description, caption)


def _limited(name: str, title: str, headings: str, rows: list[tuple[Cell, ...]]) -> Table:
    """Return a table of at most `ROWS` rows, without a last column of data if all its cells are empty."""
    columns = columns_of(headings)
    if columns[-1].label == "data" and not any(row[-1] for row in rows):
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    note = f"The first {ROWS} of {len(rows):,}." if len(rows) > ROWS else ""
    return Table(name, title, columns, tuple(rows[:ROWS]), note)


def _bodies(shown: NamedPose) -> Table:
    known = {} if shown.mechanism is None else shown.mechanism.bodies
    nodes = {node for beam in shown.drawing.beams for node in beam.nodes}
    rows: list[tuple[Cell, ...]] = []
    for number, (name, (_, _, angle)) in enumerate(zip(shown.drawing.bodies, shown.pose.tolist(), strict=True)):
        if number in nodes:
            continue
        body = known.get(name)
        centre = shown.place(name, (0.0, 0.0)).tolist()
        rows.append((name, *((body.mass, body.inertia) if body else ()), *centre, angle))
    columns = "body; mass [kg]; moment of inertia [kg m²]; x [m]" if known else "body; x [m]"
    return _limited("bodies", "Bodies", f"{columns}; y [m]; angle [rad]", rows)


def _beams(mechanism: Mechanism) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name, beam in mechanism.beams.items():
        stiffness, (mass, _) = beam.section_stiffness, beam.inertia_per_length
        nodes = f"{name}.0 to {name}.{beam.node_count - 1}"
        rows.append((name, nodes, beam.length, mass * beam.length, *stiffness, beam.damping))
    columns = "beam; nodes; length [m]; mass [kg]; axial stiffness [N]; shear stiffness [N]; bending stiffness [N m²]"
    return _limited("model-beams", "Beams", f"{columns}; damping [s]", rows)


def _joints(shown: NamedPose, mechanism: Mechanism) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name, joint in mechanism.joints.items():
        held = joint.attachments()
        place: list[Cell] = [*shown.place(*held[-1][1:]).tolist()] if held else [None, None]
        rows.append((name, joint.type, " - ".join(joint.bodies), *place, _joint_details(joint)))
    return _limited("model-joints", "Joints and drivers", "joint; type; between; x [m]; y [m]; data", rows)


def _forces(shown: NamedPose, mechanism: Mechanism) -> Table:
    rows: list[tuple[Cell, ...]] = []
    force: Any
    for name, force in own_forces(mechanism).items():
        load = getattr(force, "load", None)
        between = (load.reaction_body, load.body) if load else path_ends(force.pathway.segments(mechanism.joints))
        kind = f"{force.type}: {force.law}" if force.type == "law" else force.type
        rows.append((name, kind, " - ".join(between), _force_details(force, shown)))
    return _limited("model-forces", "Springs, dampers and loads", "force element; type; between; data", rows)


def _markers(shown: NamedPose, mechanism: Mechanism) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name, marker in mechanism.markers.items():
        x, y = shown.place(marker.body, marker.held).tolist()
        rows.append((name, marker.body, *shown.rounded(marker.held).tolist(), x, y))
    return _limited("markers", "Markers", "marker; body; x in its frame [m]; y in its frame [m]; x [m]; y [m]", rows)


def _parameters(spec: Mapping[str, Any]) -> Table:
    parameters = spec.get("parameters") or {}
    values = parameter_values(parameters)
    rows: list[tuple[Cell, ...]] = [
        (name, text if isinstance(text, str) else None, values[name]) for name, text in parameters.items()
    ]
    return _limited("parameters", "Parameters", "parameter; expression; value", rows)


def _joint_details(joint: Any) -> str:
    if joint.is_driver and isinstance(joint.motion, TimeTable):
        (start, *_, end), (first, *_, last) = joint.motion.table
        unit = joint.coordinate_unit
        values = f"{joint.coordinate} from {first:.4g} {unit} at {start:.4g} s to {last:.4g} {unit} at {end:.4g} s"
        return f"{values}, {_motion(joint.motion)}"
    if joint.is_driver:
        return f"{joint.coordinate} = {_motion(joint.motion)} {joint.coordinate_unit}"
    told = []
    if getattr(joint, "length", None) is not None:
        told.append(f"length {joint.length:.6g} m")
    if getattr(joint, "center", None) is not None:
        told += [f"center {key} = {_motion(value)} m" for key, value in joint.center.functions if value != 0.0]
    if getattr(joint, "axis", None) is not None:
        told.append("axis ({:.4g}, {:.4g})".format(*getattr(joint, "direction", joint.axis)))
    if getattr(joint, "angle", None) is not None:
        told.append(f"angle {joint.angle:.6g} rad")
    return ", ".join(told)


def _force_details(force: Any, shown: NamedPose) -> str:
    if (load := getattr(force, "load", None)) is None:
        radii = force.pathway.radii if isinstance(force.pathway, JointAngles) else {}
        return ", ".join([*(f"radius {radius:.6g} m at {joint}" for joint, radius in radii.items()), *_options(force)])
    if load.kind == "torque":
        return f"{_motion(load.values[0])} N m"
    frame = "of the body" if load.kind == "body_force" else "global"
    where = "({:.4g}, {:.4g}) m".format(*shown.rounded(load.point))
    return f"({_motion(load.values[0])}, {_motion(load.values[1])}) N, {frame} frame, at {where} of {load.body}"


def _options(force: Any) -> list[str]:
    """Return the options of a spring, damper or force law as texts, with their units where known. Options that are zero
    or that describe the position are left out.
    """
    texts = []
    for name, value in force:  # including the options of a force law of a plugin
        if name in _PLACE or value is None or value == 0:
            continue
        words = [name.replace("_", " "), _motion(value)]
        if isinstance(value, float) and name in type(force).model_fields:
            words.append(described_unit(description(type(force), name), force.pathway.length_unit))
        texts.append(" ".join(filter(None, words)))
    return texts


def _motion(value: object) -> str:
    if isinstance(value, TimeTable):
        return f"table of {len(value.table[0])} points ({value.interpolation})"
    if isinstance(value, tuple) and value and isinstance(value[0], tuple):
        return f"of {len(value[0])} points"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
