"""What notebooks and pictures show of equilibria and modes."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from mbdkit.mechanism.beams import beam_of
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_report import (
    Axis,
    Caption,
    Cell,
    Line,
    NamedPose,
    Picture,
    Table,
    View,
    columns_of,
    draw_chart,
    draw_mechanism,
    draw_pose,
    drawing,
    dress,
    new_figure,
    view_box,
)
from mbdkit_report import Figure as Chart
from mbdkit_report.notebook.result_views import object_view
from mbdkit_statics import mechanics_summary
from mbdkit_statics.equilibrium import Equilibrium
from mbdkit_statics.modes import Modes


@object_view
def equilibrium_view(rest: Equilibrium) -> View:
    """Return the view of an equilibrium."""
    bodies: list[tuple[Cell, ...]] = [
        (name, *mechanics_summary.clean(place))
        for name, place in zip(rest.bodies, rest.position, strict=True)
        if beam_of(name) not in rest.beams
    ]
    ends: list[tuple[Cell, ...]] = [(name, *place, *moved) for name, place, moved in mechanics_summary.beam_ends(rest)]
    forces = np.column_stack([rest.reaction_force, rest.reaction_torque])
    forces[np.abs(forces) < 1e-12 * np.max(np.abs(forces), initial=0.0)] = 0.0
    joints: list[tuple[Cell, ...]] = [(name, *row) for name, row in zip(rest.joints, forces.tolist(), strict=True)]
    columns = columns_of("body; x [m]; y [m]; angle [rad]")
    force = columns_of("joint; force x [N]; force y [N]; torque [N m]")
    tables = (
        Table("bodies", "Positions of the bodies", columns, tuple(bodies)),
        Table("reactions", "Reactions in the joints", force, tuple(joints), mechanics_summary.sharing(rest)),
        Table("beam-ends", "Ends of beams",
              columns_of("end of beam; x [m]; y [m]; angle [rad]; moved by x [m]; moved by y [m]; turned by [rad]"),
              tuple(ends)),
        Table("beams", "Internal forces at the ends of beams and where they are largest",
              columns_of("beam; at [m]; moment [N m]; shear [N]; axial [N]"), tuple(mechanics_summary.beam_rows(rest))),
    )  # fmt: skip
    (_, stability), *facts = mechanics_summary.equilibrium_facts(rest)
    tone = {"stable": "good", "unstable": "alarm"}.get(rest.stability, "")
    picture = None
    if (mechanism := rest.mechanism) is not None:
        picture = drawing(NamedPose.of(mechanism, list(mechanism.bodies), rest.position, np.array([rest.time])))
    filled = tuple(table for table in tables if table.rows)
    return View("Equilibrium", (stability[:1].upper() + stability[1:],), tone, tuple(facts), picture, tables=filled)


@object_view
def modes_view(shown: Modes) -> View:
    """Return the view of modes."""
    rows: list[tuple[Cell, ...]] = []
    for k, value in enumerate(shown.eigenvalues.tolist()):
        swings: list[Cell] = [None, None, None]
        if value.imag:
            swings = [float(x[k]) for x in (shown.natural_frequency, shown.frequency_hz, shown.damping_ratio + 0.0)]
        rows.append((k + 1, *swings, mechanics_summary.moves_most(shown, k), mechanics_summary.remark(value)))
    columns = [*columns_of("mode; natural frequency [rad/s]; frequency [Hz]; damping ratio; moves most; remark")]
    if not any(row[-1] for row in rows):
        rows, columns = [row[:-1] for row in rows], columns[:-1]
    pictures: tuple[Picture, ...] = ()
    if shown.mechanism is not None:
        figure = modes_figure(shown, shown.mechanism, "Mode shapes")
        pictures = (Picture(figure, "Shapes of the slowest modes, displaced in both directions"),)
    table = Table("modes", "All modes", tuple(columns), tuple(rows))
    return View("Modes", facts=tuple(mechanics_summary.modes_facts(shown)), pictures=pictures, tables=(table,))


#: Title, unit and column of `Equilibrium.beams` for each chart.
FORCES = (("Bending moment", "N m", 3), ("Shear force", "N", 2), ("Axial force", "N", 1))


def equilibrium_figure(rest: Equilibrium, mechanism: Mechanism, title: str) -> Figure:
    """Return a figure of the mechanism at rest and, if it has beams, of the internal forces along them."""
    drawing = draw_mechanism(mechanism)
    points = drawing.world(rest.position)
    (x0, x1), (y0, y1), _ = view_box(points[None], points)
    charts = beam_charts(rest)
    stability = f"{rest.stability} by flutter" if rest.flutters else rest.stability
    figure = new_figure(Caption(title, f"{stability} · t = {rest.time:g} s"), 6.4, 3.4 + 2.0 * len(charts))
    grid = figure.add_gridspec(1 + len(charts), 1, height_ratios=[1.6, *[1.0] * len(charts)])
    axes = dress(figure.add_subplot(grid[0]), "x [m]", "y [m]")
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlim=(x0, x1), ylim=(y0, y1))
    draw_pose(axes, drawing, points, max(x1 - x0, y1 - y0), alpha=0.85)
    for k, chart in enumerate(charts):
        draw_chart(figure.add_subplot(grid[k + 1]), chart, chart.title)
    return figure


def beam_charts(rest: Equilibrium) -> list[Chart]:
    """Return the charts of the internal forces along the beams; none if there are no beams."""
    along = Axis("distance from the end a", "m")
    return [
        Chart(title.lower().replace(" ", "-"), title, "", along, Axis(title.lower(), unit),
              tuple(Line(name, values[:, 0], values[:, column]) for name, values in rest.beams.items()))
        for title, unit, column in FORCES
        if rest.beams
    ]  # fmt: skip


MOST = 6  #: Largest number of modes in a picture.

AMPLITUDE = 0.12  #: Largest displacement of a point in a picture, as a share of the mechanism's size.

STEEPEST = 0.8  #: Largest rotation of a body in a picture [rad].


def modes_figure(modes: Modes, mechanism: Mechanism, title: str) -> Figure:
    """Return a figure of the modes with the smallest absolute eigenvalues, at most six."""
    drawing = draw_mechanism(mechanism)
    count = min(MOST, len(modes.eigenvalues))
    rest = drawing.world(modes.position)
    size = max(float(np.max(np.ptp(rest, axis=0))), 1e-300)
    sides = []
    for shape in modes.shapes[:count].real:
        small = 1e-4
        reach = np.max(np.linalg.norm(drawing.world(modes.position + small * shape) - rest, axis=1)) / small
        scale = min(AMPLITUDE * size / max(reach, 1e-300), STEEPEST / max(np.max(np.abs(shape[:, 2])), 1e-300))
        sides.append([drawing.world(modes.position + sign * scale * shape) for sign in (-1, 1)])
    (x0, x1), (y0, y1), _ = view_box(np.array(sides).reshape(2 * count, -1, 2), rest)
    columns = min(3, count)
    lines = -(-count // columns)
    height = lines * (float(np.clip(2.4 * (y1 - y0) / (x1 - x0), 1.2, 4.0)) + 0.6) + 0.6
    more = f" · {len(modes.eigenvalues) - count} more not shown" if len(modes.eigenvalues) > count else ""
    note = f"linearised at t = {modes.time:g} s · grey: that state · amplitudes are arbitrary, axes in m{more}"
    figure = new_figure(Caption(title, note), max(2.6 * columns + 0.6, 6.0), height)
    for k in range(count):
        axes = dress(figure.add_subplot(lines, columns, k + 1))
        axes.set_aspect("equal", adjustable="box")
        axes.set(xlim=(x0, x1), ylim=(y0, y1))
        draw_pose(axes, drawing, rest, size, alpha=0.3, is_faint=True)
        for side, alpha in zip(sides[k], (0.3, 0.85), strict=True):
            draw_pose(axes, drawing, side, size, alpha=alpha)
        axes.set_title(_heading(k, modes), size=8.5, loc="left")
    return figure


def _heading(k: int, modes: Modes) -> str:
    value = complex(modes.eigenvalues[k])
    if value == 0:
        return f"{k + 1}: free"
    if value.imag == 0:
        return f"{k + 1}: {'grows' if value.real > 0 else 'decays'}, {abs(value.real):.4g} 1/s"
    damped = f", damping {modes.damping_ratio[k]:.3g}" if abs(modes.damping_ratio[k]) > 1e-9 else ""
    return f"{k + 1}: {modes.frequency_hz[k]:.4g} Hz{damped}"
