"""The figures of a run's report: paths, misalignment, energy and reactions over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.analysis.verdict import Axis, Figure, Line, Mark
from mbdkit.plot.curves import ENERGIES, Quantity, joint_quantity
from mbdkit.plot.drawing_geometry import choose_traces, draw_spec, trace_points
from mbdkit.plot.series import bands, evenly, take
from mbdkit.plot.shapes import view_box
from mbdkit.plot.style import PALETTE
from mbdkit.report.quantity_text import length

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

MARKS = 60
"""So many crossings of events are marked in figures over time."""
_ROWS = 4_000
_TIME = Axis("time", "s")


def run_figures(run: Run) -> tuple[Figure, ...]:
    """Return the figures of a run that has rows; of what it did not record there is none."""
    figures = [_paths(run)]
    if run.records("joints/misalignment") and run.joint_names:
        figures += _drift(run)
    if run.records("energy/balance"):
        figures += [_energy(run), _balance(run)]
    if run.records("joints/reaction_force") and run.joint_names:
        figures.append(_reactions(run))
    marks = _marks(run)
    return tuple(replace(figure, marks=marks) if figure.x == _TIME else figure for figure in figures)


def _marks(run: Run) -> tuple[Mark, ...]:
    """Return marks at the times of events, each event named once; none where there are too many to tell apart."""
    if len(run.events) > MARKS:
        return ()
    named: set[str] = set()
    marks = []
    for event in run.events:
        marks.append(Mark("" if event.name in named else event.name, event.time))
        named.add(event.name)
    return tuple(marks)


def _paths(run: Run) -> Figure:
    drawing = draw_spec(run.spec, tuple(run.bodies))
    traces = choose_traces(drawing)
    fixed, owners = trace_points(drawing, traces)
    paths = fixed.world(take(run.dataset("trajectory/position"), evenly(len(run.time), _ROWS), owners))
    (left, right), (low, high), cut = view_box(paths, paths[:1])
    x, y = paths[..., 0], paths[..., 1]
    outside = (x < left) | (x > right) | (y < low) | (y > high)
    paths = np.where(outside[..., None], np.nan, paths)
    caption = "Paths of the free ends and of the moving joints in the plane."
    return Figure(
        "trajectory",
        "Trajectory",
        f"{caption} Some points lie outside of the picture." if cut else caption,
        Axis("x", "m"),
        Axis("y", "m"),
        tuple(Line(trace.label, paths[:, k, 0], paths[:, k, 1]) for k, trace in enumerate(traces)),
        equal=True,
    )


def _drift(run: Run) -> list[Figure]:
    position = joint_quantity(run, "misalignment", "joints/misalignment", "m")
    velocity = joint_quantity(run, "velocity misalignment", "joints/velocity_misalignment", "m/s")
    angle = joint_quantity(run, "angle misalignment", "joints/angle_misalignment", "rad")
    worst, most = position.largest
    said = (
        "No joint came apart at all."
        if position.zero
        else f"Joint {position.joints[worst]} came apart most, {length(most)}."
    )
    figures = [
        Figure(
            "misalignment",
            "Misalignment of the joints",
            f"How far the two points of each joint fail to meet. {said}",
            _TIME,
            Axis("misalignment", "m", log=True),
            _joint_lines(position),
        )
    ]
    for quantity, name, text in (
        (velocity, "velocity-misalignment", "How fast the two points of each joint move apart."),
        (angle, "angle-misalignment", "By how much each held or driven angle is off."),
    ):
        if not quantity.zero:
            axis = Axis(quantity.name, quantity.unit, log=True)
            title = quantity.name.capitalize() + " of the joints"
            figures.append(Figure(name, title, text, _TIME, axis, _joint_lines(quantity)))
    return figures


def _joint_lines(quantity: Quantity) -> tuple[Line, ...]:
    """Return the curves of the joints' largest values; of many joints those that matter most and some others."""
    columns: Sequence[int] = np.flatnonzero(np.nan_to_num(quantity.data.peaks, nan=1.0)).tolist() or [0]
    if len(columns) > len(PALETTE):
        worst = sorted(columns, key=lambda column: -np.nan_to_num(quantity.data.peaks[column], nan=np.inf))[:2]
        spread = [columns[place] for place in evenly(len(columns), len(PALETTE) - 2)]
        columns = sorted({*worst, *spread})
    return tuple(Line(quantity.joints[k], quantity.data.time, quantity.data.high[:, k]) for k in columns)


def _energy(run: Run) -> Figure:
    base = float(run.dataset("energy/potential")[0])
    lines = []
    for name in ENERGIES:
        values = np.asarray(run.dataset(f"energy/{name}")[:], dtype=np.float64)
        if name == "balance" or (name in ("dissipated", "work") and not np.any(np.nan_to_num(values))):
            continue
        shifted = values - base if name in ("potential", "total") else values
        lines.append(Line(name, *bands(run.time, shifted[:, None]).curve(0)))
    caption = f"Potential and total energy are counted from the potential energy at the start, {base:.4g} J."
    return Figure("energy", "Energy", caption, _TIME, Axis("energy", "J"), tuple(lines))


def _balance(run: Run) -> Figure:
    curve = bands(run.time, np.asarray(run.dataset("energy/balance")[:], dtype=np.float64)[:, None]).curve(0)
    caption = "Total + dissipated - work, less its start: zero but for numerical error."
    return Figure("balance", "Energy balance", caption, _TIME, Axis("balance", "J"), (Line("balance", *curve),))


def _reactions(run: Run) -> Figure:
    force = joint_quantity(
        run, "reaction force", "joints/reaction_force", "N", lambda part: np.hypot(part[..., 0], part[..., 1])
    )
    caption = "Magnitude of the force that the first body of each joint exerts on the second."
    return Figure("reactions", "Joint forces", caption, _TIME, Axis("force", "N"), _joint_lines(force))
