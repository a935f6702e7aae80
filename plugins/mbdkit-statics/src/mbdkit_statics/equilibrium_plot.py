"""Picture of an equilibrium: the mechanism at rest, and the internal forces along its beams."""

from __future__ import annotations

from matplotlib.figure import Figure

from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_report import Axis, Caption, Line, draw_chart, draw_mechanism, draw_pose, dress, new_figure, view_box
from mbdkit_report import Figure as Chart
from mbdkit_statics.equilibrium import Equilibrium

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
    axes = dress(figure.add_subplot(grid[0]))
    axes.set_aspect("equal", adjustable="box")
    edge = 0.03 * (x1 - x0)
    axes.set(xlim=(x0 - edge, x1 + edge), ylim=(y0, y1), xlabel="x / m", ylabel="y / m")
    size = max(float(x1 - x0), float(y1 - y0), 1e-300)
    draw_pose(axes, drawing, points, size, alpha=0.85)
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
