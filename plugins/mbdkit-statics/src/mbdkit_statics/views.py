"""What notebooks show of equilibria and modes."""

from __future__ import annotations

import numpy as np

from mbdkit.plugin import Mechanism
from mbdkit.plugin.mechanisms import beam_of
from mbdkit_report.figures.mechanism_drawing import NamedPose
from mbdkit_report.figures.page_model import Cell, Illustration, Table, columns_of
from mbdkit_report.figures.plane_geometry import Array
from mbdkit_report.notebook.result_views import Picture, View, object_view
from mbdkit_report.pages.model_section import drawing
from mbdkit_statics.equilibrium import Equilibrium
from mbdkit_statics.mechanics_summary import (
    beam_ends,
    beam_rows,
    clean,
    equilibrium_facts,
    modes_facts,
    moves_most,
    remark,
    sharing,
)
from mbdkit_statics.mode_shapes import modes_figure
from mbdkit_statics.modes import Modes


@object_view
def equilibrium_view(found: Equilibrium) -> View:
    """Return the view of an equilibrium."""
    bodies: list[tuple[Cell, ...]] = [
        (name, *clean(place))
        for name, place in zip(found.bodies, found.position, strict=True)
        if beam_of(name) not in found.beams
    ]
    ends: list[tuple[Cell, ...]] = [(name, *place, *moved) for name, place, moved in beam_ends(found)]
    forces = np.column_stack([found.reaction_force, found.reaction_torque])
    forces[np.abs(forces) < 1e-12 * np.max(np.abs(forces), initial=0.0)] = 0.0
    joints: list[tuple[Cell, ...]] = [(name, *row) for name, row in zip(found.joints, forces.tolist(), strict=True)]
    place = columns_of("body; x [m]; y [m]; angle [rad]")
    force = columns_of("joint; force x [N]; force y [N]; torque [N m]")
    tables = (
        Table("bodies", "Positions of the bodies", place, tuple(bodies)),
        Table("reactions", "Reactions in the joints", force, tuple(joints), sharing(found)),
        Table("beam-ends", "Ends of beams",
              columns_of("end of beam; x [m]; y [m]; angle [rad]; moved by x [m]; moved by y [m]; turned by [rad]"),
              tuple(ends)),
        Table("beams", "Internal forces at the ends of beams and where they are largest",
              columns_of("beam; at [m]; moment [N m]; shear [N]; axial [N]"), tuple(beam_rows(found))),
    )  # fmt: skip
    (_, stability), *facts = equilibrium_facts(found)
    tone = {"stable": "good", "unstable": "alarm"}.get(found.stability, "")
    picture = _posed(found.mechanism, found.position, found.time)
    filled = tuple(table for table in tables if table.rows)
    return View("Equilibrium", (stability[:1].upper() + stability[1:],), tone, tuple(facts), picture, tables=filled)


def _posed(mechanism: Mechanism | None, position: Array, time: float) -> Illustration | None:
    """Return the drawing of a mechanism in a position (B, 3) at a time [s]; None without a mechanism."""
    if mechanism is None:
        return None
    return drawing(NamedPose.of(mechanism, list(mechanism.bodies), position, np.array([time])))


@object_view
def modes_view(found: Modes) -> View:
    """Return the view of modes."""
    rows: list[tuple[Cell, ...]] = []
    for k, value in enumerate(found.eigenvalues.tolist()):
        swings: list[Cell] = [None, None, None]
        if value.imag:
            swings = [float(x[k]) for x in (found.natural_frequency, found.frequency_hz, found.damping_ratio + 0.0)]
        rows.append((k + 1, *swings, moves_most(found, k), remark(value)))
    columns = [*columns_of("mode; natural frequency [rad/s]; frequency [Hz]; damping ratio; moves most; remark")]
    if not any(row[-1] for row in rows):
        rows, columns = [row[:-1] for row in rows], columns[:-1]
    pictures: tuple[Picture, ...] = ()
    if found.mechanism is not None:
        figure = modes_figure(found, found.mechanism, "Mode shapes")
        pictures = (Picture(figure, "Shapes of the slowest modes, displaced in both directions"),)
    table = Table("modes", "All modes", tuple(columns), tuple(rows))
    return View("Modes", facts=tuple(modes_facts(found)), pictures=pictures, tables=(table,))
