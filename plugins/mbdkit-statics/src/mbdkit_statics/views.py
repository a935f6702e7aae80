"""What notebooks show of equilibria and modes."""

from __future__ import annotations

import numpy as np

from mbdkit.mechanism.beams import beam_of
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_report import Cell, Illustration, NamedPose, Picture, Table, View, columns_of, drawing
from mbdkit_report.notebook.result_views import object_view
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
def equilibrium_view(rest: Equilibrium) -> View:
    """Return the view of an equilibrium."""
    bodies: list[tuple[Cell, ...]] = [
        (name, *clean(place))
        for name, place in zip(rest.bodies, rest.position, strict=True)
        if beam_of(name) not in rest.beams
    ]
    ends: list[tuple[Cell, ...]] = [(name, *place, *moved) for name, place, moved in beam_ends(rest)]
    forces = np.column_stack([rest.reaction_force, rest.reaction_torque])
    forces[np.abs(forces) < 1e-12 * np.max(np.abs(forces), initial=0.0)] = 0.0
    joints: list[tuple[Cell, ...]] = [(name, *row) for name, row in zip(rest.joints, forces.tolist(), strict=True)]
    columns = columns_of("body; x [m]; y [m]; angle [rad]")
    force = columns_of("joint; force x [N]; force y [N]; torque [N m]")
    tables = (
        Table("bodies", "Positions of the bodies", columns, tuple(bodies)),
        Table("reactions", "Reactions in the joints", force, tuple(joints), sharing(rest)),
        Table("beam-ends", "Ends of beams",
              columns_of("end of beam; x [m]; y [m]; angle [rad]; moved by x [m]; moved by y [m]; turned by [rad]"),
              tuple(ends)),
        Table("beams", "Internal forces at the ends of beams and where they are largest",
              columns_of("beam; at [m]; moment [N m]; shear [N]; axial [N]"), tuple(beam_rows(rest))),
    )  # fmt: skip
    (_, stability), *facts = equilibrium_facts(rest)
    tone = {"stable": "good", "unstable": "alarm"}.get(rest.stability, "")
    picture = _posed(rest.mechanism, rest.position, rest.time)
    filled = tuple(table for table in tables if table.rows)
    return View("Equilibrium", (stability[:1].upper() + stability[1:],), tone, tuple(facts), picture, tables=filled)


def _posed(mechanism: Mechanism | None, position: np.ndarray, time: float) -> Illustration | None:
    if mechanism is None:
        return None
    return drawing(NamedPose.of(mechanism, list(mechanism.bodies), position, np.array([time])))


@object_view
def modes_view(shown: Modes) -> View:
    """Return the view of modes."""
    rows: list[tuple[Cell, ...]] = []
    for k, value in enumerate(shown.eigenvalues.tolist()):
        swings: list[Cell] = [None, None, None]
        if value.imag:
            swings = [float(x[k]) for x in (shown.natural_frequency, shown.frequency_hz, shown.damping_ratio + 0.0)]
        rows.append((k + 1, *swings, moves_most(shown, k), remark(value)))
    columns = [*columns_of("mode; natural frequency [rad/s]; frequency [Hz]; damping ratio; moves most; remark")]
    if not any(row[-1] for row in rows):
        rows, columns = [row[:-1] for row in rows], columns[:-1]
    pictures: tuple[Picture, ...] = ()
    if shown.mechanism is not None:
        figure = modes_figure(shown, shown.mechanism, "Mode shapes")
        pictures = (Picture(figure, "Shapes of the slowest modes, displaced in both directions"),)
    table = Table("modes", "All modes", tuple(columns), tuple(rows))
    return View("Modes", facts=tuple(modes_facts(shown)), pictures=pictures, tables=(table,))
