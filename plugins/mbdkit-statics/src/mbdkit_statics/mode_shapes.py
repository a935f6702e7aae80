"""Picture of mode shapes: the linearised state, and the mechanism displaced in both directions of each mode."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_report import Caption, draw_mechanism, draw_pose, dress, new_figure, view_box
from mbdkit_statics.modes import Modes

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
    width = 2.6 * columns + 0.6
    height = lines * (float(np.clip(2.4 * (y1 - y0) / (x1 - x0), 1.2, 4.0)) + 0.6) + 0.6
    left = len(modes.eigenvalues) - count
    more = f" · {left} more not shown" if left else ""
    note = f"linearised at t = {modes.time:g} s · grey: that state · amplitudes are arbitrary, axes in m{more}"
    figure = new_figure(Caption(title, note), max(width, 6.0), height)
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
